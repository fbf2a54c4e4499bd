"""The ways to collect, by the name of ``trainer.collection``."""

from __future__ import annotations

import logging
from pathlib import Path

from ..environment import EnvironmentFactory
from ..requests import stop_of
from ..settings import TrainerSettings
from .background_collection import InBackground
from .collection import Collection, InTurn
from .interface import Exploration
from .realtime.collection import RealTime

log = logging.getLogger(__name__)


def make_collection(
    settings: TrainerSettings,
    environment: EnvironmentFactory,
    exploration: Exploration,
    run_dir: Path,
) -> Collection:
    """Return what collects the run's transitions."""
    if settings.collection == "realtime":
        return RealTime(settings, environment, exploration, run_dir)
    if settings.collection == "overlap":
        return InBackground(settings, environment, exploration)
    collection = InTurn(settings, environment, exploration)
    if stop_of(collection.env) is not None:
        log.warning(
            "trainer.collection=turn: during updates the robot gets no command and goes on with "
            "its last one until it stops by itself; trainer.collection=realtime does not let it "
            "wait"
        )
    return collection
