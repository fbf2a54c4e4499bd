"""Environments with an empty batch size through every path of the trainer."""

from functools import partial

import imageio.v3 as iio
import numpy as np
import pytest
import torch
from torchrl.data import Unbounded

from rrl.deploy import Policy
from rrl.trainers.environment import Metric
from rrl.trainers.evaluation.rollout import zero_residual
from rrl.trainers.evaluation.video import render_comparison
from rrl.trainers.export.folder import export_policy
from situation_envs import Machine, Simulator

ENTRIES = {"position": Unbounded((2,)), ("metrics", "force"): Unbounded((1,))}
OFTEN = {"evaluation": {"every": 20, "episodes": 2, "final_episodes": 2, "slots": 2}}


class Pushed(Simulator):
    """Better without the residual's push; a success is a small one."""

    def physics_state(self):
        return self._count.numpy().copy()


@pytest.mark.parametrize("overlap", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_trained_tested_handed_over_and_resumed(check_run, factory, overlap):
    """With followed evaluations, tests of policies, a budget, n-step returns and a profile."""
    force = Metric(unit="N", reduce="sum", budget=1.0)
    environment = factory(partial(Pushed, ENTRIES), metrics={"force": force})
    whole, resumed, stored = check_run(
        environment,
        True,
        **OFTEN,
        acceptance={"episodes": 4, "margin": 0.5, "alpha": 0.5},
        n_step=3,
        profile=True,
        collection="overlap" if overlap else "turn",
    )
    assert resumed.store.n_step == 3
    assert stored["position"].shape == (100, 2)
    assert whole["training"].handed_over.residual.returns.shape == (2,)
    assert whole["training"].residual.metrics["force"].shape == (2,)


def test_a_policy_that_passes_is_handed_over(make_trainer, factory):
    """Of returns that are all alike: none is worse than the controller's."""
    acceptance = {"episodes": 20, "margin": 0.99, "alpha": 0.5}
    with make_trainer(factory(Rewarding), acceptance=acceptance, **OFTEN) as trainer:
        found = trainer.run()["training"]
    assert trainer.acceptance.handed_over.env_steps > 0
    assert found.accepted.returns.mean() > found.controller.returns.mean()


class Rewarding(Simulator):
    """Pays for a push in any direction: every residual is better than none."""

    def _step(self, tensordict):
        out = super()._step(tensordict)
        return out.set("reward", tensordict["action"].square().sum(-1, keepdim=True))


def test_filmed(factory, tmp_path):
    def renderer(env, states, width, height):
        assert env.batch_size == ()
        levels = np.concatenate(states).astype(np.uint8) * 20
        return np.broadcast_to(levels[:, None, None, None], (len(states), height, width, 3))

    environment = factory(Pushed)
    policy = zero_residual(environment.make(1))
    size = {"width": 61, "height": 47, "fps": 10}  # odd: no codec of videos takes them
    for ending in ("mp4", "gif"):
        out = tmp_path / f"episode.{ending}"
        render_comparison(environment, policy, renderer, 5, out, size)
        assert out.stat().st_size > 0
        assert iio.imread(out.with_suffix(".png")).shape == (47, 122, 3)


@pytest.mark.slow
def test_exported(make_trainer, factory, tmp_path):
    environment = factory(Machine)
    with make_trainer(environment) as trainer:
        trainer.run()
        export_policy(environment, trainer.policy, tmp_path / "export")
    policy = Policy(tmp_path / "export")
    assert policy.act({"position": np.zeros(2)}).shape == (2,)


@pytest.mark.parametrize("n_step", [1, 3])
@pytest.mark.parametrize("ending", ["truncated", "terminated"])
def test_time_limits_are_no_terminations(make_trainer, factory, ending, n_step):
    """The return of a truncated episode goes on in the critic; that of a terminated one ends."""
    with make_trainer(factory(partial(Machine, ending=ending)), n_step=n_step) as trainer:
        trainer.run()
    stored = trainer.replay.storage[:]["next"]
    over = stored["done"].nonzero().flatten() if n_step == 1 else None
    assert stored["terminated"].any() == (ending == "terminated")
    if n_step == 1:
        assert torch.equal(stored["terminated"], stored["done"] & (ending == "terminated"))
        assert over.tolist()[::2] == [7, 15, 23, 31, 39, 47, 55, 63, 71, 79, 87, 95]
