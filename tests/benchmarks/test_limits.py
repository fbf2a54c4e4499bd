"""The limits of ``configs/safety`` hold under the benchmark's worst commands, and the benchmark sees it where they do not."""

import math

import pytest
import torch

from benchmarks.limits.commands import BATCH
from benchmarks.limits.measure import Worst, excesses, measure, promises
from benchmarks.limits.play import CASES, FORCE, WATCHED, configuration, make_env, play
from benchmarks.limits.record import Key, Record


@pytest.mark.slow
@pytest.mark.parametrize("case", ["nominal", "delay and stiff"])
@pytest.mark.parametrize("name", [*WATCHED, "all"])
@pytest.mark.parametrize("variant", ["sim", "real"])
def test_no_limit_is_exceeded(variant, name, case):
    found = measure(variant, name, CASES[case], seed=0)
    assert sum(worst.episodes for worst in found.values()) >= 1000
    assert not excesses(variant, name, found)
    if name == "force":  # it was tried
        assert max(worst.values[FORCE] for worst in found.values()) > 20.0


@pytest.mark.slow
def test_a_limit_that_does_not_hold_is_named():
    found = measure("real", "step", CASES["nominal"], seed=0, generations=1)
    assert not excesses("real", "step", found)
    text = "\n".join(excesses("real", "all", found))  # which it was not asked to keep
    assert "real, all, random, held: outside the box [mm]" in text


def test_a_record_goes_on_and_parts_are_joined(tmp_path):
    limits, path = {"sim": {"force": {"limit": 50.0}}}, tmp_path / "new/limits.jsonl"
    for seed, force in enumerate([30.0, 40.0, 20.0]):
        found = {"random": Worst(50, {FORCE: force})}
        Record(path, limits).add(Key("sim", "nominal", "force", seed), found)
    record = Record(path, limits)
    assert [key.seed for key in record.rounds] == [0, 1, 2]
    assert record.joined() == {("sim", "nominal", "force"): {"random": Worst(150, {FORCE: 40.0})}}


def test_rounds_under_other_limits_are_not_joined(tmp_path):
    path = tmp_path / "limits.jsonl"
    Record(path, {"sim": {"force": {"limit": 50.0}}}).add(Key("sim", "nominal", "force", 0), {})
    with pytest.raises(ValueError, match=r"expected rounds under .*60.*, got .*50.*another file"):
        Record(path, {"sim": {"force": {"limit": 60.0}}})


def test_what_is_not_known_is_above_every_limit():
    worst = Worst()
    for forces in ([3.0, math.nan], [3.0, 4.0]):
        worst.take({FORCE: torch.tensor(forces)})
    assert math.isnan(worst.values[FORCE])
    (text,) = excesses("sim", "force", {"random": worst})
    assert text == "sim, force, random: force [N] nan > 50"


def test_nothing_is_known_of_an_episode_whose_physics_diverge():
    config = configuration("sim", "force", CASES["nominal"])
    config["env"]["base"]["velocity_limit"] = 0.04  # beyond it physics count as diverged
    env = make_env(config, CASES["nominal"], 0)
    commands = torch.zeros(BATCH, 10, 3)
    commands[: BATCH // 2, :, 2] = 1.0
    moved, still = play(env, commands, promises("sim"))[FORCE].chunk(2)
    env.close()
    assert moved.isnan().all()
    assert still.isfinite().all()


def test_no_two_rounds_begin_alike():
    starts = []
    for seed in range(2):
        env = make_env(configuration("sim", "force", CASES["nominal"]), CASES["nominal"], seed)
        starts.append(env.reset()["blocks"].reshape(BATCH, -1))
        env.close()
    assert not (starts[0][:, None] == starts[1]).all(-1).any()
