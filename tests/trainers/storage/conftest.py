"""Runs that were stopped."""

from functools import partial

import pytest


@pytest.fixture
def make(make_trainer, simulated):
    return partial(make_trainer, environment=simulated)


@pytest.fixture
def stopped(make, tmp_path):
    """A run of 200 steps with checkpoints at 100 and 200, and its directory."""
    trainer = make()
    trainer.run()
    trainer.close()
    return tmp_path / "run"
