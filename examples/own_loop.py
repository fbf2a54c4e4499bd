"""Transforms and loss alone: a residual in TorchRL's own collector and replay buffer, without our trainer."""

import torch
from point import Point
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import CatTensors, Compose
from torchrl.modules import MLP, AdditiveGaussianModule, SafeModule, SafeSequential
from torchrl.objectives import SoftUpdate

from rrl import ControlNoise, EnsembleTD3Loss, ProportionalController, ResidualAction


def make_env():
    """The point under controller and residual, with noise on the sum of both."""
    controller = ProportionalController(position_key="position", gain=5.0)
    chain = Compose(
        ControlNoise(sigma=0.05),
        ResidualAction(controller, scale=0.8),
        CatTensors(["position", "goal", "base_action"], "observation", del_keys=False),
    )
    return TransformedEnv(Point(), chain)


def main(total_steps=5000):
    """Train by TD3 with five critics and return the mean reward of the last collection."""
    env = make_env()
    network = torch.nn.Sequential(
        MLP(in_features=6, out_features=2, num_cells=[64, 64]), torch.nn.Tanh()
    )
    actor = SafeModule(network, in_keys=["observation"], out_keys=["action"])
    critic = SafeModule(
        MLP(out_features=1, in_features=8, num_cells=[64, 64]),
        ["observation", "action"],
        ["state_action_value"],
    )
    loss = EnsembleTD3Loss(
        actor, critic, num_qvalue_nets=5, action_spec=env.action_spec, delay_actor=True
    )
    loss.make_value_estimator(gamma=0.9)
    targets = SoftUpdate(loss, tau=0.01)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(total_steps), batch_size=64)
    behavior = SafeSequential(
        actor, AdditiveGaussianModule(env.action_spec, sigma_init=0.3, sigma_end=0.3)
    )
    collector = Collector(
        env,
        behavior,
        frames_per_batch=20,
        total_frames=total_steps,
        auto_register_policy_transforms=False,
    )
    for data in collector:
        buffer.extend(data.reshape(-1))
        for _ in range(20):
            losses = loss(buffer.sample())
            (losses["loss_actor"] + losses["loss_qvalue"]).backward()
            optimizer.step()
            optimizer.zero_grad()
            targets.step()
    return float(data["next", "reward"].mean())


if __name__ == "__main__":
    print(main())
