"""A task of the dm_control suite: a point mass on a plane, with a proportional controller that overshoots."""

from functools import partial

from torchrl.envs import DMControlEnv

from rrl.controllers import Controller
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


class Spring(Controller):
    """Force towards the target in the middle, without damping."""

    def act(self, tensordict):
        """Return the two motors' commands in [-1, 1]."""
        return (-5.0 * self.read(tensordict, "position")).clamp(-1.0, 1.0)


def main(run_dir="outputs/control_suite", **settings):
    """Train a residual on the spring and return the comparison with the spring alone."""
    environment = EnvironmentFactory(
        base=partial(DMControlEnv, "point_mass", "easy"),
        controller=partial(Spring, in_keys=["position"]),
        inputs=["position", "velocity"],
        batching="serial",
    )
    with Trainer(environment, TrainerSettings(**settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
