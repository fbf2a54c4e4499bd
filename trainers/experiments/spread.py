"""How widely the end effector moved while a run explored, from its log of transitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..report.runs import Run
from ..storage.transition_log import FOLDER, TransitionLog
from .outcomes import Outcome

__all__ = ["spatial_variance", "variances"]

POSITION = "end_effector_position"
CENTIMETERS = 100.0


def spatial_variance(run: Run) -> NDArray[np.float64]:
    """Return the variance of the positions in all stored transitions, by axis ``[3]``, [cm^2].

    Raises:
        ValueError: If the policy did not read the position.
    """
    inputs = run.config["env"]["inputs"]
    if POSITION not in inputs:
        raise ValueError(
            f"{run.path}: expected {POSITION!r} among the policy's inputs, got {list(inputs)}"
        )
    log = TransitionLog(run.path / FOLDER)
    transitions, _ = log.read(0, log.count)
    log.close()
    positions: NDArray[np.float64] = transitions[POSITION].double().numpy()  # (N, 3), [m]
    return (positions * CENTIMETERS).var(axis=0)


def variances(outcome: Outcome) -> NDArray[np.float64]:
    """Return the spatial variance by seed and axis ``[S, 3]``, [cm^2]."""
    return np.array([spatial_variance(run) for run in outcome.runs])
