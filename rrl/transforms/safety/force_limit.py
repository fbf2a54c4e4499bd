"""A bound on how hard the robot keeps pressing against what it touches."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check, per_dimension, require
from rrl.keys import ACTION
from rrl.transforms.base import ActionLimits
from rrl.transforms.safety.base import SafetyLimit

__all__ = ["ForceLimit"]


class ForceLimit(SafetyLimit):
    r"""A bound on pressing: less, no or reversed motion against the measured contact force.

    With the measured force f, its direction n = f / \|f\| and the part p = u . n of the
    displacement along it, motion further into the contact has p < 0: the surroundings push back.
    That part is scaled by

        s = clip((limit - \|f\|) / (limit - onset), 0, 1)

    which is 1 up to ``onset`` and 0 from ``limit`` on; motion along the surface and away from it
    passes. Above the limit the part along n is replaced by ``retract``, away from the contact. The
    force is the one measured after the last step: the limit is on what is commanded next. It ends
    sustained pressing; an impact at full speed exceeds it within one control step, unless a
    :class:`~rrl.transforms.StepLimit` keeps the speed low. While the force is not finite, the end
    effector is not moved.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``force_key``, writes ("safety", "force"); see :class:`SafetyLimit`.

    Args:
        limit: Largest force, positive [N].
        onset: Force from which pressing motion is scaled down, in [0, limit) [N]; None: ``limit``,
            so that it is stopped at the limit and not before.
        retract: Size of the motion away from the contact above the limit, in action units, 0 or
            more; 0 stops.
        force_key: Force on the end effector ``[*batch, m]`` [N], in the frame of the action; of a
            wrench the first numbers are used.
        axes: Dimension of the action that each component of the force belongs to.
        action_key: The displacement u, ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If numbers are out of range, or force and axes do not fit the action.
        KeyError: If force or action is missing.
        RuntimeError: If actions pass the inverse without an environment or before a reset.
    """

    def __init__(
        self,
        limit: float,
        onset: float | None = None,
        retract: float = 0.0,
        force_key: NestedKey = "wrench",
        axes: Sequence[int] = (0, 1, 2),
        action_key: NestedKey = ACTION,
    ) -> None:
        super().__init__("force", [force_key], action_key)
        per_dimension("limit", limit, positive=True)
        per_dimension("retract", retract, minimum=0.0)
        below = onset is None or 0 <= onset < limit
        check("onset", onset, f"a force in [0, limit) with the limit {limit:g}", below)
        self.axes = list(axes)
        different = bool(axes) and len(set(axes)) == len(axes) and min(axes) >= 0
        check("axes", self.axes, "different dimensions of the action", different)
        self.maximum, self.onset, self.retract = float(limit), onset, float(retract)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the force, one number for each axis."""
        return require(self, tensordict, self.in_keys[0])[..., : len(self.axes)]

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Change the part of the motion along the force."""
        size = torch.linalg.vector_norm(measured, dim=-1, keepdim=True)
        normal = measured / size.clamp_min(torch.finfo(size.dtype).tiny)
        along = (action[..., self.axes] * normal).sum(-1, keepdim=True)
        wanted = torch.where(along < 0, along * self._share(size), along)
        if self.retract:
            wanted = torch.where(size > self.maximum, wanted.clamp_min(self.retract), wanted)
        safe = action.clone()
        safe[..., self.axes] = action[..., self.axes] + (wanted - along) * normal
        return torch.where(wanted == along, action, safe)

    def _share(self, size: Tensor) -> Tensor:
        """Return how much of a pressing motion is left under forces of this size."""
        if self.onset is None:
            return (size <= self.maximum).to(size)
        return ((self.maximum - size) / (self.maximum - self.onset)).clamp(0.0, 1.0)

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold force and axes to the action's size."""
        for key, size in sizes.items():
            if size < len(self.axes) or max(self.axes) >= action_size:
                raise ValueError(
                    f"axes: expected dimensions of a force of {size} numbers ({key!r}) and an "
                    f"action of {action_size}, got {self.axes}"
                )
