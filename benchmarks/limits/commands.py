"""The worst commands that can be thought of, and an optimizer that looks for worse ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

STEPS = 50
"""Control steps of an episode."""
BATCH = 50
"""Episodes side by side: what the cross-entropy method draws at a time."""

Draw = Callable[[torch.Generator], Tensor]
"""From a generator to commands ``[BATCH, STEPS, 3]``."""


def held(low: int, high: int, generator: torch.Generator) -> Tensor:
    """Return random corners of the action's cube, each held for ``low`` to ``high`` steps."""
    corners = torch.randn(BATCH, STEPS, 3, generator=generator).sign()
    lengths = torch.randint(low, high + 1, (BATCH, STEPS), generator=generator).cumsum(1)
    which = torch.searchsorted(
        lengths, torch.arange(STEPS).expand(BATCH, -1).contiguous(), right=True
    )
    return corners.gather(1, which.unsqueeze(-1).expand(-1, -1, 3))


def into_the_table(generator: torch.Generator) -> Tensor:
    """Return full speed ahead for a while, beyond the blocks or not, then down for good."""
    commands = held(STEPS, STEPS, generator)
    away = torch.randint(0, 15, (BATCH, 1), generator=generator)
    down = torch.arange(STEPS) >= away
    commands[..., 2] = torch.where(down, -1.0, torch.zeros(()))
    commands[..., :2] *= (~down).unsqueeze(-1)
    return commands


def into_the_blocks(generator: torch.Generator) -> Tensor:
    """Return down beside a block or into the gap, then full speed sideways, again and again."""
    commands = held(3, 12, generator)
    first = torch.randint(8, 35, (BATCH, 1), generator=generator)
    down = torch.arange(STEPS) < first
    commands[..., 2] = torch.where(down, -1.0, commands[..., 2])
    commands[..., :2] *= torch.where(down, 0.3, torch.ones(())).unsqueeze(-1)
    return commands


def oscillation(generator: torch.Generator) -> Tensor:
    """Return square waves of random periods about a way down, each axis with its own."""
    time = torch.arange(STEPS).reshape(1, -1, 1)
    period = torch.randint(2, 16, (BATCH, 1, 3), generator=generator)
    phase = torch.randint(0, 16, (BATCH, 1, 3), generator=generator)
    wave = 1.0 - 2.0 * ((time + phase) % period >= period / 2)
    wave[..., 2] = torch.where(time[..., 0] < 12, -1.0, wave[..., 2])
    return wave


SCRIPTED: dict[str, Draw] = {
    "into the table": into_the_table,
    "into the blocks": into_the_blocks,
    "oscillation": oscillation,
    "random": partial(held, 1, 1),
    "random, held": partial(held, 2, 10),
}


class CrossEntropy:
    """Commands, held for two steps each, from a normal distribution that moves to the worst.

    Args:
        generator: Draws.
    """

    HOLD, ELITE, KEPT, LEAST = 2, BATCH // 6, 0.2, 0.08

    def __init__(self, generator: torch.Generator) -> None:
        self.generator = generator
        self.mean = torch.zeros(STEPS // self.HOLD, 3)
        self.mean[:, 2] = -1.0  # where there is something to be hit
        self.deviation = torch.full_like(self.mean, 0.7)

    def draw(self) -> Tensor:
        """Return commands ``[BATCH, STEPS, 3]``."""
        noise = torch.randn(BATCH, *self.mean.shape, generator=self.generator)
        self.drawn = self.mean + self.deviation * noise
        return self.drawn.clamp(-1, 1).repeat_interleave(self.HOLD, 1)

    def learn(self, harm: Tensor) -> None:
        """Move to the commands that did most harm, ``[BATCH]``."""
        worst = self.drawn[harm.topk(self.ELITE).indices]
        self.mean = self.KEPT * self.mean + (1 - self.KEPT) * worst.mean(0)
        spread = self.KEPT * self.deviation + (1 - self.KEPT) * worst.std(0)
        self.deviation = spread + self.LEAST
