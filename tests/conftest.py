"""For all tests: one thread a process, as several test side by side; SIGHUP means what it means."""

import os
import signal

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # below nohup it is ignored, by children too


@pytest.fixture(scope="session", autouse=True)
def _short_sockets():
    """Tests that start workers by TorchRL alone pass below temporary folders of any length."""
    from rrl.trainers.workers import keep_sockets_short

    keep_sockets_short()
