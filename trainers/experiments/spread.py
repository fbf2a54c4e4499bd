"""How widely a run moved while it explored, from its log of transitions."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from ..report.runs import Run
from ..storage.transition_log import FOLDER, TransitionLog
from .spec import Spread


def spatial_variance(run: Run, spread: Spread) -> NDArray[np.float64]:
    """Return the variance of an entry in all stored transitions, by axis, in its unit squared.

    Raises:
        FileNotFoundError: If the run has no transitions any more.
        ValueError: If the entry has not as many numbers as axes.
    """
    if (run.path / spread.file).is_file():
        found = np.array(json.loads((run.path / spread.file).read_text(encoding="utf-8")))
    else:
        found = _of_log(run, spread)
    if found.shape != (len(spread.axes),):
        raise ValueError(
            f"{run.path}: expected the axes {', '.join(spread.axes)} of {spread.entry!r}, "
            f"got the shape {found.shape}"
        )
    return found


def _of_log(run: Run, spread: Spread) -> NDArray[np.float64]:
    log = TransitionLog(run.path / FOLDER)
    if not log.count:
        raise FileNotFoundError(
            f"{run.path}: expected its transitions, of which the variance of its {spread.name}s is "
            "made, got none; remove this folder, and the run is made again"
        )
    transitions, _ = log.read(0, log.count)
    log.close()
    values: NDArray[np.float64] = transitions[spread.entry].double().numpy()  # (N, axes)
    return (values * spread.factor).var(axis=0)
