"""Environments that draw from the global generators of Python, NumPy and torch."""

from functools import partial

import numpy as np
import pytest

from runs import assert_same_run
from situation_envs import Careless, batched

EVALUATED = {"evaluation": {"every": 60, "episodes": 3, "final_episodes": 4, "slots": 4}}


def careless(factory, batching):
    base = partial(batched, Careless) if batching == "native" else Careless
    return factory(base, batching=batching)


@pytest.mark.parametrize("batching", ["serial", "native"])
def test_frozen_episodes_are_frozen_and_a_seed_fixes_the_run(make_trainer, factory, batching):
    trainers, found = [], []
    for name in ("one", "other"):
        with make_trainer(careless(factory, batching), name, **EVALUATED) as trainer:
            found.append(trainer.run()["training"])
        trainers.append(trainer)
    assert_same_run(*trainers)
    for comparison in found:
        assert comparison.frozen
        starts = 1 if batching == "native" else 4  # the slots of a batch share what is drawn
        assert len(set(comparison.controller.returns)) == starts
    np.testing.assert_array_equal(found[0].residual.returns, found[1].residual.returns)


@pytest.mark.parametrize("batching", ["serial", pytest.param("parallel", marks=pytest.mark.slow)])
def test_it_is_resumed(check_run, factory, batching):
    whole, resumed, _ = check_run(
        careless(factory, batching), num_envs=2, steps_per_collection=10, **EVALUATED
    )
    assert whole["training"].frozen
    assert not resumed.collection.can_continue
