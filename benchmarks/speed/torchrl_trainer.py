"""TorchRL's own TD3Trainer on our environment and transforms."""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import CatTensors, EnvBase, ObservationNorm
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate, TD3Loss
from torchrl.trainers.algorithms.td3 import TD3OptimizationStepper, TD3Trainer

from benchmarks.speed.meter import Meter
from benchmarks.speed.networks import Networks
from benchmarks.speed.task import Config
from rrl.trainers import EnvironmentFactory


def td3_trainer(config: Config, options: argparse.Namespace, meter: Meter) -> None:
    """TorchRL's ``TD3Trainer``: as many updates as frames after every collection."""
    from rrl.trainers.configuration import build as assembly

    agent, trainer, frames = (
        config["algorithm"]["agent"],
        config["trainer"],
        config["trainer"]["steps_per_collection"],
    )
    env = _environment(assembly.environment(config))
    env.set_seed(trainer["seed"])
    loss = _loss(agent, Networks(agent, env.observation_spec["observation"].shape[-1]))
    sigma = config["algorithm"]["exploration"]["sigma_init"]
    explore = AdditiveGaussianModule(
        env.action_spec, sigma_init=sigma, sigma_end=sigma, annealing_num_steps=1
    )
    collector = Collector(
        env,
        TensorDictSequential(loss.actor_network, explore),
        frames_per_batch=frames,
        total_frames=trainer["total_steps"],
        init_random_frames=trainer["warmup_steps"],
    )
    warnings.simplefilter("ignore")  # that it is a prototype
    learner = TD3Trainer(
        collector=collector,
        total_frames=trainer["total_steps"],
        frame_skip=1,
        optim_steps_per_batch=frames,
        loss_module=loss,
        optimization_stepper=TD3OptimizationStepper(
            torch.optim.Adam(loss.actor_network_params.values(True, True), agent["actor_lr"]),
            torch.optim.Adam(loss.qvalue_network_params.values(True, True), agent["critic_lr"]),
            policy_update_delay=agent["policy_delay"],
        ),
        target_net_updater=SoftUpdate(loss, tau=agent["tau"]),
        replay_buffer=TensorDictReplayBuffer(
            storage=LazyTensorStorage(trainer["total_steps"]), batch_size=trainer["batch_size"]
        ),
        exploration_module=explore,
        clip_grad_norm=False,
        progress_bar=False,
        enable_logging=False,
        auto_log_optim_steps=False,
        seed=trainer["seed"],
    )
    keys = ["observation", "action", ("next", "observation"), ("next", "reward"), ("next", "done")]

    def needed(batch: TensorDictBase) -> TensorDict:
        batch["next", "reward"] *= agent["reward_scale"]
        return batch.select(*keys, ("next", "terminated"))  # type: ignore[no-any-return]

    learner.register_op("batch_process", needed)
    learner.register_op("post_steps", lambda: meter.step(learner.collected_frames))
    learner.train()


def _environment(factory: EnvironmentFactory) -> EnvBase:
    """Our environment with the normalized inputs as one ``observation``."""
    env = factory.make(1)
    inputs = factory.read_inputs(env)
    normalized = [f"normalized {key}" for key in inputs]
    for (key, entry), name in zip(inputs.items(), normalized, strict=True):
        loc, scale = entry.column("loc"), 1 / entry.column("scale")
        env.append_transform(ObservationNorm(loc, scale, [key], [name], standard_normal=True))
    env.append_transform(CatTensors(normalized, "observation", del_keys=False))
    return env


def _loss(agent: dict[str, Any], nets: Networks) -> TD3Loss:
    class Critic(nn.Module):
        def __init__(self, network: nn.Module) -> None:
            super().__init__()
            self.network = network

        def forward(self, observation: Tensor, action: Tensor) -> Tensor:
            return self.network(torch.cat([observation, action], -1))  # type: ignore[no-any-return]

    loss = TD3Loss(
        TensorDictModule(nets.actor, ["observation"], ["action"]),
        [
            TensorDictModule(Critic(c), ["observation", "action"], ["state_action_value"])
            for c in nets.critics
        ],
        bounds=(-1.0, 1.0),
        policy_noise=agent["target_noise"],
        noise_clip=agent["target_noise_clip"],
        loss_function="l2",
    )
    loss.make_value_estimator(gamma=agent["gamma"])
    return loss
