"""Environments in processes of their own: one learner collects from two copies at once (``ParallelEnv``)."""

from functools import partial

from point import Point

from rrl.controllers import ProportionalController
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


def main(run_dir="outputs/parallel_envs", **settings):
    """Train a residual on a proportional controller and return the comparison with the controller alone."""
    environment = EnvironmentFactory(
        base=Point,
        max_episode_steps=20,
        controller=partial(ProportionalController, position_key="position", gain=5.0),
        inputs=["position", "goal"],
        batching="parallel",
    )
    with Trainer(environment, TrainerSettings(num_envs=2, **settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
