"""For all tests: one thread a process, as several test side by side; SIGHUP means what it means.

Tests that start workers by TorchRL alone pass below temporary folders of any length.
"""

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # below nohup it is ignored, by children too

from rrl.trainers.worker_sockets import keep_sockets_short  # noqa: E402

keep_sockets_short()
