"""How widely the end effector moved while a run explored, from its log of transitions."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..report.runs import Run
from ..storage.transition_log import FOLDER, TransitionLog

if TYPE_CHECKING:
    from .outcomes import Outcome

__all__ = ["POSITIONS", "reads_positions", "spatial_variance", "variances"]

POSITIONS = "positions.json"
"""Where a run that is kept without its log has the variance."""
POSITION = "end_effector_position"
CENTIMETERS = 100.0


def reads_positions(config: Mapping[str, Any]) -> bool:
    """Return whether a run's policy reads the end effector's position."""
    return POSITION in config["env"]["inputs"]


def spatial_variance(run: Run) -> NDArray[np.float64]:
    """Return the variance of the positions in all stored transitions, by axis ``[3]``, [cm^2].

    Raises:
        ValueError: If the policy did not read the position.
    """
    if not reads_positions(run.config):
        inputs = list(run.config["env"]["inputs"])
        raise ValueError(
            f"{run.path}: expected {POSITION!r} among the policy's inputs, got {inputs}"
        )
    if (run.path / POSITIONS).is_file():
        return np.array(json.loads((run.path / POSITIONS).read_text(encoding="utf-8")))
    log = TransitionLog(run.path / FOLDER)
    transitions, _ = log.read(0, log.count)
    log.close()
    positions: NDArray[np.float64] = transitions[POSITION].double().numpy()  # (N, 3), [m]
    return (positions * CENTIMETERS).var(axis=0)


def variances(outcome: Outcome) -> NDArray[np.float64]:
    """Return the spatial variance by seed and axis ``[S, 3]``, [cm^2]."""
    return np.array([spatial_variance(run) for run in outcome.runs])
