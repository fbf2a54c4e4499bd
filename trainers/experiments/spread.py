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

POSITION = "end_effector_position"
CENTIMETRES = 100.0


def spatial_variance(run: Run) -> dict[int, NDArray[np.float64]]:
    """Variance along each axis of the positions in all stored transitions, by seed, [cm^2].

    Raises:
        ValueError: if the policy did not read the position, or the environment does not tell the sizes of its entries.
    """
    inputs, sizes = run.config["env"]["inputs"], entries(run.config["env"]["base"])
    if POSITION not in inputs or sizes is None:
        raise ValueError(
            f"{run.path}: expected {POSITION!r} among the inputs {list(inputs)} of an environment of ours"
        )
    keys = list(inputs)
    first = sum(sizes[key] for key in keys[: keys.index(POSITION)])
    columns = slice(first, first + sizes[POSITION])
    log = TransitionLog(run.path / FOLDER)
    transitions, _ = log.read(0, log.count)
    log.close()
    entry = Input(**(inputs[POSITION] or {}))
    scale = entry.column(POSITION, entry.scale, sizes[POSITION]).double().numpy()
    positions = transitions[OBSERVATION].double().numpy()[:, columns] / scale * CENTIMETRES
    return {run.seed: positions.var(axis=0)}


def variances(outcome: Outcome) -> NDArray[np.float64]:
    """Spatial variance by seed and axis ``[S, 3]``, [cm^2]."""
    by_seed = {seed: value for run in outcome.runs for seed, value in spatial_variance(run).items()}
    return np.array([by_seed[seed] for seed in outcome.seeds])
