"""Inference that nobody has to wait for."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type


class PolicyThread:
    """Runs a policy in a thread of its own, so that the loop goes on where it takes too long.

    Args:
        policy: From observation keys to ``action``, exploration included.
        flush_denormals: Whether denormal numbers count as zero, which every thread decides for
            itself.

    Attributes:
        seconds: How long the last answer took; of one that did not come in time, how long was
            waited.
    """

    def __init__(self, policy: TensorDictModuleBase, flush_denormals: bool) -> None:
        self.policy, self.seconds = policy, 0.0
        self._pool = ThreadPoolExecutor(1, "policy", torch.set_flush_denormal, (flush_denormals,))
        self._running: Future[TensorDictBase] | None = None

    @property
    def idle(self) -> bool:
        """Whether no inference is under way."""
        return self._running is None or self._running.done()

    def ask(self, td: TensorDictBase, explores: bool, until: float) -> TensorDictBase | None:
        """Return what the policy makes of ``td``.

        Args:
            td: What the policy sees; left as it is.
            explores: Whether exploration adds its noise.
            until: How long to wait, by ``time.monotonic()``.

        Returns:
            A copy with the action; None if there is none in time, or the one before is not there.
        """
        began = time.monotonic()
        if not self.idle:
            self.seconds = 0.0
            return None
        self._running = self._pool.submit(self._infer, td.copy(), explores)
        try:
            return self._running.result(max(0.0, until - began))
        except NotYet:
            return None
        finally:
            self.seconds = time.monotonic() - began

    def wait(self) -> None:
        """Wait for the inference under way."""
        if self._running is not None:
            self._running.exception()

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown()

    def _infer(self, tensordict: TensorDictBase, explores: bool) -> TensorDictBase:
        kind = ExplorationType.RANDOM if explores else ExplorationType.DETERMINISTIC
        with torch.no_grad(), set_exploration_type(kind):
            return self.policy(tensordict)
