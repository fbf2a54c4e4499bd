"""A Gymnasium environment: swing a pendulum up, with a PD controller that is too weak far from the top.

Run ``python examples/gymnasium_pd.py``; it needs ``pip install gymnasium``.
"""

from functools import partial

import numpy as np

from rrl.controllers import FunctionController
from rrl.envs import gymnasium_env
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


def pd(observation):
    """Torque [N m], within Pendulum's bounds, from (cos, sin, angular velocity)."""
    cos, sin, velocity = observation
    return np.clip([-8.0 * np.arctan2(sin, cos) - 2.0 * velocity], -2.0, 2.0)


def main(run_dir="outputs/gymnasium_pd", **settings):
    """Train a residual on the PD controller and return the comparison with the controller alone."""
    environment = EnvironmentFactory(
        base=partial(gymnasium_env, "Pendulum-v1"),
        controller=partial(FunctionController, pd),
        inputs=["observation"],
        batching="serial",
        max_episode_steps=200,
    )
    with Trainer(environment, TrainerSettings(**settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
