"""A budget: the residual may gain what it can, but its episodes' hardest push stays within 0.8 on the average.

What counts is reported by the environment: ``point.py`` writes ``("metrics", "effort")``. Its budget is one argument of
``Metric``; how fast the learner's price for using it up adapts is ``TrainerSettings(constraints={"rate": 0.05})``.
"""

from functools import partial

from point import Point

from rrl.controllers import ProportionalController
from rrl.trainers import EnvironmentFactory, Metric, Trainer, TrainerSettings


def main(run_dir="outputs/budget", budget=0.8, **settings):
    """Train a residual within the budget and return the comparison with the controller alone."""
    environment = EnvironmentFactory(
        base=Point,
        max_episode_steps=20,
        controller=partial(ProportionalController, position_key="position", gain=2.0),
        inputs=["position", "goal"],
        batching="serial",
        metrics={"effort": Metric(reduce="max", budget=budget)},
    )
    with Trainer(environment, TrainerSettings(**settings), run_dir=run_dir) as trainer:
        return trainer.run()["training"].summary()


if __name__ == "__main__":
    print(main())
