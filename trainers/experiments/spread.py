"""How widely the end effector moved while a run explored, from its log of transitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rrl.keys import OBSERVATION

from ..configuration.checks import entries
from ..environment import Input
from ..report.runs import Run
from ..storage.transition_log import FOLDER, TransitionLog
from .outcomes import Outcome

__all__ = ["spatial_variance", "variances"]

POSITION = "end_effector_position"
CENTIMETERS = 100.0


def spatial_variance(run: Run) -> NDArray[np.float64]:
    """Return the variance of the positions in all stored transitions, by axis ``[3]``, [cm^2].

    Raises:
        ValueError: If the policy did not read the position, or the environment does not tell the
            sizes of its entries.
    """
    inputs, sizes = run.config["env"]["inputs"], entries(run.config["env"]["base"])
    if POSITION not in inputs or sizes is None:
        raise ValueError(
            f"{run.path}: expected {POSITION!r} among the inputs of one of our environments, "
            f"got {list(inputs)}"
        )
    keys = list(inputs)
    first = sum(sizes[key] for key in keys[: keys.index(POSITION)])
    columns = slice(first, first + sizes[POSITION])
    log = TransitionLog(run.path / FOLDER)
    transitions, _ = log.read(0, log.count)
    log.close()
    entry = Input(**(inputs[POSITION] or {}))
    scale = entry.column(POSITION, entry.scale, sizes[POSITION]).double().numpy()
    observations = transitions[OBSERVATION].double().numpy()  # (N, n)
    return (observations[:, columns] / scale * CENTIMETERS).var(axis=0)


def variances(outcome: Outcome) -> NDArray[np.float64]:
    """Return the spatial variance by seed and axis ``[S, 3]``, [cm^2]."""
    return np.array([spatial_variance(run) for run in outcome.runs])
