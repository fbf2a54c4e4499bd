"""What stands in the place of a transition that cannot be used."""

from __future__ import annotations

from collections.abc import Collection

from tensordict import TensorDictBase

NAMED = 5


def put_neighbors(transitions: TensorDictBase, bad: Collection[int]) -> bool:
    """Put the nearest sound transition in the place of each bad one.

    Args:
        transitions: ``[n]``, changed in place.
        bad: Places of those that cannot be used.

    Returns:
        Whether there is a sound one; without any, nothing is changed.
    """
    sound = [i for i in range(len(transitions)) if i not in bad]
    for i in bad if sound else ():
        transitions[i] = transitions[min(sound, key=lambda j: abs(j - i))]
    return bool(sound)


def named(records: Collection[int]) -> str:
    """Return the first few numbers of records, for a message."""
    first = ", ".join(map(str, sorted(records)[:NAMED]))
    return first + (", ..." if len(records) > NAMED else "")
