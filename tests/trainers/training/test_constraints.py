"""A budget is kept, by any learner and in any environment, and a run without one is not touched."""

import csv
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded

from rrl.algorithms import DDPG, SAC, TD3, mlp, no_exploration
from rrl.keys import SO_FAR
from rrl.trainers import EnvironmentFactory, Metric
from rrl.trainers.settings import CheckpointSettings, ConstraintSettings, EvaluationSettings
from rrl.trainers.training.constraints import Constraints
from runs import assert_same_run, run, run_until
from toy_envs import DRIFT, EPISODE_STEPS, STEP_SIZE, RememberingPointMass, ResetsItself

SMALL = {"network": partial(mlp, hidden=[32, 32]), "gamma": 0.9}


class Effort:
    """Reports how hard the point is driven, against the drift and otherwise."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        shape = (*self.batch_size, 1)
        entries = {"effort": Unbounded(shape), "drift": Unbounded(shape)}
        self.observation_spec["metrics"] = Composite(entries, shape=self.batch_size)

    def _reset(self, tensordict=None, **kwargs):
        out = super()._reset(tensordict, **kwargs)
        nothing = torch.zeros(*self.batch_size, 1)
        return out.set("metrics", {"effort": nothing, "drift": nothing.clone()})

    def _step(self, tensordict):
        out = super()._step(tensordict)
        action = tensordict["action"]
        effort, against = action.norm(dim=-1, keepdim=True), -action[..., :1]
        return out.set("metrics", {"effort": effort, "drift": against.clone()})


class Driven(Effort, RememberingPointMass):
    """Can go on from its state."""


class DrivenAndResetsItself(Effort, ResetsItself):
    """Hides an episode's last observation."""


def point(num_envs=1, kind=Driven):
    return kind([num_envs])


def environment(factory, kind=Driven, **metrics) -> EnvironmentFactory:
    declared = {name: Metric(**how) for name, how in metrics.items()}
    return replace(factory, base=partial(point, kind=kind), disturbances=[], metrics=declared)


def test_a_price_says_nothing_of_how_large_rewards_are(make_trainer, factory):
    """A budget that cannot be kept: what is charged grows, the scale of the rewards does not shrink."""
    metrics = {"effort": {"reduce": "sum", "budget": 0.01}}
    agent = partial(TD3, **SMALL, reward_scale=None)
    trainer = make_trainer("charged", environment=environment(factory, **metrics), agent=agent)
    run(trainer)
    free = make_trainer("free", environment=environment(factory), agent=agent)
    run(free)
    assert trainer.constraints.multipliers["effort"].value > 1.0
    assert float(trainer.agent.reward_scale) > 0.5 * float(free.agent.reward_scale)


def last_drift(results) -> float:
    """How hard the point is driven against the drift at the end of an episode."""
    return float(results["drift"].residual.metrics["drift"].mean())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("learner", "explore"),
    [(TD3, None), (DDPG, None), (SAC, no_exploration)],
    ids=["TD3", "DDPG", "SAC"],
)
def test_a_budget_holds_back_what_would_pay(make_trainer, factory, learner, explore):
    """Against the drift it takes 0.6; half of that is allowed, and most of the excess goes soon."""
    needed = DRIFT / STEP_SIZE

    def train(budget) -> tuple[float, Path]:
        trainer = make_trainer(
            f"{learner.__name__}-{budget}",
            environment=environment(factory, drift={"reduce": "last", "budget": budget}),
            agent=partial(learner, **SMALL, reward_scale=10.0),
            exploration=explore,
            total_steps=3000,
            warmup_steps=200,
            n_step=1,
            constraints=ConstraintSettings(rate=0.2),
            evaluation=EvaluationSettings(every=0, episodes=10, final_episodes=40, slots=40),
        )
        with trainer:
            results = trainer.run()
        return last_drift(results), trainer.run_dir

    free, _ = train(None)
    kept, run_dir = train(needed / 2)
    collected = logged(run_dir, "constraint/drift/episode")
    assert free > 0.8 * needed
    assert 0.0 < kept < 0.75 * needed
    assert 0.0 < np.mean(collected[len(collected) // 2 :]) < 0.75 * needed
    assert logged(run_dir, "constraint/drift/multiplier")[-1] > 0.0


def logged(run_dir: Path, metric: str) -> list[float]:
    """The values of a metric in the order of time."""
    with (run_dir / "metrics.csv").open() as file:
        return [float(row["value"]) for row in csv.DictReader(file) if row["metric"] == metric]


def test_without_a_budget_or_without_constraints_the_run_is_the_same(make_trainer, factory):
    plain = run(make_trainer("plain", environment=environment(factory)))
    reported = {"effort": {"reduce": "max", "budget": 0.1, "limit": 0.2}}
    ignored = make_trainer(
        "ignored", environment=environment(factory, **reported), constraints=None
    )
    kept = make_trainer("kept", environment=environment(factory, **reported))
    assert_same_run(plain, run(ignored))
    with pytest.raises(AssertionError):
        assert_same_run(plain, run(kept))


@pytest.mark.parametrize("kind", [Driven, DrivenAndResetsItself])
@pytest.mark.parametrize("reduce", ["max", "sum", "last", "min"])
def test_the_shares_of_the_steps_sum_up_to_what_the_episode_is_reported_with(
    make_trainer, factory, kind, reduce
):
    metrics = {"effort": {"reduce": reduce, "budget": 1.0}}
    trainer = run(
        make_trainer(environment=environment(factory, kind, **metrics), num_envs=2, n_step=1)
    )
    stored = trainer.store.newest().reshape(-1, 2).transpose(0, 1)
    so_far = stored["next", SO_FAR, "effort"].squeeze(-1)
    change = so_far - stored[SO_FAR, "effort"].squeeze(-1)
    effort = (stored["action"] * 0.5).norm(dim=-1)  # the residual's part of it, to begin with
    assert effort.shape == change.shape
    ends = stored["next", "done"].squeeze(-1)
    for slot in range(2):
        start = 0
        for end in (ends[slot].nonzero().flatten() + 1).tolist():
            assert end - start == EPISODE_STEPS
            torch.testing.assert_close(
                change[slot, start:end].sum(), so_far[slot, end - 1], atol=1e-4, rtol=1e-4
            )
            start = end


class Clocked:
    """What it reports grows to the end of an episode."""

    def _step(self, tensordict):
        steps = self._steps + 1.0
        return super()._step(tensordict).set("metrics", {"effort": steps, "drift": -steps})


class DrivenByTheClock(Clocked, Driven):
    """Is reset from outside."""


class DrivenByTheClockAndResetsItself(Clocked, DrivenAndResetsItself):
    """Hides an episode's last observation, not what it has cost."""


@pytest.mark.parametrize("kind", [DrivenByTheClock, DrivenByTheClockAndResetsItself])
@pytest.mark.parametrize("length", [1, 5])
@pytest.mark.parametrize(
    ("reduce", "each"), [("max", max), ("sum", sum), ("last", lambda x: x[-1])]
)
def test_an_episodes_last_step_is_charged(make_trainer, factory, kind, length, reduce, each):
    declared = environment(factory, effort={"reduce": reduce, "budget": 1.0})
    base = lambda num_envs: kind([num_envs], episode_steps=length)  # noqa: E731
    trainer = make_trainer(environment=replace(declared, base=base), num_envs=2, n_step=1)
    with trainer:
        stored, _ = trainer.collection.collect(0)
    ends = stored["next", "done"]
    assert ends.sum() == ends.numel() // length
    expected = float(each([float(step) for step in range(1, length + 1)]))
    assert (stored["next", SO_FAR, "effort"][ends] == expected).all()
    change = stored["next", SO_FAR, "effort"] - stored[SO_FAR, "effort"]
    assert change.sum() == expected * ends.sum()
    assert (stored[SO_FAR, "effort"][:, ::length] == 0).all()


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize("n_step", [1, 3])
def test_a_run_that_died_goes_on_at_the_same_price(make_trainer, factory, n_step, collection):
    arguments = {
        "environment": environment(factory, effort={"reduce": "max", "budget": 0.3}),
        "n_step": n_step,
        "collection": collection,
        "checkpoint": CheckpointSettings(every=40),
    }
    whole = run(make_trainer("whole", **arguments))
    run_until(make_trainer("torn", **arguments), "store.extend", 150)
    torn = make_trainer("torn", **arguments)
    torn.resume()
    assert_same_run(whole, run(torn))
    assert torn.constraints.state_dict() == whole.constraints.state_dict()
    assert whole.constraints.state_dict()["effort"] > 0.0


def test_transitions_from_the_log_move_the_price_as_they_did_when_they_were_collected(
    make_trainer, factory
):
    """Hardware cannot go back: what was stored after the checkpoint is learned from again."""

    class Hardware(Effort, type(factory.base())):
        """Cannot go on from its state."""

    arguments = {
        "environment": environment(factory, Hardware, effort={"reduce": "max", "budget": 0.3}),
        "n_step": 3,
        "checkpoint": CheckpointSettings(every=40),
    }
    dying = make_trainer("torn", **arguments)
    run_until(dying, "agent.update", 130)
    torn = make_trainer("torn", **arguments)
    torn.resume()
    pending = torn.store.pending
    assert pending
    with torn:
        while torn.store.pending:
            torn._round()
    assert torn.constraints.state_dict() == dying.constraints.state_dict()


def test_price_and_cost_are_logged(make_trainer, factory):
    metrics = {"effort": {"reduce": "max", "budget": 0.3}}
    trainer = run(make_trainer(environment=environment(factory, **metrics)))
    text = (trainer.run_dir / "metrics.csv").read_text()
    assert "constraint/effort/multiplier" in text
    assert "constraint/effort/episode" in text


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        ({"reduce": "mean", "budget": 1.0}, "expected one of max, min, sum, last as reduce"),
        ({"reduce": "max", "budget": 0.0}, "greater than 0"),
    ],
)
def test_a_budget_that_cannot_be_kept_is_refused(metric, message):
    with pytest.raises(ValidationError, match=message):
        Metric(**metric)


def test_a_budget_for_a_last_value_needs_single_steps(make_trainer, factory):
    metrics = {"drift": {"reduce": "last", "budget": 1.0}}
    with pytest.raises(ValueError, match="n_step: expected 1 with a budget for the last"):
        make_trainer(environment=environment(factory, **metrics), n_step=3)


def test_a_budget_for_what_the_environment_does_not_write_is_refused(make_trainer, factory):
    with pytest.raises(ValueError, match="metrics: expected names that the environment writes"):
        make_trainer(environment=environment(factory, force={"reduce": "max", "budget": 1.0}))


@pytest.mark.parametrize("metrics", [{"effort": {"reduce": "max", "budget": 0.3}}, {}])
def test_a_run_goes_on_with_its_own_budgets(make_trainer, factory, metrics):
    given = {"effort": {"reduce": "max", "budget": 0.8}}
    run(make_trainer("run", environment=environment(factory, **given)))
    other = make_trainer("run", environment=environment(factory, **metrics))
    with other, pytest.raises(ValueError, match=r"environment\.metrics\.effort"):
        other.resume()


@pytest.mark.parametrize("scale", [2.0, -2.0])
def test_a_budget_costs_whatever_the_sign_of_the_rewards(scale):
    effort = {"effort": Metric(reduce="sum", budget=1.0)}
    constraints = Constraints(effort, ConstraintSettings(initial=2.0), n_step=1)
    used = {SO_FAR: {"effort": torch.zeros(1, 1)}}
    following = {"reward": torch.zeros(1, 1), SO_FAR: {"effort": torch.ones(1, 1)}}
    charged = constraints.charge(TensorDict({**used, "next": following}, [1]), torch.tensor(scale))
    assert float(charged["next", "reward"]) * scale == pytest.approx(-2 / 3)
