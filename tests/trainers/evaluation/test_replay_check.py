"""Frozen episodes are shown to be frozen before anything is paired."""

import logging
import random
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import EvaluationSettings
from toy_envs import PointMass

AGAINST = TensorDictModule(
    lambda base: torch.zeros_like(base) - torch.tensor([0.6, 0.0]),
    in_keys=["base_action"],
    out_keys=["action"],
)
"""The residual that removes the drift."""
GLOBAL = {
    "Python": lambda n: [random.random() for _ in range(n)],
    "NumPy": lambda n: np.random.rand(n).tolist(),  # noqa: NPY002
    "torch": lambda n: torch.rand(n).tolist(),
}


class OwnStart(PointMass):
    """Draws its goals as ``draw`` does, whatever its seed is."""

    def __init__(self, *args, draw, silent=False, **kwargs):
        super().__init__(*args, **kwargs)
        self.__dict__["draw"], self._silent = draw, silent

    def _reset(self, tensordict=None, **kwargs):
        out = super()._reset(tensordict, **kwargs)
        drawn = torch.tensor(self.draw(2 * max(self.batch_size.numel(), 1)))
        self._goal = drawn.reshape(*self.batch_size, 2).float() - 0.5
        return out.update({"goal": self._goal})

    def _step(self, tensordict):
        out = super()._step(tensordict)
        if self._silent:  # nothing that an evaluation counts tells the episodes apart
            out["reward"], out["success"] = torch.zeros(1), torch.zeros(1, dtype=torch.bool)
        return out


class OwnNoise(PointMass):
    """Starts where its seed says, and is pushed by a generator that nobody seeds."""

    generator = np.random.default_rng(0)

    def _step(self, tensordict):
        self._drift[0] = self.generator.normal(0.06, 0.02)
        return super()._step(tensordict)


class Cycling(OwnStart):
    """Goes through three tasks in order, whatever its seed is."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, draw=self._next, **kwargs)
        self._turn = 0

    def _next(self, n):
        self._turn = (self._turn + 1) % 3
        return [self._turn / 3] * n


def unseeded():
    return np.random.default_rng(0).random


@pytest.fixture
def compare(factory):
    """Compares the residual that removes the drift with the controller, on 20 episodes."""

    def compare(kind, batching="serial", **arguments):
        def base(num_envs=None):
            return kind([] if num_envs is None else [num_envs], **arguments)

        made = replace(factory, base=base, batching=batching)
        evaluator = Evaluator({"drift": made}, EvaluationSettings(slots=10))
        compared = []
        for seed in (3, 4):  # the surroundings are never the same
            random.seed(seed), np.random.seed(seed), torch.manual_seed(seed)  # noqa: NPY002
            compared.append(evaluator.compare(AGAINST, "drift", Stream.FINAL, 20))
        evaluator.close()
        return compared[0], evaluator, compared[1]

    return compare


@pytest.mark.parametrize("generator", GLOBAL)
def test_episodes_drawn_from_a_global_generator_are_frozen_by_seeding_it(
    compare, generator, caplog
):
    found, _, again = compare(OwnStart, draw=GLOBAL[generator])
    assert found.frozen
    assert len(set(found.controller.returns)) == 20
    assert (found.residual.returns == again.residual.returns).all()
    assert found.summary()["rescues"] == len(found.rescues) > 0
    assert not caplog.records


@pytest.mark.parametrize("batching", ["serial", "native"])
def test_an_environment_that_is_right_is_paired(compare, batching, caplog):
    found, _, _ = compare(PointMass, batching)
    assert found.frozen
    assert {"rescues", "regressions", "mcnemar_p"} <= set(found.summary())
    assert "fisher_p" not in found.summary()
    assert not caplog.records


NOT_FROZEN = {
    "starts from a generator of its own": (OwnStart, "serial", lambda: {"draw": unseeded()}),
    "the same in a batch": (OwnStart, "native", lambda: {"draw": unseeded()}),
    "tasks in turn": (Cycling, "serial", dict),
    "pushed by a generator of its own": (OwnNoise, "serial", dict),
}


@pytest.mark.parametrize("kind", NOT_FROZEN)
def test_episodes_that_cannot_be_played_again_are_independent_samples(compare, kind, caplog):
    base, batching, arguments = NOT_FROZEN[kind]
    found, evaluator, _ = compare(base, batching, **arguments())
    assert not evaluator.is_frozen("drift")
    assert not found.frozen
    assert len(found.rescues) == len(found.regressions) == 0
    summary = found.summary()
    assert summary["frozen"] == 0
    assert not {"rescues", "regressions", "rescue_rate", "regression_rate", "mcnemar_p"} & set(
        summary
    )
    assert 0 <= summary["fisher_p"] <= 1
    (record,) = caplog.records  # once, however often it is asked
    assert record.levelno == logging.WARNING
    message = record.getMessage()
    for part in ("drift: ", "set_seed", "Python's random", "NumPy", "torch", "McNemar"):
        assert part in message
    assert ("all slots of a batch share" in message) == (batching == "native")


def test_episodes_that_only_look_alike_are_found_out(compare):
    found, _, _ = compare(OwnStart, draw=unseeded(), silent=True)
    assert set(found.controller.returns) == {0.0}
    assert not found.frozen


@pytest.mark.slow
def test_the_message_says_where_an_episode_differs(compare, caplog):
    compare(OwnNoise)
    assert "from step 1 on, in 'end_effector_position'" in caplog.text
    caplog.clear()
    compare(OwnStart, draw=unseeded())
    assert "episode 2 differs from its start on, in 'goal'" in caplog.text


def test_generators_are_put_back(factory):
    evaluator = Evaluator({"drift": replace(factory)}, EvaluationSettings())
    random.seed(7), np.random.seed(7), torch.manual_seed(7)  # noqa: NPY002
    expected = [draw(3) for draw in GLOBAL.values()]
    random.seed(7), np.random.seed(7), torch.manual_seed(7)  # noqa: NPY002
    assert evaluator.is_frozen("drift")
    assert [draw(3) for draw in GLOBAL.values()] == expected
    evaluator.close()
