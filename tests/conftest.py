"""For all tests: one thread a process, as several test side by side; SIGHUP means what it means."""

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # below nohup it is ignored, by children too
