"""A controller with memory: an integral term, which every environment starts anew with every episode."""

from functools import partial

import torch
from point import Point

from rrl.controllers import StatefulController
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


class Integral(StatefulController):
    """Proportional and integral action; the transform resets ``state`` slot by slot."""

    def initial_state(self, tensordict):
        """Return the sum of errors at the start of an episode."""
        return {"sum": torch.zeros_like(self.read(tensordict, "goal"))}

    def act(self, tensordict):
        """Return the displacement, in units of the environment's step."""
        error = self.read(tensordict, "goal") - self.read(tensordict, "position")
        self.state = {"sum": self.state_for(tensordict)["sum"] + error}
        return (4.0 * error + 1.0 * self.state["sum"]).clamp(-0.8, 0.8)


def main(run_dir="outputs/integral_controller", **settings):
    """Train a residual on the integral controller and return the comparison with the controller alone."""
    keys = ["position", "goal"]
    serial = partial(EnvironmentFactory, batching="serial", max_episode_steps=20)
    environment = serial(Point, partial(Integral, keys), [*keys, "base_action"])
    with Trainer(environment, TrainerSettings(num_envs=2, **settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
