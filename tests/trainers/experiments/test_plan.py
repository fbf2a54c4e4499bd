"""From YAML to runs: shared by configuration, one for every seed, and what is wrong is named."""

import re

import pytest

from experiment_project import EXPERIMENT, SETTINGS, SPREAD, write
from rrl.trainers.experiments.plan import plan_jobs, plan_points, run_directory
from rrl.trainers.experiments.spec import load_experiments, load_settings


@pytest.fixture
def points(experiments, compose, folders):
    return lambda *names: plan_points(experiments(*names), load_settings(folders, {}), compose)


def test_points_are_arms_times_settings(points):
    found = points("drift")
    assert [(p.arm, p.value) for p in found] == [("residual RL", 0.0), ("residual RL", 0.06)]
    assert [p.config["env"]["base"]["drift"] for p in found] == [0.0, 0.06]
    assert len({p.key for p in found}) == 2


@pytest.mark.parametrize(("steps", "fits"), [([100, 200], True), ([150], False), ([300], False)])
def test_a_table_asks_for_steps_that_are_evaluated(points, folders, steps, fits):
    content = {**EXPERIMENT, "evaluated_at": steps}
    write(folders[0] / "experiment/at.yaml", content)
    if fits:
        assert points("at")
    else:
        with pytest.raises(
            ValueError, match=rf"at.evaluated_at: .*\(100\) .*\(200\), got {steps[0]}"
        ):
            points("at")


@pytest.mark.parametrize("logger", ["[]", "[tensorboard]", "[csv]"])
def test_what_is_shown_of_a_run_is_logged(points, folders, logger):
    write(folders[0] / "experiment/silent.yaml", {**EXPERIMENT, "overrides": [f"logger={logger}"]})
    if logger == "[csv]":
        assert points("silent")
    else:
        with pytest.raises(ValueError, match="silent: expected csv among the loggers"):
            points("silent")


def test_nothing_is_asked_of_a_source_but_its_weights(points, folders):
    content = {k: v for k, v in EXPERIMENT.items() if k != "sweep"}
    content |= {"figure": "curves", "evaluated_at": [200]}
    content["sources"] = {"first": ["arm=rl", "trainer.evaluation.every=0"]}
    content["arms"] = {"from it": ["arm=rl", "init_from.run=run:first"]}
    write(folders[0] / "experiment/chain.yaml", content)
    assert [point.shown for point in points("chain")] == [False, True]


def test_a_spread_is_of_all_steps(points, folders):
    content = {k: v for k, v in EXPERIMENT.items() if k != "sweep"}
    content |= {"figure": "spread", "spread": SPREAD}
    content |= {"overrides": ["trainer.buffer_capacity=199"]}
    write(folders[0] / "experiment/wide.yaml", content)
    with pytest.raises(ValueError, match=r"wide.spread: .*buffer_capacity .* \(200\), got 199"):
        points("wide")


def test_every_change_is_made_on_every_task(points, folders):
    tasks = {"still": ["env.base.drift=0.0"], "drifting": []}
    changes = {"the default": [], "short": ["trainer.n_step=1"]}
    content = {"title": "t", "figure": "tasks", "tasks": tasks, "changes": changes}
    content["arms"] = {"alone": ["arm=rl"]}
    write(folders[0] / "experiment/crossed.yaml", content)
    found = {p.arm: p for p in points("crossed")}
    both = [f"{task}, {change}" for task in tasks for change in changes]
    assert list(found) == [*both, "alone"]
    drifts = [found[arm].config["env"]["base"]["drift"] for arm in both]
    assert drifts == [0.0, 0.0, 0.06, 0.06]
    assert found["still, short"].config["trainer"]["n_step"] == 1


def test_equal_configurations_share_their_runs(points, folders, tmp_path):
    other = {**EXPERIMENT, "overrides": ["env.base.drift=0.06", "name=another"], "figure": "curves"}
    write(folders[0] / "experiment/same.yaml", {k: v for k, v in other.items() if k != "sweep"})
    write(
        folders[0] / "experiment/view.yaml",
        {"title": "t", "paper": "p", "figure": "table", "runs_of": "drift"},
    )
    found = points()
    jobs = plan_jobs(found, tmp_path / "out")
    assert len(found) == 5
    assert len(jobs) == 2 * 2  # settings, seeds


def test_every_seed_is_a_run_and_only_missing_ones_are_added(points, folders, tmp_path):
    before = {job.path for job in plan_jobs(points("drift"), tmp_path / "out")}
    settings = {**SETTINGS, "scales": {"tiny": {**SETTINGS["scales"]["tiny"], "seeds": 5}}}
    write(folders[0] / "reproduce.yaml", settings)
    jobs = plan_jobs(points("drift"), tmp_path / "out")
    assert before < {job.path for job in jobs}
    assert sorted(job.config["trainer"]["seed"] for job in jobs) == sorted([*range(5)] * 2)
    assert all(job.config["trainer"]["num_seeds"] == 1 for job in jobs)


@pytest.mark.parametrize("own", [None, 4])
def test_the_number_of_seeds_of_the_command_line_comes_first(
    experiments, compose, folders, tmp_path, own
):
    write(folders[0] / "experiment/some.yaml", {**EXPERIMENT, "seeds": own})
    usual = plan_points(experiments("some"), load_settings(folders, {}), compose)
    few = plan_points(experiments("some"), load_settings(folders, {"seeds": 1}), compose)
    assert {p.seeds for p in usual} == {tuple(range(own or 2))}
    assert {p.seeds for p in few} == {(0,)}
    assert [p.key for p in usual] == [p.key for p in few]


def test_a_change_of_configuration_is_another_run_and_a_change_of_logging_is_not(points, folders):
    before = points("drift")[0].key
    for change, same in (
        ("algorithm.agent.tau=0.5", False),
        ("render.fps=7", True),
        ("trainer.threads=2", True),
    ):
        write(
            folders[0] / "reproduce.yaml",
            {**SETTINGS, "overrides": [*SETTINGS["overrides"], change]},
        )
        assert (points("drift")[0].key == before) == same, change


def test_what_starts_from_another_run_waits_for_it_and_names_it(points, folders, tmp_path):
    arms = {"from it": ["arm=rl", "init_from.run=run:first+x"], "alone": ["arm=rl"]}
    content = {
        **EXPERIMENT,
        "figure": "curves",
        "sources": {"first+x": ["arm=rl", "env.base.drift=0.0"]},
        "arms": arms,
    }
    write(folders[0] / "experiment/chain.yaml", {k: v for k, v in content.items() if k != "sweep"})
    found = points("chain")
    jobs = plan_jobs(found, tmp_path / "out")
    first = next(point for point in found if not point.shown)
    for job in jobs:
        seed = job.config["trainer"]["seed"]
        source = run_directory(first, seed, tmp_path / "out")
        starts = job.config["init_from"]["run"] == str(source)
        assert (job.needs == (source,)) == starts == ("from-it" in job.name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"arms": {}}, "expected either arms or runs_of, got neither"),
        ({"figure": "pie"}, "wrong.figure"),
        ({"sedes": 3}, "wrong.sedes: unknown key"),
        ({"sweep": None}, "figure: sweep: expected a sweep, got none"),
        ({"arms": {"a": ["init_from.run=run:nobody"]}}, "expected sources of .*got 'nobody'"),
        (
            {"sweep": {"key": "k", "label": "l", "values": {"other": [1]}}},
            "expected values for 'tiny'",
        ),
        ({"scales": {"tyni": []}}, "wrong.scales: expected some of .*tiny.*, got 'tyni'"),
        (
            {"figure": "spread", "spread": {**SPREAD, "entry": "elbow"}},
            r"wrong.spread.entry: expected one of env.inputs \(end_effector_position, goal\), "
            "got 'elbow'",
        ),
        ({"figure": "spread", "spread": {**SPREAD, "axes": []}}, "wrong.spread.axes"),
        ({"figure": "spread"}, "spread: expected it with figure: spread, and only there"),
        ({"spread": SPREAD}, "spread: expected it with figure: spread, and only there"),
        ({"tasks": {"a": []}}, "expected tasks and changes, or neither, got tasks alone"),
        ({"name": "right"}, "wrong.name: unknown key"),
        ({"arms": {}, "runs_of": "drift"}, "expected no arms beside runs_of"),
    ],
)
def test_a_wrong_experiment_is_explained(change, message, points, folders):
    write(folders[0] / "experiment/wrong.yaml", {**EXPERIMENT, **change})
    with pytest.raises(ValueError, match=message):
        points("wrong")


@pytest.mark.parametrize("content", ["", "[a]", "title: [", "\tarms: {}"])
@pytest.mark.parametrize("name", ["reproduce", "experiment/drift"])
def test_a_file_that_holds_no_settings_is_named(points, folders, name, content):
    path = folders[0] / f"{name}.yaml"
    path.write_text(content)
    with pytest.raises(ValueError, match=re.escape(str(path))):
        points()


def test_runs_are_those_of_an_experiment_with_arms(points, folders):
    for name, other in (("view", "drift"), ("again", "view")):
        content = {"title": "t", "figure": "sweep", "runs_of": other}
        write(folders[0] / f"experiment/{name}.yaml", content)
    assert [p.key for p in points("view")] == [p.key for p in points("drift")]
    with pytest.raises(ValueError, match=r"again.runs_of: expected an experiment with arms"):
        points("again")


def test_whole_numbers_are_swept_as_such(points, folders):
    sweep = {"key": "trainer.n_step", "label": "n", "values": {"tiny": [1, 3]}}
    write(folders[0] / "experiment/steps.yaml", {**EXPERIMENT, "sweep": sweep})
    found = points("steps")
    assert [repr(p.config["trainer"]["n_step"]) for p in found] == ["1", "3"]
    assert [p.label for p in found] == ["residual RL, n_step = 1", "residual RL, n_step = 3"]


def test_wrong_runs_are_named_before_the_first_one_starts(run, project):
    arms = {"right": [], "wrong": ["trainer.n_step=99"], "worse": ["algorithm.agent.tau=many"]}
    write(project / "configs/experiment/three.yaml", {**EXPERIMENT, "arms": arms})
    with pytest.raises(ValueError, match="n_step: expected at most") as caught:
        run("three")
    lines = str(caught.value).splitlines()
    assert [line.partition(":")[0][:-9] for line in lines] == ["three-0-wrong", "three-0-worse"]
    assert not (project / "out/runs").exists()
    assert run("three", workers=0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale": "huge"}, "expected one of tiny, got 'huge'"),
        ({"sclae": "tiny"}, "expected one of scale, seeds, launcher, workers, out, data, got"),
        ({"seeds": 0}, "seeds"),
        ({"workers": -1}, "workers"),
        ({"workers": True}, "workers"),
        ({"launcher": "slurm"}, "launcher"),
    ],
)
def test_a_wrong_setting_is_explained(changes, message, folders):
    with pytest.raises(ValueError, match=message):
        load_settings(folders, changes)


def test_an_unknown_experiment_is_answered_with_the_known_ones(folders):
    with pytest.raises(ValueError, match="experiment: expected one of drift, got drfit"):
        load_experiments(["drfit"], folders)


def test_an_experiment_that_has_to_be_named_is_left_out_otherwise_and_sets_its_own_seeds(
    points, folders
):
    apart = {**EXPERIMENT, "overrides": ["env.base.drift=0.09"], "by_name": True, "seeds": 4}
    write(folders[0] / "experiment/apart.yaml", apart)
    assert {p.experiment for p in points()} == {"drift"}
    assert {p.seeds for p in points("apart")} == {(0, 1, 2, 3)}
