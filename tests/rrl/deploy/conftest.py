"""An exported policy with memory."""

import pytest

from exports import RATE, export_with_memory
from rrl.deploy import Policy


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """What was exported; nobody writes into it."""
    return export_with_memory(tmp_path_factory.mktemp("point") / "export")


@pytest.fixture
def policy(folder):
    return Policy(folder, RATE)
