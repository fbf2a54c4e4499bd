"""What an environment reports: reduced as it is declared, refused where it is of another kind."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.data import Composite, Unbounded

from rrl.trainers.evaluation.episodes import Comparison, Episodes
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.evaluation.rollout import run_episodes, zero_residual
from rrl.trainers.metric import Metric
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import EvaluationSettings
from toy_envs import PointMass


class Reporting(PointMass):
    """Reports its steps so far, and whether it is right of its goal; success as 0.0 or 1.0.

    Args:
        extra: More observation entries, by name, as they are.
    """

    def __init__(self, *args, extra=None, **kwargs):
        self.__dict__["extra"] = extra or {}
        super().__init__(*args, **kwargs)
        batch = self.batch_size
        spec = self.observation_spec
        spec["success"] = Unbounded((*batch, 1))
        spec["metrics"] = Composite(
            clock=Unbounded((*batch, 1)),
            right=Unbounded((*batch, 1), dtype=torch.bool),
            shape=batch,
        )
        for name, value in self.extra.items():
            spec[name] = Unbounded((*batch, *value.shape))
        self.observation_spec = spec

    def _observe(self):
        out = super()._observe()
        right = (self._position - self._goal)[..., :1] > 0
        out |= {"success": out["success"].float()}
        out |= {"metrics": {"clock": self._steps.float(), "right": right}}
        return out | {k: v.expand(*self.batch_size, *v.shape) for k, v in self.extra.items()}


ZERO = TensorDictModule(torch.zeros_like, in_keys=["base_action"], out_keys=["action"])
"""The zero residual for any batch size."""


def reporting(factory, batching="native", **arguments):
    base = (
        (lambda num_envs=1: Reporting([num_envs], **arguments))
        if batching == "native"
        else partial(Reporting, [], **arguments)
    )
    return replace(factory, base=base, batching=batching)


@pytest.mark.parametrize("batching", ["native", "serial"])
def test_metrics_are_reduced_as_declared(factory, batching):
    values = {}
    for how in ("min", "max", "sum", "last", "mean"):
        declared = {"clock": Metric(unit="steps", reduce=how, limit=15.0)}
        made = replace(reporting(factory, batching), metrics=declared)
        evaluator = Evaluator({"one": made}, EvaluationSettings())
        compared = evaluator.compare(ZERO, "one", Stream.FINAL, 1)
        evaluator.close()
        values[how] = compared.residual.metrics["clock"].item()
        assert compared.summary()["metrics/clock_above_limit"] == float(values[how] > 15)
        assert 0 <= compared.residual.metrics["right"].item() <= 1  # undeclared: the mean
    assert values == {"min": 1, "max": 20, "sum": 210, "last": 20, "mean": 10.5}


def test_the_summary_holds_every_metric_with_its_tail(factory):
    made = reporting(factory)
    env = made.make(4)
    found = run_episodes(env, zero_residual(env), 4, seed=0, max_steps=50)
    assert found.success.dtype == bool
    record = Comparison(found, found).record()
    for prefix in ("", "controller_"):
        assert record["summary"][f"{prefix}metrics/clock"] == 10.5
        assert record["summary"][f"{prefix}metrics/clock_p99"] == 10.5
        assert record["episodes"][f"{prefix}metrics/clock"] == [10.5] * 4
    assert set(record["episodes"]) == {
        *("success", "controller_success", "return", "controller_return"),
        *("metrics/clock", "metrics/right", "controller_metrics/clock", "controller_metrics/right"),
    }


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8, torch.int64])
def test_success_may_be_a_number(factory, dtype):
    class Numbers(PointMass):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            self.observation_spec["success"] = Unbounded((*self.batch_size, 1), dtype=dtype)

        def _observe(self):
            out = super()._observe()
            return {**out, "success": out["success"].to(dtype)}

    env = replace(factory, base=lambda num_envs=1: Numbers([num_envs])).make(20)
    assert env.rollout(2)["success"].dtype == torch.bool
    plain = factory.make(20)
    against = TensorDictModule(
        lambda: torch.tensor([-0.6, 0.0]).expand(20, 2), in_keys=[], out_keys=["action"]
    )
    found, expected = (run_episodes(e, against, 20, seed=0, max_steps=50) for e in (env, plain))
    assert (found.success == expected.success).all()
    assert expected.success.any()


@pytest.mark.parametrize("name", ["success", "diverged"])
def test_a_share_is_no_flag_and_what_is_no_number_is_no_success(factory, name):
    class Shares(PointMass):
        told = 0.0

        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            self.observation_spec[name] = Unbounded((*self.batch_size, 1))

        def _observe(self):
            return super()._observe() | {name: torch.full((*self.batch_size, 1), self.told)}

    base = Shares([1])
    env = replace(factory, base=lambda num_envs=1: base).make(1)
    for base.told, flag in ((0.0, False), (1.0, True), (np.nan, name == "diverged")):
        assert env.rollout(1)["next", name].all() == flag
    base.told = 0.3
    with pytest.raises(ValueError, match=f"environment: {name}: expected a flag, 0 or 1, got 0.3"):
        env.reset()


def test_a_number_that_is_not_known_is_above_its_bounds():
    values = {"force": np.array([1.0, np.nan, 3.0, 2.0])}
    declared = {"force": Metric(unit="N", reduce="max", budget=2.0, limit=3.0)}
    zeros = np.zeros(4)
    said = Episodes(zeros, zeros, None, zeros, values, declared=declared).summary()
    assert said["metrics/force_above_budget"] == 0.5
    assert said["metrics/force_above_limit"] == 0.25


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({"safety": torch.zeros(1)}, "safety: expected named entries"),
        ({"reward_terms": torch.zeros(2)}, "reward_terms: expected named entries"),
        (
            {"diverged": torch.zeros(2)},
            r"diverged: expected one number a slot .*got a tensor \[2\]",
        ),
    ],
)
def test_a_reserved_entry_of_another_kind_is_refused(factory, extra, message):
    with pytest.raises(ValueError, match=f"environment: {message}"):
        reporting(factory, extra=extra).make(2)


def test_a_metric_of_several_numbers_or_an_unknown_one_is_refused(factory):
    class Vector(Reporting):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            shape = (*self.batch_size, 3)
            self.observation_spec["metrics", "force"] = Unbounded(shape)

    made = replace(factory, base=lambda num_envs=1: Vector([num_envs]))
    with pytest.raises(ValueError, match=r"metrics/force: expected one number.*a tensor \[3\]"):
        made.make(2)
    made = replace(reporting(factory), metrics={"clocks": Metric()})
    with pytest.raises(ValueError, match=r"writes \['clock', 'right'\], got \['clocks'\]"):
        made.make(1)


@pytest.mark.parametrize("name", ["force_p99", "force_above_limit", "force_above_budget"])
def test_a_metric_called_like_what_is_derived_is_refused(factory, name):
    class Named(Reporting):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            self.observation_spec["metrics", name] = Unbounded((*self.batch_size, 1))

    with pytest.raises(ValueError, match=f"names without the endings .*got {name}"):
        replace(factory, base=lambda num_envs=1: Named([num_envs])).make(2)


class Misspelt(PointMass):
    """Writes its success under a name that nothing reads."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        spec = self.observation_spec
        spec["is_success"] = spec["success"]
        del spec["success"]
        self.observation_spec = spec

    def _observe(self):
        out = super()._observe()
        return out | {"is_success": out.pop("success")}


@pytest.mark.parametrize(("env", "said"), [(Misspelt, 1), (PointMass, 0)])
def test_an_environment_without_success_is_named_once(factory, caplog, env, said):
    made = replace(factory, base=partial(env, []), batching="serial")
    evaluator = Evaluator({"one": made}, EvaluationSettings())
    with caplog.at_level("INFO", logger="rrl"):
        for stream in (Stream.FOLLOWING, Stream.FINAL):
            evaluator.compare(ZERO, "one", stream, 1)
    evaluator.close()
    assert caplog.text.count("one: the environment writes no `success`") == said
