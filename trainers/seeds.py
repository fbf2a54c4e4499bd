"""Seeds of episodes: training, following, acceptance and final evaluation never meet."""

from __future__ import annotations

import hashlib
from enum import IntEnum

__all__ = ["MAX_SEED", "Stream", "first_seed"]

_BITS = 29
MAX_SEED = 2**28
"""Seeds that a user names are below this; so many episodes, at most, are in an evaluation."""


class Stream(IntEnum):
    """What episodes are for; every stream has 2^29 seeds of its own."""

    TRAINING = 0
    FOLLOWING = 1
    """Frozen episodes that are looked at during training, and by which anything may be chosen."""
    FINAL = 2
    """Frozen episodes of the final evaluation, which nothing is chosen by."""
    ACCEPTANCE = 3
    """Frozen episodes that candidates are tested on; no two candidates of a run get the same."""


def first_seed(stream: Stream, seed: int, after: int = 0) -> int:
    """Return the seed of slot 0; slot ``i`` has this seed plus ``i``.

    Args:
        stream: What the episodes are for.
        seed: Names the set of episodes, from 0 to ``MAX_SEED - 1``. Equal names give equal sets.
        after: Transitions that are stored already, where a run begins anew in their middle, as on
            hardware after a crash.

    Returns:
        A number below 2^31. Streams never meet, as long as none plays more than 2^28 episodes.

    Raises:
        ValueError: If ``seed`` is out of range.
    """
    if not 0 <= seed < MAX_SEED:
        raise ValueError(f"seed: expected 0 to {MAX_SEED - 1}, got {seed}")
    digest = hashlib.blake2b(f"{seed}/{after}".encode(), digest_size=8).digest()
    return (int(stream) << _BITS) + int.from_bytes(digest, "little") % MAX_SEED
