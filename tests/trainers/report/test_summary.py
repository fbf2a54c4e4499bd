"""The table: right numbers in the right cells, with their intervals."""

import json

import numpy as np

from rrl.trainers.evaluation.episodes import Comparison, Episodes
from rrl.trainers.report.summary import markdown_table, rows, write_results


def episodes(successes, n=20, returns=-1.0):
    solved = None if successes is None else np.arange(n) < successes
    return Episodes(np.full(n, returns), np.full(n, 5), solved, np.zeros(n, dtype=bool))


def test_cells_hold_rates_intervals_and_changes():
    results = {
        "misaligned": [Comparison(episodes(15), episodes(2)), Comparison(episodes(19), episodes(2))]
    }
    (row,) = rows(results, [0, 1])
    assert row[0] == "misaligned"
    assert row[1].startswith("10% [3%, 30%]")
    assert row[2].startswith("85.0% [")
    assert row[2].endswith(", 100.0%]")  # a rate's interval stays a rate
    assert row[3:] == ["75%, 95%", "15.0", "0.0"]


def test_returns_stand_in_where_there_is_no_success():
    results = {"own": [Comparison(episodes(None, returns=-1.5), episodes(None, returns=-4.0))]}
    (row,) = rows(results, [0])
    assert row[1:4] == ["-4.00", "-1.50", "-1.50"]


def test_written_results_hold_every_seed(tmp_path):
    results = {"misaligned": [Comparison(episodes(15), episodes(2))]}
    write_results(results, [7], tmp_path)
    content = json.loads((tmp_path / "results.json").read_text())
    assert content["misaligned"]["7"]["rescues"] == 13
    assert (tmp_path / "results.md").read_text() == markdown_table(results, [7])
