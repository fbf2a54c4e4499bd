"""Frozen episodes driven by an exported folder are the trainer's: both graphs, all controllers, all limits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from tensordict.nn import TensorDictModule
from torchrl.envs import DMControlEnv, GymEnv

from agents import random_policy
from benchmarks.deploy.episodes import exported_episode, trainers_episode
from rrl.algorithms import TD3, mlp
from rrl.controllers import (
    Controller,
    PIDController,
    PolicyController,
    ProportionalController,
    ReplayController,
    SumController,
    ZeroController,
)
from rrl.deploy import Policy
from rrl.deploy.archive import torch_graph
from rrl.trainers.configuration import build as assembly
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.export.folder import export_policy
from rrl.transforms import ControlNoise, ObservationDropout, ObservationNoise

EPISODES = 3
CLOSE = 1e-6

proportional = partial(ProportionalController, gain=0.5, unit=0.02, clip=0.5)
pid = partial(PIDController, gain=0.4, integral_gain=0.5, derivative_gain=0.01, unit=0.02, clip=0.5)


def recorded():
    steps = torch.linspace(0.0, 1.0, 30).unsqueeze(-1)
    return torch.cat([0.3 * torch.sin(9 * steps), 0.2 * torch.cos(7 * steps), -0.5 * steps], -1)


def policy_alone():
    """What `controller=policy` builds: a policy that acts alone, in the environment's units."""
    configured = config("env=insertion-sim", "arm=rl", "algorithm=td3")
    return random_policy(assembly.environment(configured), assembly.agent(configured), seed=1)


CONTROLLERS = {
    "proportional": proportional,
    "pid": pid,
    "zero": ZeroController,
    "replay": lambda: ReplayController(recorded(), after_end="zero"),
    "policy": lambda: PolicyController(policy_alone()),
    "sum": lambda: SumController([pid(), ReplayController(recorded())], [0.7, 0.3], clip=0.6),
}


def config(*overrides):
    small = ["algorithm.agent.network.hidden=[64,64]", "logger=[csv]"]
    with initialize_config_module("rrl.configs", version_base="1.3"):
        return OmegaConf.to_container(compose("train", [*small, *overrides]), resolve=True)


def exported(factory, policy, folder, rate):
    """What was exported, on onnxruntime and on torch."""
    assert export_policy(factory, policy, folder)["controller"]["why_outside"] is None
    return Policy(folder, rate), Policy(folder, rate, graph=torch_graph(folder))


def assert_same_episodes(factory, policy, onnx, archive, seed=10):
    for episode in range(seed, seed + EPISODES):
        trainers = trainers_episode(factory, policy, onnx, episode)
        # The very same entries: what is left is rounding.
        np.testing.assert_allclose(trainers.shadow, trainers.commands, rtol=0, atol=CLOSE)
        shadowed = trainers_episode(factory, policy, archive, episode)
        np.testing.assert_array_equal(shadowed.shadow, shadowed.commands)
        # By itself: a step starts from where rounding and contacts have led.
        alone = exported_episode(factory, onnx, episode)
        assert alone.solved == trainers.solved
        assert len(alone.commands) == len(trainers.commands)
        np.testing.assert_array_equal(
            exported_episode(factory, archive, episode).commands, trainers.commands
        )


@pytest.mark.parametrize(
    ("algorithm", "controller"),
    [
        pytest.param("td3-ensemble", "proportional", marks=pytest.mark.slow),
        pytest.param("sac", "pid", marks=pytest.mark.slow),
        *(
            pytest.param("td3-ensemble", name, marks=pytest.mark.slow)
            for name in [*CONTROLLERS][1:]
        ),
        pytest.param("ddpg", "proportional", marks=pytest.mark.slow),
    ],
)
def test_the_insertion_task_with_all_limits(algorithm, controller, tmp_path):
    configured = config("env=insertion-sim", f"algorithm={algorithm}", "safety=all", *WRENCH)
    factory = replace(assembly.environment(configured), controller=CONTROLLERS[controller])
    policy = random_policy(factory, assembly.agent(configured))
    assert_same_episodes(factory, policy, *exported(factory, policy, tmp_path / "export", 20))


WRENCH = ["safety.force.force_key=wrench", "safety.force.axes=[0,1,2]"]


def test_the_default_task_with_its_history_mirrors_and_sensing_faults(tmp_path):
    configured = config("safety=all")
    factory = assembly.environment(configured)
    policy = random_policy(factory, assembly.agent(configured))
    onnx, archive = exported(factory, policy, tmp_path / "export", 20)
    assert [e.name for e in onnx.contract.entries] == [
        "end_effector_position",
        "force_z",
        "blocks",
        "goal",
    ]
    left_out = onnx.contract.content["left_out"]["sensing"]
    assert [node["class"].rpartition(".")[2] for node in left_out] == [
        "ObservationNoise",
        "ObservationLatency",
    ]
    assert_same_episodes(factory, policy, onnx, archive)


YIELDING = ["safety.force.onset=5", "safety.force.retract=0.1", "safety.workspace.delay=2"]
LIMITED = {
    "none": ["env=insertion-real", "safety=none"],
    "all": ["env=insertion-real", "safety=all"],
    "force measured": ["env=insertion-sim", "safety=all", *WRENCH, *YIELDING],
}


@pytest.mark.slow
@pytest.mark.parametrize("limits", LIMITED)
def test_a_scale_of_zero_is_the_controller_to_the_bit(limits, tmp_path):
    configured = config(*LIMITED[limits], "residual_scale=0.0")
    factory = replace(assembly.environment(configured), controller=pid)
    policy = random_policy(factory, assembly.agent(configured))
    for graph in exported(factory, policy, tmp_path / "export", 20):
        for seed in range(EPISODES):
            trainers = trainers_episode(factory, policy, graph, seed)
            np.testing.assert_array_equal(trainers.shadow, trainers.commands)
            alone = exported_episode(factory, graph, seed)
            np.testing.assert_array_equal(alone.commands, trainers.commands)
            assert alone.solved == trainers.solved


class PendulumPD(Controller):
    """Torque from angle and angular velocity; the observation is (cos, sin, velocity)."""

    def act(self, tensordict):
        cos, sin, velocity = self.read(tensordict, "observation").split(1, dim=-1)
        return (-8.0 * torch.atan2(sin, cos) - 2.0 * velocity).clamp(-2.0, 2.0)


ELSEWHERE = {
    "pendulum": EnvironmentFactory(
        base=partial(GymEnv, "Pendulum-v1"),
        controller=partial(PendulumPD, ["observation"]),
        inputs=["observation", "base_action", "previous_action"],
        action_history=3,
    ),
    "point in double precision": EnvironmentFactory(
        base=partial(DMControlEnv, "point_mass", "easy"),
        controller=lambda: TensorDictModule(
            lambda p, v: (-3.0 * p - v).clamp(-0.5, 0.5), ["position", "velocity"], ["base_action"]
        ),
        inputs=["position", "velocity", "previous_action"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ELSEWHERE)
def test_other_environments_whose_faults_stay_theirs(name, tmp_path):
    factory = replace(
        ELSEWHERE[name],
        disturbances=[partial(ControlNoise, mu=0.05, sigma=0.02)],
        sensing=[
            partial(ObservationNoise, [ELSEWHERE[name].inputs[0]], sigma=0.01),
            partial(ObservationDropout, [ELSEWHERE[name].inputs[0]], 0.2, 2),
        ],
        residual_scale=0.5,
        batching="serial",
        max_episode_steps=60,
    )
    policy = random_policy(factory, partial(TD3, network=partial(mlp, hidden=[32, 32])))
    onnx, archive = exported(factory, policy, tmp_path / "export", None)
    assert onnx.contract.rate is None
    for seed in range(EPISODES):
        trainers = trainers_episode(factory, policy, archive, seed)
        with_onnx, with_archive = (exported_episode(factory, g, seed) for g in (onnx, archive))
        np.testing.assert_array_equal(with_archive.commands, trainers.commands)
        np.testing.assert_allclose(with_onnx.commands, trainers.commands, rtol=0, atol=1e-4)
        assert (trainers.shadow != trainers.commands).any()  # what reaches it is disturbed
