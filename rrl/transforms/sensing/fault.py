"""The base of the faults of sensors."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import NestedKey

from rrl.checks import check_keys
from rrl.transforms.base import RandomTransform

__all__ = ["SensingFault"]


class SensingFault(RandomTransform):
    """A fault that observation entries are read with.

    Args:
        in_keys: The entries.
        out_keys: Where the faulty values go; None: in their place.
        seed: See :class:`~rrl.transforms.base.RandomTransform`.

    Raises:
        ValueError: If there is no key, or another number of out keys.
    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        out_keys: Sequence[NestedKey] | None,
        seed: int | None,
    ) -> None:
        super().__init__(
            seed=seed,
            stream=f"{type(self).__name__}/{in_keys}",
            in_keys=in_keys,
            out_keys=in_keys if out_keys is None else out_keys,
        )
        check_keys(self, self.in_keys, self.out_keys)
