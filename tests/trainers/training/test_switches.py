"""Switches of the trainer: n-step returns, annealed exploration, what the policy reads."""

from dataclasses import replace
from functools import partial

import pytest
import torch
from pydantic import ValidationError
from torchrl.modules import AdditiveGaussianModule

from rrl.algorithms import SAC, mlp, no_exploration
from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv
from rrl.n_step import STEPS
from rrl.trainers import CheckpointSettings, EnvironmentFactory, EvaluationSettings, Input
from rrl.transforms import ControlNoise, StepLimit


def test_exploration_decays_over_the_environment_steps_of_a_seed_and_resumes_where_it_was(
    make_trainer,
):
    decaying = partial(
        AdditiveGaussianModule, sigma_init=0.4, sigma_end=0.1, annealing_num_steps=150
    )
    first = make_trainer(exploration=decaying, total_steps=100, warmup_steps=40)
    first.run()
    first.close()
    assert float(first.collection.exploration.sigma) == pytest.approx(0.2, rel=1e-4)
    second = make_trainer(exploration=decaying, total_steps=200, warmup_steps=40)
    second.resume()
    assert float(second.collection.exploration.sigma) == float(first.collection.exploration.sigma)
    second.run()
    second.close()
    assert float(second.collection.exploration.sigma) == pytest.approx(0.1, rel=1e-4)


def test_the_stored_action_is_the_one_that_acted(make_trainer, factory):
    trainer = make_trainer(
        environment=replace(factory, disturbances=[ControlNoise]),
        total_steps=200,
        controller_steps=0,
    )
    data = trainer.collection.rollout(0)
    executed = (data["base_action"] + factory.residual_scale * data["action"]).clamp(-1.0, 1.0)
    torch.testing.assert_close(data["next", "executed_action"], executed)
    transitions, _ = trainer.collection.collect(20)
    trainer.store.extend(transitions)
    assert torch.equal(trainer.replay.storage[:]["action"], transitions["action"][0])
    assert transitions["action"].abs().max() > 0
    trainer.close()


def test_the_policy_reads_the_controllers_action_and_its_own_last_ones(make_trainer, factory):
    inputs = {"goal": Input(), "base_action": Input(), "previous_action": Input(scale=2.0)}
    trainer = make_trainer(
        environment=replace(factory, inputs=inputs, action_history=2),
        total_steps=200,
        controller_steps=0,
    )
    data = trainer.collection.rollout(trainer.env_steps)  # [1, T]
    said = data["action"][0]
    features = trainer.agent.encoder(*(data[key][0] for key in inputs))
    goal, base_action, older, last = features.split(2, -1)
    assert torch.equal(goal, data["goal"][0])
    assert torch.equal(base_action, data["base_action"][0])
    assert torch.equal(last[1:], 2.0 * said[:-1])
    assert torch.equal(older[2:], 2.0 * said[:-2])
    assert said.any()
    assert not last[0].any()
    trainer.run()
    trainer.close()


def test_n_step_transitions_are_stored_and_learned_from(make_trainer):
    trainer = make_trainer(n_step=3, num_envs=2)
    trainer.run()
    trainer.close()
    steps = trainer.replay.storage[:][STEPS].reshape(-1, 10, 2)  # rounds, time, environments
    assert (steps[:, :-2] == 3).all()
    assert (steps[:, -2] == 2).all()
    assert (steps[:, -1] == 1).all()


def test_n_step_reaches_no_further_than_a_collection(settings):
    with pytest.raises(ValidationError, match="n_step"):
        settings(n_step=21)


@pytest.mark.slow
def test_a_stochastic_policy_resumes_as_if_never_stopped(make_trainer):
    """SAC with n-step returns and a safety limit: the acting policy's generators are part of the checkpoint."""
    environment = EnvironmentFactory(
        partial(InsertionEnv, variant="sim", seed=0),
        partial(ProportionalController, gain=0.5, clip=0.5, unit=0.02),
        ["end_effector_position", "goal"],
        safety=[partial(StepLimit, change=0.3)],
        max_episode_steps=50,
    )
    make = partial(
        make_trainer,
        environment=environment,
        agent=partial(SAC, network=partial(mlp, hidden=[16, 16])),
        exploration=no_exploration,
        n_step=2,
        warmup_steps=40,
        total_steps=120,
        evaluation=EvaluationSettings(every=0, final_episodes=1, slots=1),
        checkpoint=CheckpointSettings(every=40),
    )
    whole, first = make("whole"), make("broken", total_steps=80)
    whole.run()
    first.run()
    first.close()
    second = make("broken")
    second.resume()
    second.run()
    expected, resumed = whole.agent.state_dict(), second.agent.state_dict()
    for name, value in expected.items():
        if isinstance(value, torch.Tensor):
            assert torch.equal(value, resumed[name]), name
    assert (whole.replay.storage[:] == second.replay.storage[:]).all()
    whole.close()
    second.close()
