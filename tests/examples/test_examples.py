"""Every example trains a residual, in no more than fifteen lines of the user's own."""

import ast
import importlib.util
from functools import partial
from pathlib import Path

import pytest
from torchrl.envs.utils import check_env_specs

from rrl.trainers import EnvironmentFactory

EXAMPLES = Path(__file__).parents[2] / "examples"
TRAINED = [
    "budget",
    "composer_task",
    "control_suite",
    "frozen_policy",
    "gymnasium_pd",
    "integral_controller",
    "parallel_envs",
    "pixels",
    "targets_and_deltas",
]
TINY = {
    "total_steps": 40,
    "warmup_steps": 20,
    "steps_per_collection": 10,
    "batch_size": 8,
    "buffer_capacity": 100,
    "evaluation": {"every": 0, "episodes": 1, "final_episodes": 1},
    "acceptance": {"episodes": 2},
    "checkpoint": {"every": 0},
}
MAX_LINES = 15


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def load_example(name):
        spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load_example


@pytest.mark.slow
@pytest.mark.timeout(1200)  # compiled for a small run on a busy machine
@pytest.mark.parametrize("name", TRAINED)
def test_example_trains(name, load, tmp_path):
    module = load(name)
    module.EnvironmentFactory = partial(
        EnvironmentFactory, max_episode_steps=20
    )  # of an evaluation
    result = module.main(tmp_path / "run", **TINY)
    for summary in result.values() if "return" not in result else [result]:
        assert summary["return"] < float("inf")
        assert summary["controller_return"] < float("inf")
    assert list(tmp_path.rglob("metrics.csv"))


def test_the_transforms_alone_in_torchrls_own_loop(load):
    assert load("own_loop").main(total_steps=60) < 0.0


def test_the_examples_environment_keeps_its_specs(load):
    check_env_specs(load("point").Point())


def test_every_example_is_run():
    names = {path.stem for path in EXAMPLES.glob("*.py")} - {"point", "own_loop"}
    assert names == set(TRAINED)


@pytest.mark.parametrize("name", TRAINED)
def test_a_residual_takes_fifteen_lines(name):
    assert len(user_lines(EXAMPLES / f"{name}.py")) <= MAX_LINES


def user_lines(path: Path) -> list[int]:
    """Lines with code: no imports, docstrings, comments, brackets alone, or the call under ``__main__``."""
    source = path.read_text()
    tree = ast.parse(source)
    tree.body = [n for n in tree.body if not isinstance(n, (ast.Import, ast.ImportFrom, ast.If))]
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped |= set(range(node.lineno, node.end_lineno + 1))
    kept = {n for node in tree.body for n in range(node.lineno, node.end_lineno + 1)} - skipped
    lines = source.splitlines()
    return [n for n in sorted(kept) if lines[n - 1].split("#")[0].strip(" )]},")]


@pytest.mark.slow
def test_a_residual_improves_on_the_integral_controllers_point(load, tmp_path):
    """The example's own budget, not the tiny one, is enough to beat the controller."""
    settings = {"total_steps": 3000, "warmup_steps": 400, "steps_per_collection": 20}
    settings["evaluation"] = {"every": 0, "final_episodes": 30}
    settings["checkpoint"] = {"every": 0}
    summaries = load("targets_and_deltas").main(tmp_path, **settings)
    assert all(s["return_gain"] > 0 for s in summaries.values())
