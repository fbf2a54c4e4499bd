"""Runs that stop and go on, and whether two of them are the same."""

from __future__ import annotations

from typing import Any

import torch

from rrl.trainers import Trainer


def run(trainer: Trainer) -> Trainer:
    """Run to the end and close."""
    with trainer:
        trainer.run()
    return trainer


def run_until(trainer: Trainer, place: str, env_steps: int) -> None:
    """Run until the first call of ``place`` at or after ``env_steps``, and end without a word.

    ``place`` is a dotted name from the trainer on, such as ``store.extend``.
    """
    *parents, name = place.split(".")
    owner: Any = trainer
    for parent in parents:
        owner = getattr(owner, parent)
    original = getattr(owner, name)

    def dying(*args: Any, **kwargs: Any) -> Any:
        result = original(*args, **kwargs)
        if trainer.env_steps >= env_steps:
            raise KeyboardInterrupt
        return result

    object.__setattr__(owner, name, dying)
    try:
        with trainer:
            trainer.run()
    except KeyboardInterrupt:
        return
    raise AssertionError(f"{place} was not called after step {env_steps}")


def assert_same(expected: Any, actual: Any, where: str = "state") -> None:
    """The same tensors and numbers, to the last bit, in nested dictionaries and lists."""
    if isinstance(expected, dict):
        assert expected.keys() == actual.keys(), where
        for key in expected:
            assert_same(expected[key], actual[key], f"{where}.{key}")
    elif isinstance(expected, (list, tuple)):
        assert len(expected) == len(actual), where
        for i, (one, other) in enumerate(zip(expected, actual, strict=True)):
            assert_same(one, other, f"{where}.{i}")
    elif isinstance(expected, torch.Tensor):
        assert torch.equal(expected, actual), where
    else:
        assert expected == actual, where


def assert_same_run(one: Trainer, other: Trainer) -> None:
    """The same learner, stored transitions and policy handed over, to the last bit."""
    assert_same(dict(one.agent.state_dict()), dict(other.agent.state_dict()), "agent")
    assert_same(one.acceptance.state_dict(), other.acceptance.state_dict(), "acceptance")
    stored = [dict(t.replay.storage[:].items(True, True)) for t in (one, other)]
    assert_same(*stored, "transitions")
