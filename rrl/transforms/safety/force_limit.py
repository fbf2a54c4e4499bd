"""A bound on how hard the robot pushes against what it touches."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check, check_length, per_dimension, require
from rrl.keys import ACTION
from rrl.transforms.base import ActionLimits
from rrl.transforms.safety.base import SafetyLimit
from rrl.transforms.safety.sums import dot, norm


class ForceLimit(SafetyLimit):
    r"""A bound on the contact force, by the distance that a command may move the set point.

    A compliant robot pushes with its stiffness times the distance between set point and tool, and
    hits what is in its way with an impulse in proportion to its speed, which is that distance in a
    control step. Both grow with the displacement that is commanded, so a bound on it is a bound on
    the force:

        \| stiffness * unit * u \| <= limit

    A command that is too long is shortened; its direction stays. What is guaranteed does not depend
    on a measurement, and so neither on a sensor's noise nor on its delay. It assumes

    * that the set point is put relative to where the tool is, or has no further to go than the last
      command says: one that integrates may lie any distance ahead of a tool that is held back;
    * that ``stiffness`` is the largest force, impact included, for each metre commanded, of the
      stiffest robot that there may be. It is measured, with commands that try everything
      (``python -m benchmarks.limits``), and several times the spring constant of the controller;
    * that the force comes from the robot's own motion, not from somebody who pushes it.

    With ``force_key`` the measured force is used too, as a second line where these do not hold:
    with the force f, its direction n = f / \|f\| and the part p = (unit * u) . n of the
    displacement along it, motion further into the contact has p < 0. That part is scaled by

        s = clip((limit - \|f\|) / (limit - onset), 0, 1)

    and above the limit the part along n is replaced by ``retract``, away from the contact. Where
    that leads beyond the action's bounds, the command is shortened. This alone would be no bound:
    the force is known a step too late.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``force_key``, writes ("safety", "force"); see :class:`SafetyLimit`.

    Args:
        limit: Largest force, positive [N].
        stiffness: Force for each metre of commanded displacement, a number or one for each
            dimension of the action, positive [N/m].
        unit: Length that one unit of the action stands for, a number or one for each dimension,
            positive [m].
        force_key: Force on the end effector ``[*batch, m]`` [N], in the frame of the action; of a
            wrench the first numbers are used. None: no measurement is used. While one is not
            finite, the end effector is not moved.
        axes: Dimension of the action that each component of the force belongs to.
        onset: Force from which pressing motion is scaled down, in [0, limit) [N]; None: ``limit``,
            so that it is stopped at the limit and not before.
        retract: Size of the motion away from the contact above the limit, in action units, 0 or
            more; 0 stops.
        action_key: The displacement u, ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If numbers are out of range, or stiffness, force or axes do not fit the action.
        KeyError: If force or action is missing.
        RuntimeError: If actions pass the inverse without an environment or before a reset.
    """

    def __init__(
        self,
        limit: float,
        stiffness: float | Sequence[float],
        unit: float | Sequence[float] = 1.0,
        force_key: NestedKey | None = None,
        axes: Sequence[int] = (0, 1, 2),
        onset: float | None = None,
        retract: float = 0.0,
        action_key: NestedKey = ACTION,
    ) -> None:
        super().__init__("force", [] if force_key is None else [force_key], action_key)
        check("limit", limit, "one number", per_dimension("limit", limit, positive=True).ndim == 0)
        distance = per_dimension("retract", retract, minimum=0.0)
        check("retract", retract, "one number", distance.ndim == 0)
        self.stiffness = per_dimension("stiffness", stiffness, positive=True)
        self.unit = per_dimension("unit", unit, positive=True)
        below = onset is None or 0 <= onset < limit
        check("onset", onset, f"a force in [0, limit) with the limit {limit:g}", below)
        self.axes = list(axes)
        different = bool(axes) and len(set(axes)) == len(axes) and min(axes) >= 0
        check("axes", self.axes, "different dimensions of the action", different)
        self.maximum, self.onset, self.retract = float(limit), onset, float(retract)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the force, one number for each axis; none without a ``force_key``."""
        if not self.in_keys:
            return action[..., :0]
        return require(self, tensordict, self.in_keys[0])[..., : len(self.axes)]

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Change the part of the motion along the force, then shorten the displacement."""
        if self.in_keys:
            action = self._yield_to(measured, action, limits)
        reach = norm(self._force_of(action))
        return torch.where(reach > self.maximum, action * (self.maximum / reach), action)

    def _force_of(self, action: Tensor) -> Tensor:
        """Return the force that a displacement may lead to, by dimension [N]."""
        return action * (self.stiffness * self.unit).to(action)

    def _yield_to(self, force: Tensor, action: Tensor, limits: ActionLimits) -> Tensor:
        size = norm(force)
        normal = force / size.clamp_min(torch.finfo(size.dtype).tiny)
        unit = self.unit.to(action).expand(action.shape[-1])[self.axes]
        along = dot(action[..., self.axes] * unit, normal)
        wanted = torch.where(along < 0, along * self._share(size), along)
        if self.retract:
            away = self.retract * dot(normal * unit, normal)
            wanted = torch.where(size > self.maximum, torch.maximum(wanted, away), wanted)
        safe = action.clone()
        safe[..., self.axes] = action[..., self.axes] + (wanted - along) * normal / unit
        # Clipped at the bounds, one dimension and not the other, it would press again.
        room = torch.where(safe > 0, limits.high, -limits.low) / safe.abs()
        share = torch.where(safe == 0, torch.inf, room).amin(-1, keepdim=True).clamp(0.0, 1.0)
        return torch.where(wanted == along, action, safe * share)

    def _share(self, size: Tensor) -> Tensor:
        """Return how much of a pressing motion is left under forces of this size."""
        if self.onset is None:
            return (size <= self.maximum).to(size)
        return ((self.maximum - size) / (self.maximum - self.onset)).clamp(0.0, 1.0)

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold stiffness, force and axes to the action's size.

        Raises:
            ValueError: If an axis is none of them.
        """
        for name, value in (("stiffness", self.stiffness), ("unit", self.unit)):
            check_length(name, value, action_size, "the action")
        for key, size in sizes.items():
            if size < len(self.axes) or max(self.axes) >= action_size:
                raise ValueError(
                    f"axes: expected dimensions of a force of {size} numbers ({key!r}) and an "
                    f"action of {action_size}, got {self.axes}"
                )
