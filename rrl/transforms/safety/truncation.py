"""The end of an episode that a guard asks for."""

from __future__ import annotations

from tensordict import TensorDictBase
from torch import Tensor

__all__ = ["truncate"]


def truncate(tensordict: TensorDictBase, ends: Tensor) -> None:
    """End the episodes of the slots in ``ends``, bool ``[*batch, ..., 1]``."""
    batch = tensordict.batch_size
    for key in list(tensordict.keys(True, True)):
        if (key if isinstance(key, str) else key[-1]) in ("done", "truncated"):
            flag = tensordict.get(key)
            own = ends if ends.shape == flag.shape else ends.reshape(*batch, -1).any(-1)
            own = own.reshape(own.shape + (1,) * (flag.ndim - own.ndim))
            tensordict.set(key, flag | own)
