"""TorchRL's parallel environments, with states that can be restored."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from torchrl.envs import ParallelEnv

__all__ = ["RestorableParallelEnv"]


class RestorableParallelEnv(ParallelEnv):
    """A :class:`torchrl.envs.ParallelEnv` whose next step after a restored state is its own.

    TorchRL 0.14 leaves the workers' flags for "done" set when they have loaded a state. Every later
    step then returns before the workers have made it, with what a step before wrote.
    """

    def load_state_dict(self, state_dict: OrderedDict[str, Any], **kwargs: Any) -> None:
        """Restore the workers' states."""
        super().load_state_dict(state_dict, **kwargs)
        flags = getattr(self, "_shm_done_flags", None)
        for i in range(len(flags or ())):
            flags[i] = 0  # all are set: a worker sets its own before the event waited for above
