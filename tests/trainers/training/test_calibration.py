"""A run derives what nobody set, says what it derived, and goes on with it."""

import inspect
from functools import partial

import pytest
import yaml

from rrl.algorithms import TD3, mlp
from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.trainers.defaults import default_config
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.settings import CheckpointSettings
from rrl.trainers.training.factories import default_agent
from runs import assert_same_run, run, run_until
from toy_envs import EPISODE_STEPS

DERIVING = partial(
    TD3,
    network=partial(mlp, hidden=[8]),
    gamma=None,
    reward_scale=None,
    episode_steps=EPISODE_STEPS,
)


def test_a_run_writes_what_it_derived(make_trainer):
    trainer = run(make_trainer(agent=DERIVING, warmup_steps=None))
    derived = yaml.safe_load((trainer.run_dir / "derived.yaml").read_text())
    assert derived["warmup_steps"] == trainer.settings.warmup_steps
    assert derived["controller_steps"] == trainer.settings.controller_steps
    assert derived["penalty_updates"] == trainer.agent.penalty_updates
    assert derived["gamma"] == trainer.agent.gamma == trainer.store.gamma
    assert (
        derived["reward_scale"] >= float(trainer.agent.reward_scale) > 0
    )  # rewards may have grown
    assert set(derived["inputs"]) == {"end_effector_position", "goal"}
    assert trainer.agent.encoder.scale.tolist() == pytest.approx(
        [x for entry in derived["inputs"].values() for x in entry["scale"]]
    )


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize("step", [40, 120])
def test_a_run_that_died_derives_the_same(make_trainer, simulated, step, collection):
    arguments = {
        "agent": DERIVING,
        "warmup_steps": 100,
        "total_steps": 200,
        "collection": collection,
        "environment": simulated,
    }
    whole = run(make_trainer("whole", **arguments))
    run_until(make_trainer("died", **arguments), "store.extend", step)
    resumed = make_trainer("died", **arguments)
    resumed.resume()
    assert_same_run(whole, run(resumed))


def test_a_run_that_becomes_longer_keeps_what_it_derived(make_trainer, simulated):
    """The warm-up is a tenth of a short run; a run that has learned does not stop to warm up."""
    arguments = {"agent": DERIVING, "warmup_steps": None, "environment": simulated}
    arguments |= {"checkpoint": CheckpointSettings(every=20)}
    first = make_trainer(total_steps=400, **arguments)
    assert first.settings.lengths == {"warmup_steps": 40, "controller_steps": 20}
    run_until(first, "agent.update", 60)
    for env_steps in (100, 140):
        longer = make_trainer(total_steps=4000, **arguments)
        longer.resume()
        assert longer.settings.lengths == first.settings.lengths
        run_until(longer, "agent.update", env_steps)
    derived = yaml.safe_load((longer.run_dir / "derived.yaml").read_text())
    assert derived["warmup_steps"] == 40


def called(makes):
    """What is made, and all its arguments, defaults included."""
    bound = [(m.func, inspect.signature(m.func).bind(*m.args, **m.keywords)) for m in makes]
    for _, arguments in bound:
        arguments.apply_defaults()
    return [(func, arguments.arguments) for func, arguments in bound]


def test_command_line_and_python_share_the_defaults(factory):
    agent = default_agent(factory)(inputs={"position": 3}, action_size=2)
    given = default_config()["algorithm"]["agent"]
    assert given["gamma"] is None
    assert given["reward_scale"] is None
    assert agent.gamma == pytest.approx(0.925)
    assert agent.settings.residual_penalty == given["residual_penalty"]
    composed = compose(["env=gallery/cartpole"])  # a task that chooses nothing of its own
    assert default_config() == {part: composed[part] for part in ("trainer", "algorithm")}
    python = EnvironmentFactory(base=factory.base, controller=factory.controller, inputs=[])
    command_line = assembly.environment(composed)
    assert python.residual_scale == command_line.residual_scale == composed["residual_scale"]
    assert called(python.safety) == called(command_line.safety)
