"""What the acting process stores of a step, and what the learner makes of it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from ...loggers import metrics
from ...storage.replay_store import as_stored
from ...storage.transition_log import TransitionLog
from ...storage.unusable_records import named, put_neighbors

log = logging.getLogger(__name__)

TIMING = "timing"
"""The entry of a record that says how the step was done."""


class Timing(NamedTuple):
    """How a step was done.

    Attributes:
        first: Whether it is the first one of an episode.
        missed: Steps for which the policy gave no answer in time, since the last record.
        period_error: By how much the control period was too long [s].
        inference: How long the policy took, or was waited for [s].
        weights: Environment steps that the acting policy has learned from.
        faults: Faults of the robot since the last record.
        reset_seconds: How long the reset before it took; 0 within an episode [s].
        time: When the step ended, by the wall clock [s].
    """

    first: bool
    reset_seconds: float
    period_error: float = 0.0
    inference: float = 0.0
    weights: int = 0
    missed: int = 0
    faults: int = 0
    time: float = 0.0


def make_record(td: TensorDictBase, timing: Timing) -> TensorDict:
    """Return a transition ``[1]`` with its timing."""
    step = td if td.ndim else td.unsqueeze(0)
    record = TensorDict(dict(step.items(True, True)), [1])
    for name, value in timing._asdict().items():
        kind = np.asarray(value).dtype
        record[TIMING, name] = torch.from_numpy(np.full((1, 1), value, kind))
    return record


def record_bytes(env: EnvBase) -> int:
    """Return what a record takes; images are in it as they are, before the step and after it."""
    record = make_record(env.fake_tensordict(), Timing(first=True, reset_seconds=0.0))
    return sum(value.numel() * value.element_size() for value in record.values(True, True))


def read_usable(
    records: TransitionLog, first: int, last: int, kept: Sequence[NestedKey]
) -> TensorDict:
    """Return records ``[T]``, of which those that cannot be used are replaced.

    A record that is damaged on disk, or not finite in what is learned from, stays in the log for
    ever; its neighbor stands for it, apart from the steps around it.

    Args:
        records: Of the acting process.
        first: Number of the first record.
        last: Number after the last one.
        kept: What is learned from of a state.

    Raises:
        ValueError: If none near them can be used.
    """
    data, damaged = records.read(first, last)
    if not damaged and not _not_finite(data, kept):
        return data
    start = max(0, 2 * first - last)  # one before them may be the nearest that is sound
    data, damaged = records.read(start, last)
    bad = {number - start for number in damaged} | _not_finite(data, kept)
    here = {number + start for number in bad if number + start >= first}
    log.warning(
        "%d of the acting process's records (%s) are damaged on disk or not finite; each is "
        "replaced by its neighbor, apart from the steps around it",
        len(here),
        named(here),
    )
    if not put_neighbors(data, bad):
        raise ValueError(
            f"{records.folder}: expected a whole record of finite numbers among {start} to "
            f"{last - 1}, got none; see to the sensor, the controller or the disk, and start a new "
            "run"
        )
    apart = {place for number in bad for place in (number, number + 1) if place < len(data)}
    data[TIMING, "first"][sorted(apart)] = True
    return data[first - start :]


def _not_finite(data: TensorDictBase, kept: Sequence[NestedKey]) -> set[int]:
    """Return the places of records that have such a number in what is learned from."""
    stored = as_stored(data.unsqueeze(0), kept)[0]
    floats = [v for v in stored.values(True, True) if v.is_floating_point()]
    bad = torch.stack([~v.isfinite().reshape(len(data), -1).all(-1) for v in floats]).any(0)
    return set(bad.nonzero().flatten().tolist())


def cut_episodes(data: TensorDictBase) -> None:
    """Mark as truncated what was followed by a new episode without being an episode's end.

    Args:
        data: ``[T]`` in the order of time; changed in place.
    """
    cut = data[TIMING, "first"].roll(-1, 0)
    cut[-1] = False  # what follows is not known, and does not matter: nothing sums beyond it
    following = data["next"]
    cut = cut & ~following["done"].reshape(len(data), -1).any(-1, keepdim=True)
    for key in ("done", "truncated"):
        if key in following:
            flag = following[key]
            following[key] = flag | cut.reshape(len(data), *[1] * (flag.ndim - 1))


def timing_metrics(data: TensorDictBase, first_step: int) -> dict[str, float]:
    """Return what a round's timing comes to.

    Args:
        data: Records ``[T]``.
        first_step: Environment steps before them.
    """
    timing = data[TIMING]
    error = 1e3 * timing["period_error"].flatten().abs()
    inference = 1e3 * timing["inference"].flatten()
    age = torch.arange(first_step, first_step + len(data)) - timing["weights"].flatten()
    values = {
        **_percentiles("period_error_ms", error),
        **_percentiles("inference_ms", inference),
        "missed_deadlines": float(timing["missed"].sum()),
        "faults": float(timing["faults"].sum()),
        "policy_age": float(age.double().mean()),
        "reset_seconds": float(timing["reset_seconds"].sum()),
    }
    return {metrics.name(metrics.REALTIME, key): value for key, value in values.items()}


def seconds_of(data: TensorDictBase) -> dict[str, float]:
    """Return the seconds of a round's steps, ``robot``, and of its resets.

    What a step after a reset took is not recorded; it counts as the others' median.
    """
    within = ~data[TIMING, "first"].flatten()[1:]
    steps = data[TIMING, "time"].flatten().diff()[within]
    each = float(steps.median()) if len(steps) else 0.0
    return {"robot": each * len(data), "reset": float(data[TIMING, "reset_seconds"].sum())}


def _percentiles(name: str, values: Tensor) -> dict[str, float]:
    median, high = torch.quantile(values, torch.tensor([0.5, 0.99], dtype=values.dtype)).tolist()
    return {f"{name}_p50": median, f"{name}_p99": high, f"{name}_max": float(values.max())}
