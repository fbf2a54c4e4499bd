"""The ways to collect, by the name of ``trainer.collection``."""

from __future__ import annotations

from pathlib import Path

from ..environment import EnvironmentFactory
from ..settings import TrainerSettings
from .background_collection import InBackground
from .collection import Collection, InTurn
from .interface import Exploration
from .realtime.collection import RealTime

__all__ = ["make_collection"]


def make_collection(
    settings: TrainerSettings,
    environment: EnvironmentFactory,
    exploration: Exploration,
    run_dir: Path,
) -> Collection:
    """Return what collects the run's transitions."""
    if settings.collection == "realtime":
        return RealTime(settings, environment, exploration, run_dir)
    collect = {"turn": InTurn, "overlap": InBackground}[settings.collection]
    return collect(settings, environment, exploration)
