"""A script that solves the insertion task, as a controller."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from rrl.checks import check
from rrl.controllers import StatefulController
from rrl.controllers.base import State


class PressAndDrag(StatefulController):
    """Press on one standing block at a time, drag it outwards, then insert.

    Friction between held block and standing block is larger than below the standing block, so it
    follows. The sequence is fixed, one step after the other; it reads the tool's position and the
    goal, and nothing of the blocks.

    Args:
        press: Action along z while dragging, 0 to 1 downwards.
        reach: Distance from the goal, along x, where the tool comes down [m].
        drag: Length of the drag [m].
        rest: Height of the tool above its goal when the held block rests on the standing blocks
            [m].
        clearance: Height above that at which the tool crosses over [m].
        durations: Steps of approach, drag right, cross over, drag left and return; then it inserts.
        unit: Length of one action unit [m].

    Raises:
        ValueError: If there are not five durations.
    """

    def __init__(
        self,
        press: float,
        reach: float = 0.02,
        drag: float = 0.018,
        rest: float = 0.08,
        clearance: float = 0.01,
        durations: Sequence[int] = (7, 6, 6, 6, 6),
        unit: float = 0.02,
    ) -> None:
        super().__init__(["end_effector_position", "goal"])
        check("durations", durations, "five numbers of steps", len(durations) == 5)
        self.press, self.unit = press, unit
        far, above, nan = reach + drag, rest + clearance, float("nan")
        approach, right, across, left, back = durations
        # Of each step the tool's x and z relative to the goal; NaN: press.
        targets = [
            *[(reach, rest + clearance / 2)] * approach,
            *[(far, nan)] * right,
            *[(far, above)] * min(2, across),  # up first, then across
            *[(-reach, above)] * (across - 2),
            *[(-far, nan)] * left,
            *[(-far, above)] * min(2, back),
            *[(0.0, above)] * (back - 2),
            (0.0, 0.0),
        ]
        self.register_buffer("_targets", torch.tensor(targets), persistent=False)

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Begin the sequence."""
        goal = self.read(tensordict, "goal")
        return {"step": torch.zeros(goal.shape[:-1], dtype=torch.int64, device=goal.device)}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action ``[*batch, 3]``."""
        step = self.state_for(tensordict)["step"]
        self.state = {"step": step + 1}
        target = self._targets[step.clamp_max(len(self._targets) - 1)]  # (*batch, 2)
        x, z = target.unbind(-1)
        error = self.read(tensordict, "goal") - self.read(tensordict, "end_effector_position")
        action = torch.stack(
            [
                ((error[..., 0] + x) / self.unit).clamp(-0.8, 0.8),
                (0.4 * error[..., 1] / self.unit).clamp(-0.5, 0.5),
                torch.where(z.isnan(), -self.press, (error[..., 2] + z) / self.unit),
            ],
            -1,
        )
        return action.clamp(-1.0, 1.0)
