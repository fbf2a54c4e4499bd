"""The base of the faults of sensors."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite

from rrl.checks import check_keys, require
from rrl.transforms.base import Memory, RandomTransform


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
        self, in_keys: Sequence[NestedKey], out_keys: Sequence[NestedKey] | None, seed: int | None
    ) -> None:
        super().__init__(
            seed=seed,
            stream="",
            in_keys=in_keys,
            out_keys=in_keys if out_keys is None else out_keys,
        )
        check_keys(self, self.in_keys, self.out_keys)
        beside = "" if self.out_keys == self.in_keys else f"/{self.out_keys}"
        self.generators.stream = f"{type(self).__name__}/{self.in_keys}{beside}"

    def _read(self, td: TensorDictBase) -> Memory:
        """Return the entries, each by its number."""
        return {str(number): require(self, td, key) for number, key in enumerate(self.in_keys)}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Give what is delivered the specs of the originals."""
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            observation_spec[out_key] = require(self, observation_spec, in_key).clone()
        return observation_spec
