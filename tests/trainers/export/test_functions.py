"""Functions and objects as controllers: inside the graph, or outside with a reason."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch
from torch import nn
from torchrl.data import Bounded

from agents import random_policy
from benchmarks.deploy.episodes import trainers_episode
from rrl.controllers import FunctionController
from rrl.deploy import Policy
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.export.folder import export_policy
from situation_envs import Machine


def make(controller, dtype=torch.float32):
    return EnvironmentFactory(
        base=partial(Machine, action=Bounded(-1.0, 1.0, (2,), dtype=dtype)),
        controller=controller,
        inputs=["position"],
        batching="serial",
        max_episode_steps=8,
    )


@pytest.mark.parametrize("batched", [True, False])
def test_a_function_of_tensors_is_inside(batched, tmp_path):
    torch.manual_seed(0)
    controller = partial(
        FunctionController, nn.Linear(2, 2), ["position"], numpy=False, batched=batched
    )
    factory = make(controller)
    policy = random_policy(factory)
    content = export_policy(factory, policy, tmp_path / "export")
    assert content["controller"]["why_outside"] is None
    exported = Policy(tmp_path / "export")
    assert [e.name for e in exported.contract.entries] == ["position"]
    episode = trainers_episode(factory, policy, exported, seed=1)
    np.testing.assert_allclose(episode.shadow, episode.commands, rtol=0, atol=1e-6)


def pd(position):
    return -0.1 * position


class Law:
    def reset(self):
        self.steps = 0

    def act(self, position):
        self.steps += 1
        return -0.1 * self.steps * position


@pytest.mark.parametrize(
    ("function", "why"), [(pd, "pd calls NumPy"), (Law, "Law remembers outside torch")]
)
@pytest.mark.parametrize(
    "dtype", [torch.float32, pytest.param(torch.float64, marks=pytest.mark.slow)]
)
def test_a_function_outside_says_why(function, why, dtype, tmp_path):
    factory = make(partial(FunctionController, function, ["position"]), dtype)
    content = export_policy(factory, random_policy(factory), tmp_path / "export")
    assert content["controller"]["why_outside"] == why
    entries = {entry["name"]: entry["dtype"] for entry in content["entries"]}
    assert entries == {"position": "float32", "base_action": "float32"}
