"""An actor that acts alike in all mirror images of a task."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from rrl.symmetry import Symmetry


class SymmetricActor(nn.Module):
    """The mean over all mirror images of what an actor gives.

    Images of an observation get images of one action.

    Args:
        actor: From features ``[*batch, n]`` to one or more numbers for each dimension of the
            action; the first are signed, all further ones are magnitudes.
        symmetry: Of features and action.
    """

    def __init__(self, actor: nn.Module, symmetry: Symmetry) -> None:
        super().__init__()
        self.actor, self.symmetry = actor, symmetry

    def forward(self, features: Tensor) -> Tensor:
        """Map ``[*batch, n]`` to ``[*batch, out]``."""
        outputs = self.actor(self.symmetry.images(features))  # (*batch, G, out)
        signed, *magnitudes = outputs.split(self.symmetry.action_size, -1)
        parts = [self.symmetry.return_actions(signed)]
        parts += [self.symmetry.return_actions(part, signed=False) for part in magnitudes]
        return torch.cat(parts, -1).mean(-2)
