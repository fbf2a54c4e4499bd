"""Small runs for the trainer's tests."""

from dataclasses import replace
from functools import partial

import pytest
import torch
from torchrl.modules import AdditiveGaussianModule

from rrl.algorithms import TD3, mlp
from rrl.controllers import ProportionalController
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.loggers import CSVLogger
from rrl.trainers.settings import (
    AcceptanceSettings,
    CheckpointSettings,
    EvaluationSettings,
    TrainerSettings,
)
from rrl.trainers.training.trainer import Trainer
from rrl.transforms import ControlNoise
from toy_envs import EPISODE_STEPS, PointMass, RememberingPointMass


def point_mass(num_envs=1, **arguments):
    return PointMass([num_envs], **arguments)


@pytest.fixture
def factory():
    """A drifting point under a proportional controller that does not know the drift."""
    return EnvironmentFactory(
        base=point_mass,
        controller=partial(ProportionalController, gain=10.0, clip=0.5),
        inputs={"end_effector_position": Input(), "goal": Input()},
        disturbances=[partial(ControlNoise, sigma=0.05)],
        max_episode_steps=EPISODE_STEPS,
    )


@pytest.fixture
def simulated(factory):
    """The same with an environment whose state can be saved."""
    return replace(factory, base=lambda num_envs=1: RememberingPointMass([num_envs]))


@pytest.fixture
def settings():
    """Builds settings of a short run."""

    def make(**changes):
        values = {
            "total_steps": 200,
            "warmup_steps": 100,
            "steps_per_collection": EPISODE_STEPS // changes.get("num_envs", 1),
            "batch_size": 32,
            "evaluation": EvaluationSettings(every=100, episodes=10, final_episodes=10, slots=10),
            "acceptance": AcceptanceSettings(margin=0.4, alpha=0.5, episodes=10),
            "checkpoint": CheckpointSettings(every=100),
        }
        return TrainerSettings(**{**values, **changes})

    return make


@pytest.fixture
def make_trainer(factory, settings, tmp_path):
    """Builds a trainer on the drifting point, by default with small networks."""

    def make(
        run_dir="run", environment=None, agent=None, exploration=None, loggers=None, **changes
    ):
        environment = environment or factory
        return Trainer(
            environment,
            settings(**changes),
            agent or partial(TD3, network=partial(mlp, hidden=[32, 32]), gamma=0.9),
            exploration or partial(AdditiveGaussianModule, sigma_init=0.3, sigma_end=0.3),
            tmp_path / run_dir,
            scenarios={"drift": environment},
            loggers=[CSVLogger()] if loggers is None else loggers,
        )

    return make


@pytest.fixture
def make_tested(make_trainer):
    """The same with the default test of what a run hands over, on enough episodes to pass it."""
    evaluation = EvaluationSettings(every=100, episodes=20, final_episodes=20, slots=10)
    return partial(make_trainer, acceptance=AcceptanceSettings(), evaluation=evaluation)


@pytest.fixture(autouse=True)
def _single_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
