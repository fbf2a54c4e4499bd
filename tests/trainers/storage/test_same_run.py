"""Only the same run is resumed, and what may change in it."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from rrl.algorithms import TD3, mlp
from rrl.controllers import ZeroController
from rrl.trainers import Input, Trainer
from rrl.trainers.settings import AcceptanceSettings, CheckpointSettings
from rrl.trainers.storage.same_run import differences, require_same_run
from rrl.transforms import FiniteAction, StepLimit
from runs import assert_same, run
from toy_envs import RememberingPointMass


def test_a_changed_run_is_refused_with_the_difference(stopped, make):
    trainer = make(batch_size=16, seed=2)
    with pytest.raises(ValueError, match=r"(?s)trainer.batch_size: 32 -> 16.*trainer.seed: 0 -> 2"):
        trainer.resume()
    trainer.close()


def test_more_steps_other_loggers_other_cadence_are_the_same_run(stopped, make):
    trainer = make(
        total_steps=240,
        loggers=[],
        checkpoint=CheckpointSettings(every=40, keep=3),
        evaluation={"every": 0, "episodes": 1, "final_episodes": 2, "slots": 1},
    )
    trainer.resume()
    trainer.run()
    trainer.close()
    whole = make("whole", total_steps=240)
    whole.run()
    whole.close()
    assert_same(dict(whole.agent.state_dict()), dict(trainer.agent.state_dict()))


POSITION, GOAL = "end_effector_position", "goal"


def another_point(num_envs=1):
    return RememberingPointMass([num_envs])


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (
            {"inputs": [GOAL, POSITION]},
            r'inputs: \["end_effector_position \[2\]", "goal \[2\]"\] -> \["goal \[2\]", "end',
        ),
        ({"inputs": {GOAL: Input()}}, r'inputs: .* -> \["goal \[2\]"\]'),
        ({"critic_inputs": [GOAL]}, r'critic_inputs: \[\] -> \["goal \[2\]"\]'),
    ],
)
def test_other_inputs_are_refused(stopped, make, simulated, changes, line):
    trainer = make(environment=replace(simulated, **changes))
    with trainer, pytest.raises(ValueError, match=f"(?s)got another one:.*\n  {line}"):
        trainer.resume()


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"residual_scale": 0.9}, r"environment.residual_scale: .* -> 0.9"),
        ({"controller": partial(ZeroController, action_size=2)}, r"environment.controller"),
        ({"max_episode_steps": 21}, r"environment.max_episode_steps: .* -> 21"),
        ({"safety": [FiniteAction, partial(StepLimit, 0.5)]}, r"environment.safety"),
        ({"base": another_point}, r"environment.base.class: .* -> \"another_point"),
        ({"inputs": {POSITION: Input(scale=3.0), GOAL: Input()}}, r"environment.inputs.*3.0"),
    ],
)
def test_another_environment_is_refused_in_python_too(stopped, make, simulated, changes, line):
    trainer = make(environment=replace(simulated, **changes))
    with trainer, pytest.raises(ValueError, match=f"(?s)got another one:.*\n  {line}"):
        trainer.resume()


def test_another_learner_is_refused_in_python_too(stopped, make):
    trainer = make(agent=partial(TD3, gamma=0.5))
    with trainer, pytest.raises(ValueError, match=r"got another one:.*\n  agent"):
        trainer.resume()


def test_a_configuration_may_hold_anything_and_is_compared(settings, factory, tmp_path):
    def make(**config):
        short, agent = settings(total_steps=40, warmup_steps=20), partial(TD3, network=mlp)
        return Trainer(factory, short, agent, run_dir=tmp_path / "run", config=config)

    run(make(data=Path("here"), limits=(1, 2)))
    with make(data=Path("here"), limits=[1, 2]) as trainer:
        trainer.resume()
    trainer = make(data=Path("there"), limits=[1, 2])
    with trainer, pytest.raises(ValueError, match='data: "here" -> "there"'):
        trainer.resume()


@pytest.mark.parametrize("accepted", [True, False])
def test_what_is_handed_over_was_tested_on_the_followed_scenario(
    settings, factory, tmp_path, accepted
):
    def make(**scenarios):
        tests = AcceptanceSettings(enabled=accepted)
        short = settings(total_steps=40, warmup_steps=20, acceptance=tests)
        config, agent = {"env": {"scenarios": scenarios}}, partial(TD3, network=mlp)
        return Trainer(factory, short, agent, run_dir=tmp_path / "run", config=config)

    trainer = make(one={"drift": 0.1})
    if accepted:
        trainer.acceptance.handed_over.take(20)
    run(trainer)
    with make(one={"drift": 0.1}, two={}) as trainer:
        trainer.resume()
    with make(one={"drift": 0.2}) as trainer:
        if accepted:
            with pytest.raises(ValueError, match=r"env.scenarios: expected .*0.1.* first.*0.2"):
                trainer.resume()
        else:
            trainer.resume()


def test_no_scenario_is_not_the_training_environment(settings, factory, tmp_path):
    with pytest.raises(ValueError, match="scenarios: expected at least one, got none"):
        Trainer(factory, settings(), run_dir=tmp_path / "run", scenarios={})


BASE = {
    "name": "a",
    "trainer": {"total_steps": 100, "num_seeds": 1, "threads": 1},
    "algorithm": {"agent": {"tau": 0.1, "actor_lr": 0.1}},
    "env": {"base": {"variant": "sim"}, "scenarios": {"one": {}}},
    "logger": {"csv": {"_target_": "x"}},
}


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        ("algorithm.agent.tau", 0.2, "algorithm.agent.tau: 0.1 -> 0.2"),
        ("env.base.variant", "real", 'env.base.variant: "sim" -> "real"'),
        ("env.base.clearance", 0.1, "env.base.clearance: (absent) -> 0.1"),
        ("trainer.num_seeds", 2, "trainer.num_seeds: 1 -> 2"),
        ("trainer.total_steps", 200, None),
        ("trainer.threads", 2, None),
        ("name", "b", None),
        ("logger", {}, None),
        ("env.scenarios.two", {"yaw_range": 1.0}, None),
        ("algorithm.agent.actor_lr", 0.01, None),
    ],
)
def test_what_may_change(path, value, line):
    changed = json.loads(json.dumps(BASE))
    *parents, last = path.split(".")
    node = changed
    for parent in parents:
        node = node[parent]
    node[last] = value
    assert len(differences(BASE, changed)) >= 1
    if line is None:
        require_same_run(BASE, changed)
    else:
        with pytest.raises(ValueError) as caught:
            require_same_run(BASE, changed)
        assert f"  {line}\n" in str(caught.value)
