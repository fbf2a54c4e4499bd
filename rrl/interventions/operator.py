"""A scripted operator, who stands in for a person."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from rrl.checks import check, check_share, check_whole
from rrl.controllers.base import Controller, State, StatefulController, floating
from rrl.keys import OPERATOR_ACTION, TAKEN_OVER
from rrl.slot_masks import shaped_like
from rrl.slot_random import Seeded, SlotGenerators


class ScriptedOperator(Seeded, StatefulController):
    """A controller that takes over in some of the episodes, from their first step on.

    With ``noise`` and ``reversed_share`` it is clumsy:

        command = s * controller(observation) + noise * n,  n ~ N(0, 1)

    where s is -1 in a ``reversed_share`` of the steps, drawn one by one, and 1 in the others.

    Args:
        controller: What the operator does, or what makes it.
        share: Of the episodes, in [0, 1]; drawn one by one.
        steps: How many steps of an episode; None: all of them.
        noise: Standard deviation of each component of the command, in action units, not negative.
        reversed_share: Of the steps, in [0, 1]: the operator pushes the wrong way.
        seed: Of the first slot; slot i uses ``seed + i``. None: drawn anew from torch's global
            generator at every reset of all slots.

    Raises:
        TypeError: If the controller is no Controller.
        ValueError: If a number is out of its range.
    """

    def __init__(
        self,
        controller: Controller | Callable[[], Controller],
        share: float = 1.0,
        steps: int | None = None,
        noise: float = 0.0,
        reversed_share: float = 0.0,
        seed: int | None = None,
    ) -> None:
        made = controller if isinstance(controller, Controller) else controller()
        if not isinstance(made, Controller):
            raise TypeError(f"controller: expected a Controller, or what makes one, got {made!r}")
        check("noise", noise, "a number of at least 0", 0.0 <= noise < float("inf"))
        super().__init__(list(made.in_keys), OPERATOR_ACTION)
        self.out_keys = [OPERATOR_ACTION, TAKEN_OVER]
        self.controller = made
        self.share, self.noise = check_share("share", share), noise
        self.reversed_share = check_share("reversed_share", reversed_share)
        self.steps = None if steps is None else check_whole("steps", steps, 1)
        self.generators = SlotGenerators(seed, "ScriptedOperator")

    def reset_state(self, mask: Tensor | None) -> None:
        """Forget the slots where ``mask`` (bool ``[*batch]``) is True; None: all."""
        super().reset_state(mask)
        if mask is None:
            self.generators.renew()

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Draw which slots the operator takes over in this episode."""
        batch = tensordict.batch_size
        known = self.state is not None and self._fresh is not None and self._fresh.shape == batch
        draw = self._uniform(tensordict, self._fresh if known else None)
        return {"takes_over": draw < self.share, "step": torch.zeros_like(draw, dtype=torch.int64)}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the command ``[*batch, n_act]``."""
        return self(tensordict.copy()).get(OPERATOR_ACTION)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the command, and bool ``[*batch, 1]`` whether the operator has taken over."""
        state, command = self.state_for(tensordict), self.controller.act(tensordict)
        taken_over = state["takes_over"]
        if self.steps is not None:
            taken_over = taken_over & (state["step"] < self.steps)
        self.state = {**state, "step": state["step"] + 1}
        if self.reversed_share:
            wrong = self._uniform(tensordict, None) < self.reversed_share
            command = torch.where(shaped_like(command, wrong), -command, command)
        if self.noise:
            shape = command.shape[tensordict.batch_dims :]
            drawn = self.generators.normal(tensordict.batch_size, shape)
            command = floating(command)
            command = command + self.noise * drawn.to(command)
        tensordict.set(OPERATOR_ACTION, command)
        taken_over = shaped_like(command, taken_over).expand(*command.shape[:-1], 1)
        return tensordict.set(TAKEN_OVER, taken_over)

    def memory(self) -> Any:
        """Return what :meth:`put_back` needs, random numbers included."""
        return super().memory(), self.generators.state_dict()

    def put_back(self, memory: Any, mask: Tensor) -> None:
        """Put :meth:`memory` back in the slots where ``mask`` (bool ``[*batch]``) is True."""
        (state, fresh), generators = memory
        super().put_back((state, fresh), mask)
        before, now = generators["states"], self.generators.state_dict()
        if before is not None and now["states"] is not None and len(before) == mask.numel():
            pairs = zip(mask.flatten().tolist(), before, now["states"], strict=True)
            states = [old if kept else new for kept, old, new in pairs]
            self.generators.load_state_dict({**now, "states": states})

    def get_extra_state(self) -> dict[str, Any]:
        """Return state and random numbers for ``state_dict``."""
        return {**super().get_extra_state(), "generators": self.generators.state_dict()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take state and random numbers from a ``state_dict``."""
        super().set_extra_state(state)
        self.generators.load_state_dict(state["generators"])

    def _uniform(self, tensordict: TensorDictBase, mask: Tensor | None) -> Tensor:
        """Draw one number a slot, uniform in [0, 1), ``[*batch]``, on the device of the data."""
        drawn = self.generators.uniform(tensordict.batch_size, mask=mask)
        return drawn if tensordict.device is None else drawn.to(tensordict.device)
