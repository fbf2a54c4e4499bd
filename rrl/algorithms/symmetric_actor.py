"""An actor that acts alike in all mirror images of a task."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from rrl.algorithms.networks import StackedMLP
from rrl.symmetry import Symmetry

__all__ = ["SymmetricActor"]


class SymmetricActor(nn.Module):
    """The mean over all images of what ``actor`` says: the images of an observation get images of one action.

    Args:
        actor: from observations to one or more numbers for each dimension of the action; the first are signed, all
            further ones magnitudes.
        symmetry: of the task.

    """

    def __init__(self, actor: StackedMLP, symmetry: Symmetry) -> None:
        super().__init__()
        self.actor, self.symmetry = actor, symmetry
        self.num_seeds = actor.num_seeds

    def forward(self, *inputs: Tensor) -> Tensor:
        """Map ``[..., n]`` to ``[..., out]``."""
        said = self.actor(self.symmetry.images(torch.cat(inputs, -1)))  # (..., G, out)
        signed, *magnitudes = said.split(self.symmetry.action_size, -1)
        parts = [self.symmetry.return_actions(signed)]
        parts += [self.symmetry.return_actions(part, signed=False) for part in magnitudes]
        return torch.cat(parts, -1).mean(-2)
