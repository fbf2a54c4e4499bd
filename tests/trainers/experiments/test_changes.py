"""What changes of the settings do: on each task against the first of them, on the same seeds."""

import csv
import json

import pytest
import yaml

from experiment_project import finding, write
from rrl.trainers.experiments.changes import MEASURES, change_rows
from rrl.trainers.experiments.figures import draw
from rrl.trainers.experiments.outcomes import Outcome
from rrl.trainers.experiments.plan import Point
from rrl.trainers.experiments.spec import Experiment
from rrl.trainers.report.runs import Run

EPISODES = 20
LATEST, ON_THE_WAY, HANDED_OVER = MEASURES
TASKS = {"push": (), "hammer": ()}
CHANGES = {"the default": (), "without a price": ("price=0",)}
EXPERIMENT = Experiment(name="some", title="T", figure="changes", tasks=TASKS, changes=CHANGES)


@pytest.fixture
def outcome(tmp_path):
    """An arm whose runs solve so many of 20 episodes, by seed; the controller solves 10."""

    def make(arm, solved, entry="success", handed_over=10):
        runs = tuple(run(seed, n, entry, handed_over) for seed, n in solved.items())
        return Outcome(Point("some", arm, None, "key", (), runs[0].config, (0, 1, 2)), runs)

    def run(seed, solved, entry, handed_over):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        path.mkdir()
        trainer = {"seed": seed, "evaluation": {"episodes": EPISODES}}
        content = {"env": {"scenarios": {"task": {}}}, "trainer": trainer}
        (path / "config.yaml").write_text(yaml.safe_dump(content))
        counts = {"controller_": 10, "": solved, "accepted_": handed_over}
        episodes = {p + entry: [float(i < n) for i in range(EPISODES)] for p, n in counts.items()}
        summary = {name: sum(values) / EPISODES for name, values in episodes.items()}
        results = {"task": {"summary": summary, "episodes": episodes}}
        (path / "results.json").write_text(json.dumps(results))
        with (path / "metrics.csv").open("w") as file:
            rows = csv.writer(file)
            rows.writerow(["env_steps", "metric", "value"])
            for prefix, values in {"controller_": [0.5, 0.5], "": [0.0, solved / 20]}.items():
                rows.writerows(
                    [i * 500, f"eval/task/{prefix}{entry}", v] for i, v in enumerate(values)
                )
        return Run(path, path.name)

    return make


def rows(found, measure=LATEST, experiment=EXPERIMENT):
    header, cells = change_rows(experiment, found, measure)
    return header, {row[0]: row[1:] for row in cells}


def test_changes_are_compared_with_the_first_on_the_seeds_that_both_have(outcome):
    found = finding(
        outcome("push, the default", {0: 16, 1: 18, 2: 20}),
        outcome("push, without a price", {0: 6, 1: 8}),  # its third seed is not finished
        outcome("hammer, the default", {0: 20, 1: 20}),
        outcome("hammer, without a price", {0: 10, 1: 10}),
    )
    header, cells = rows(found)
    assert header == ["change", "push", "hammer", "mean of the tasks"]
    assert list(cells) == ["the controller alone", *CHANGES]
    assert cells["the controller alone"] == ["50.0 %", "50.0 %", ""]
    assert [cell.split(" [")[0] for cell in cells["the default"]] == ["90.0", "100.0", ""]
    changed = [cell.split(" [")[0] for cell in cells["without a price"]]
    assert changed == ["-50.0", "-50.0", "-50.0"]
    _, on_the_way = rows(found, ON_THE_WAY)
    assert on_the_way["the default"][0].startswith("45.0 [")
    assert on_the_way["the default"][1] == "50.0 % (no interval)"  # both alike
    assert on_the_way["without a price"] == ["-25.0 % (no interval)"] * 3
    two = finding(*(outcome(f"push, {arm}", {0: 1, 1: 20}) for arm in CHANGES))
    assert rows(two, ON_THE_WAY)[1]["the default"][0].endswith("[0.0, 100.0] %")
    _, handed_over = rows(found, HANDED_OVER)
    assert handed_over["without a price"][0].startswith("+0.0 [-")


def test_changes_of_returns_have_no_mean_over_tasks(outcome):
    found = finding(
        outcome("push, the default", {0: 16, 1: 18}),
        outcome("push, without a price", {0: 6, 1: 8}),
        outcome("hammer, the default", {0: 20, 1: 20}, "return"),
        outcome("hammer, without a price", {0: 10, 1: 12}, "return"),
    )
    _, cells = rows(found)
    assert cells["the controller alone"][1] == "0.50"
    assert cells["without a price"][1].startswith("-0.45 [")
    assert cells["without a price"][2] == ""


def test_a_single_runs_interval_has_a_star(outcome):
    found = finding(
        outcome("push, the default", {0: 16, 1: 18}),
        outcome("push, without a price", {0: 6}),
        outcome("hammer, the default", {0: 20, 1: 20}),
        outcome("hammer, without a price", {0: 10, 1: 10}),
    )
    _, cells = rows(found)
    starred = [[cell.endswith(" *") for cell in cells[change]] for change in CHANGES]
    assert starred == [[False, False, False], [True, False, True]]


def test_what_is_not_finished_is_left_empty(outcome):
    arms = {"push, without symmetry": ()}
    experiment = EXPERIMENT.model_copy(update={"arms": arms})
    found = finding(
        outcome("push, the default", {0: 16}),
        outcome("push, without symmetry", {0: 12}),
        outcome("push, without a price", {0: 12}),
        outcome("hammer, without a price", {0: 10}),  # what it is compared with is to come
    )
    header, cells = rows(found, experiment=experiment)
    assert header == ["change", "push", "mean of the tasks"]
    assert cells["without a price"][0].startswith("-20.0 [")
    assert cells["without a price"][1] == ""  # no mean of some of the tasks
    assert cells["without symmetry"][0].startswith("-20.0 [")
    assert cells["without symmetry"][1] == cells["without symmetry"][0]  # made on this task alone
    assert rows(found, ON_THE_WAY, experiment)[1]["without symmetry"][0] == "-10.0 % (no interval)"


def test_the_figure_has_a_panel_for_every_task_and_one_for_the_mean(outcome, tmp_path):
    arms = [f"{task}, {change}" for task in TASKS for change in CHANGES]
    found = finding(*(outcome(arm, {0: 10 + i, 1: 12}) for i, arm in enumerate(arms)))
    svg = draw(EXPERIMENT, found, tmp_path / "figures").with_suffix(".svg").read_text()
    shown = [*TASKS, "mean of the tasks", "without a price", *(m.name for m in MEASURES)]
    assert [text for text in shown if f"<!-- {text} -->" not in svg] == []


@pytest.mark.parametrize("change", CHANGES)
def test_the_figure_is_empty_while_there_is_nothing_to_compare(outcome, change, tmp_path):
    found = finding(outcome(f"push, {change}", {0: 16}))
    svg = draw(EXPERIMENT, found, tmp_path / "figures").with_suffix(".svg").read_text()
    assert "<!-- mean of the tasks -->" in svg


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"changes": {"the default": ()}}, "changes: expected at least two to compare"),
        (
            {"tasks": {}, "changes": {}, "arms": {"a": ()}},
            "figure: changes: expected tasks and changes, got none",
        ),
        (
            {"arms": {"pull, without a price": ()}},
            "arms: expected TASK, CHANGE of one of the tasks",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(change, message):
    content = {
        "name": "some",
        "title": "T",
        "figure": "changes",
        "tasks": TASKS,
        "changes": CHANGES,
    }
    with pytest.raises(ValueError, match=message):
        Experiment(**{**content, **change})


@pytest.mark.slow
def test_the_command_writes_page_figure_and_tables(project, run):
    tasks = {"drifting": [], "still": ["env.base.drift=0.0"]}
    changes = {"the default": [], "without pause": ["trainer.warmup_steps=40"]}
    content = {"title": "Changes", "figure": "changes", "seeds": 2, "tasks": tasks}
    content |= {"changes": changes, "overrides": ["trainer.acceptance.enabled=true"]}
    write(project / "configs/experiment/points.yaml", content)
    report, _ = run("points")
    page = (report.parent / "results-points.md").read_text()
    assert page.count("| change | drifting | still | mean of the tasks |") == len(MEASURES)
    assert "| without pause | " in page
    assert "![Experiment `points`](figures/points.png)" in page
    assert "without pause" in report.read_text()
