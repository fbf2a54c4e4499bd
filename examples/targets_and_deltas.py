"""Two kinds of actions: absolute targets and displacements.

The residual is added in the environment's action units, with ``residual_scale`` half ranges of authority. What an
action means decides what that is worth:

* Displacements: the controller commands a share of the error, the whole range of the action is one step of motion, and
  a residual with the full authority (1.0) can overrule the controller.
* Absolute targets: the controller commands the goal itself. The range of the action is the whole workspace; with full
  authority a residual would send the point anywhere, and exploration noise would be metres. Its authority should be the
  size of the correction: here three times the drift of 0.06 m a step, in a half range of 1 m.
"""

from functools import partial

from point import Point
from tensordict.nn import TensorDictModule

from rrl.controllers import ProportionalController
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings


def main(run_dir="outputs/targets_and_deltas", **settings):
    """Train a residual on each kind of action and return the two comparisons with the controller alone."""
    proportional = partial(ProportionalController, position_key="position", gain=5.0)
    go_to_goal = TensorDictModule(lambda goal: goal.clone(), ["goal"], ["base_action"])
    point = partial(
        EnvironmentFactory, inputs=["position", "goal"], batching="serial", max_episode_steps=20
    )
    environments = {
        "deltas": point(base=Point, controller=proportional, residual_scale=1.0),
        "targets": point(
            base=partial(Point, absolute=True), controller=lambda: go_to_goal, residual_scale=0.18
        ),
    }
    results = {}
    for name, environment in environments.items():
        folder = f"{run_dir}/{name}"
        with Trainer(environment, TrainerSettings(**settings), run_dir=folder) as trainer:
            results[name] = trainer.run()["training"].summary()
    return results


if __name__ == "__main__":
    print(main())
