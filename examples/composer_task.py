"""A dm_control composer task that is not ours: a Jaco arm reaches for a point.

The controller moves three joints along the Jacobian of one posture; elsewhere it is only roughly right.
"""

import torch
from dm_control import manipulation
from torch.nn.functional import pad

from rrl.controllers import Controller
from rrl.envs import ComposerEnv
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


class TransposedJacobian(Controller):
    """Joint velocities along J^T (target - hand), nine motors of which the wrist and the fingers rest."""

    # hand (x, y, z) by joint, m/rad
    JACOBIAN = torch.tensor([[-0.35, 0.0, 0.0], [0.0, 0.0, -0.3], [0.0, -0.4, 0.2]])

    def act(self, tensordict):
        """Return joint velocities in rad/s."""
        target, hand = (self.read(tensordict, key).flatten(-2) for key in KEYS)
        return pad((10.0 * (target - hand) @ self.JACOBIAN).clamp(-0.6, 0.6), (0, 6))


KEYS = ["target_position", "jaco_arm/jaco_hand/pinch_site_pos"]


def main(run_dir="outputs/composer_task", **settings):
    """Train a residual on the Jacobian controller and return the comparison with the controller alone."""
    environment = EnvironmentFactory(
        base=lambda: ComposerEnv(manipulation.load("reach_site_features")),
        controller=lambda: TransposedJacobian(KEYS),
        inputs=[*KEYS, "jaco_arm/joints_pos"],
        batching="serial",
        max_episode_steps=250,
    )
    with Trainer(environment, TrainerSettings(**settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
