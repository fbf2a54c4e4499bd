"""Small runs of other people's environments, which are killed in the middle and resumed."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.modules import AdditiveGaussianModule

from rrl.algorithms import TD3, mlp
from rrl.controllers import ZeroController
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings
from rrl.trainers.loggers import CSVLogger
from rrl.trainers.loggers.base import MetricsLogger

SETTINGS = {
    "total_steps": 100,
    "warmup_steps": 40,
    "steps_per_collection": 20,
    "batch_size": 16,
    "n_step": 1,
    "updates_per_step": 0.5,
    "buffer_capacity": 1000,
    "evaluation": {"every": 0, "episodes": 2, "final_episodes": 2, "slots": 2},
    "acceptance": {"episodes": 2},
    "checkpoint": {"every": 40},
}
KILLED_AT = 60  # environment steps; the newest checkpoint is of 40


class Snapshot(MetricsLogger):
    """Copies the run's directory when the run is at a step: what a SIGKILL would leave."""

    def __init__(self, out, env_steps):
        self.out, self.env_steps = out, env_steps

    def start(self, run_dir, config, env_steps):
        self.run_dir = Path(run_dir)

    def log(self, values, env_steps):
        if env_steps == self.env_steps and not self.out.exists():
            shutil.copytree(self.run_dir, self.out)


@pytest.fixture(autouse=True)
def _single_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def factory():
    """Builds a factory around a base environment, by default without a controller."""

    def make(base, inputs=("position",), **changes):
        values = {"controller": ZeroController, "batching": "serial", "max_episode_steps": 12}
        return EnvironmentFactory(base=base, inputs=list(inputs), **{**values, **changes})

    return make


@pytest.fixture
def make_trainer(tmp_path):
    """Builds a trainer with small networks."""

    def make(environment, run_dir="run", loggers=(), scenarios=None, **changes):
        return Trainer(
            environment,
            TrainerSettings(**{**SETTINGS, **changes}),
            partial(TD3, network=partial(mlp, hidden=(16,))),
            partial(AdditiveGaussianModule, sigma_init=0.3, sigma_end=0.3),
            tmp_path / run_dir,
            scenarios=scenarios,
            loggers=[CSVLogger(), *loggers],
        )

    return make


@pytest.fixture
def check_run(make_trainer, tmp_path):
    """Trains to the end, resumes what a kill on the way would have left, and compares both.

    Returns what the first run came to, the trainer that resumed, and the stored transitions.
    """

    def check(environment, simulation=False, killed_at=KILLED_AT, **changes):
        left = tmp_path / "left"
        with make_trainer(environment, "run", [Snapshot(left, killed_at)], **changes) as trainer:
            whole = trainer.run()
            total = trainer.settings.total_steps
            parameters = trainer.agent.state_dict()
            assert trainer.env_steps == total
        assert left.is_dir(), "nobody was killed"
        with make_trainer(environment, "left", **changes) as resumed:
            resumed.resume()
            assert 0 < resumed.env_steps < total
            again = resumed.run()
            assert resumed.env_steps == total
            stored = resumed.store.newest()
            assert resumed.store.log.count == total
            assert resumed.collection.can_continue == simulation
        for results in (whole, again):
            for comparison in results.values():
                assert np.isfinite(comparison.residual.returns).all()
        if simulation:
            for name, value in resumed.agent.state_dict().items():
                if isinstance(value, torch.Tensor):
                    assert torch.equal(value, parameters[name]), name
            for name, comparison in whole.items():
                np.testing.assert_array_equal(
                    comparison.residual.returns, again[name].residual.returns
                )
        return whole, resumed, stored

    return check
