"""A camera: dm_control's reacher, whose target only the picture shows.

Run ``python examples/pixels.py``; it needs OpenGL, EGL or OSMesa where there is no display.
"""

from functools import partial

from torchrl.envs import DMControlWrapper

import rrl.envs  # noqa: F401 - before dm_control, to find an OpenGL that works
from rrl.controllers import Controller
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


class Brake(Controller):
    """Damp both joints: all that can be done blindly."""

    def act(self, tensordict):
        """Return the two motors' commands in [-1, 1]."""
        return (-0.05 * self.read(tensordict, "velocity")).clamp(-1.0, 1.0)


def make_base():
    """Return the task with a picture of 64 x 64 pixels beside its observations."""
    from dm_control import suite

    task, size = suite.load("reacher", "easy"), {"height": 64, "width": 64, "camera_id": 0}
    return DMControlWrapper(task, from_pixels=True, pixels_only=False, render_kwargs=size)


def main(run_dir="outputs/pixels", **settings):
    """Train a residual that sees on the brake and return the comparison with the brake alone."""
    environment = EnvironmentFactory(
        base=make_base,
        controller=partial(Brake, in_keys=["velocity"]),
        inputs=["pixels", "position", "velocity"],  # not to_target
        batching="serial",
    )
    with Trainer(environment, TrainerSettings(**settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
