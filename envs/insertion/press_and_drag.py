"""A script that solves the insertion task, as a controller."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from rrl.controllers import StatefulController
from rrl.controllers.base import State

UNIT = 0.02
"""Length of one action unit [m]."""
REACH = 0.02
"""Distance from the goal, along x, where the tool comes down [m]."""
REST = 0.08
"""Height of the tool above its goal when the held block rests on the standing blocks [m]."""
ABOVE = REST + 0.01
"""Height at which the tool crosses over [m]."""
PRESS = float("nan")
"""In the place of a height: press down."""


class PressAndDrag(StatefulController):
    """Press on one standing block at a time, drag it outwards, then insert.

    Friction between held block and standing block is larger than below the standing block, so it
    follows. The sequence is fixed, one step after the other; it reads the tool's position and the
    goal, and nothing of the blocks.

    Args:
        press: Action along z while dragging, 0 to 1 downwards.
        drag: Length of the drag [m].
    """

    def __init__(self, press: float, drag: float = 0.018) -> None:
        super().__init__(["end_effector_position", "goal"])
        self.press, far = press, REACH + drag
        # Of each step the tool's x and z relative to the goal [m]; it stays at the last.
        targets = [
            *[(REACH, REST + 0.005)] * 7,
            *[(far, PRESS)] * 6,
            *[(far, ABOVE)] * 2,
            *[(-REACH, ABOVE)] * 4,
            *[(-far, PRESS)] * 6,
            *[(-far, ABOVE)] * 2,
            *[(0.0, ABOVE)] * 4,
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
                ((error[..., 0] + x) / UNIT).clamp(-0.8, 0.8),
                (0.4 * error[..., 1] / UNIT).clamp(-0.5, 0.5),
                torch.where(z.isnan(), -self.press, (error[..., 2] + z) / UNIT),
            ],
            -1,
        )
        return action.clamp(-1.0, 1.0)
