"""Updates of an agent from stored transitions, after what is not set has been derived."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import torch
import yaml
from torch import Tensor

from rrl.algorithms import Agent

from ..loggers import metrics
from ..settings import TrainerSettings
from ..storage.files import write_atomically
from ..storage.finite import require_finite
from ..storage.replay_store import ReplayStore
from ..storage.run_files import DERIVED
from .collection import Metrics
from .constraints import Constraints
from .profiling import Stopwatch


class LearnerGenerator:
    """Lets updates draw from numbers of their own, apart from what collecting draws.

    TorchRL's losses and samplers draw from torch's global generator. What is learned from stored
    transitions must not depend on whether they are collected anew or read from the log.

    Args:
        seed: Of the numbers.
    """

    def __init__(self, seed: int) -> None:
        self._state = torch.Generator().manual_seed(seed).get_state()

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Draw from these numbers while the body runs."""
        before = torch.get_rng_state()
        torch.set_rng_state(self._state)
        try:
            yield
        finally:
            self._state = torch.get_rng_state()
            torch.set_rng_state(before)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the generator's state."""
        return {"state": self._state}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Restore :meth:`state_dict`."""
        self._state = state["state"]


class Learning:
    """Takes the updates of each round.

    Before the first ones the agent derives what is not set from what is stored by then, and the run
    writes it to ``derived.yaml``; the critics' burn-in follows at once.

    Args:
        agent: Learns.
        store: Gives the batches.
        constraints: Charges what they used.
        settings: Of the run.
        run_dir: Where the run writes.
        stopwatch: Times sampling and compiling.
    """

    def __init__(
        self,
        agent: Agent,
        store: ReplayStore,
        constraints: Constraints,
        settings: TrainerSettings,
        run_dir: Path,
        stopwatch: Stopwatch,
    ) -> None:
        self.agent, self.store, self.settings = agent, store, settings
        self.run_dir, self.stopwatch, self.constraints = run_dir, stopwatch, constraints
        self.generator = LearnerGenerator(settings.seed)

    def update(self) -> Metrics:
        """Take a round's updates and return their mean losses.

        Raises:
            FloatingPointError: If a loss is no longer finite.
        """
        updates = self.settings.updates_per_round
        if self.agent.is_calibrated:
            self.agent.follow_rewards(self.store.rewards())
        else:
            self._derive()
            updates += self.agent.settings.critic_burn_in
        compiled = self.agent.compile_seconds
        sums: dict[str, tuple[float, int]] = {}
        with self.generator.drawing():
            for size in self.store.portions(updates):
                with self.stopwatch("sample"):
                    batches = self.store.sample(size)
                    batches = self.constraints.charge(batches, self.agent.reward_scale)
                for key, value in self.agent.update(batches).items():
                    total, count = sums.get(key, (0.0, 0))
                    sums[key] = total + float(value) * size, count + size
        losses = {key: torch.tensor(total / count) for key, (total, count) in sums.items()}
        self.stopwatch.add("compile", self.agent.compile_seconds - compiled)
        require_finite(losses, "the update gave")
        return {metrics.name(metrics.LOSS, key): float(value) for key, value in losses.items()}

    def _derive(self) -> None:
        derived = self.agent.calibrate(self.store.newest(self.agent.readings.calibrated_by))
        derived |= self.settings.lengths
        derived["inputs"] = {str(key): entry for key, entry in derived["inputs"].items()}
        write_atomically(self.run_dir / DERIVED, yaml.safe_dump(derived, sort_keys=False))
