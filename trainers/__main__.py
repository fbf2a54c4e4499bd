"""``python -m rrl.trainers`` is ``rrl``."""

import sys

from .cli import main

sys.exit(main())
