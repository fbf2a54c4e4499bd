"""For all tests: one thread a process, because several processes test side by side."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported
