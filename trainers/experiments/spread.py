"""How widely the end effector moved while a run explored, from its log of transitions."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..report.runs import Run
from ..storage.transition_log import FOLDER, TransitionLog

POSITIONS = "positions.json"
"""Where a run that is kept without its log has the variance."""
AXES = ("x", "y", "z")
POSITION = "end_effector_position"
CENTIMETERS = 100.0


def keeps_positions(config: Mapping[str, Any]) -> bool:
    """Return whether a run's log has the end effector's position at every step."""
    trainer = config["trainer"]
    return POSITION in config["env"]["inputs"] and (
        trainer["buffer_capacity"] >= trainer["total_steps"]
    )


def spatial_variance(run: Run) -> NDArray[np.float64]:
    """Return the variance of the positions in all stored transitions, by axis, [cm^2].

    Raises:
        FileNotFoundError: If the run has no transitions any more.
    """
    if (run.path / POSITIONS).is_file():
        return np.array(json.loads((run.path / POSITIONS).read_text(encoding="utf-8")))
    log = TransitionLog(run.path / FOLDER)
    if not log.count:
        raise FileNotFoundError(
            f"{run.path}: expected its transitions, of which the variance of its positions is "
            "made, got none; remove this folder, and the run is made again"
        )
    transitions, _ = log.read(0, log.count)
    log.close()
    positions: NDArray[np.float64] = transitions[POSITION].double().numpy()  # (N, axes), [m]
    return (positions * CENTIMETERS).var(axis=0)
