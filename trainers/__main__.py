"""``python -m rrl.trainers`` is ``rrl``."""

import sys

from .cli.main import main

sys.exit(main())
