"""A frozen policy checkpoint as the controller: learn from nothing, save, and put a residual on what was learned."""

from functools import partial

import torch
from point import Point

from rrl.controllers import PolicyController, ZeroController
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


def main(run_dir="outputs/frozen_policy", **settings):
    """Train a policy without a controller, then a residual on that policy; return the second comparison."""
    read = ["position", "goal"]
    point = partial(EnvironmentFactory, Point, inputs=read, batching="serial", max_episode_steps=20)
    alone = point(controller=partial(ZeroController, action_size=2))
    untested = TrainerSettings(**settings | {"acceptance": {"enabled": False}})  # by no controller
    with Trainer(alone, untested, run_dir=f"{run_dir}/alone") as trainer:
        trainer.run()
    policy = trainer.policy  # reads position and goal
    torch.save(policy.state_dict(), f"{run_dir}/policy.pt")

    environment = point(
        controller=partial(PolicyController, policy, f"{run_dir}/policy.pt"), residual_scale=0.5
    )
    with Trainer(
        environment, TrainerSettings(**settings), run_dir=f"{run_dir}/residual"
    ) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
