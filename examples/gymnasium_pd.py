"""A Gymnasium environment: swing a pendulum up, with a PD controller that is too weak far from the top.

Run ``python examples/gymnasium_pd.py``; it needs ``pip install gymnasium``.
"""

from functools import partial

import torch
from torchrl.envs import GymEnv

from rrl.controllers import Controller
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


class PD(Controller):
    """Torque from angle and angular velocity; Pendulum's observation is (cos, sin, velocity)."""

    def act(self, tensordict):
        """Return the torque in N m, within Pendulum's bounds."""
        cos, sin, velocity = self.read(tensordict, "observation").split(1, dim=-1)
        return (-8.0 * torch.atan2(sin, cos) - 2.0 * velocity).clamp(-2.0, 2.0)


def main(run_dir="outputs/gymnasium_pd", **settings):
    """Train a residual on the PD controller and return the comparison with the controller alone."""
    environment = EnvironmentFactory(
        base=partial(GymEnv, "Pendulum-v1"),
        controller=partial(PD, in_keys=["observation"]),
        inputs=["observation"],
        batching="serial",
    )
    with Trainer(TrainerSettings(**settings), environment, run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
