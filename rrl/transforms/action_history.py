"""The policy's last actions among the observations."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torchrl.data import Composite

from rrl.checks import check_whole, require
from rrl.keys import ACTION, INTERVENTION, PREVIOUS_ACTION
from rrl.transforms.base import ActionTransform, Mask, Memory, SlotTransform, sibling


class ActionHistory(ActionTransform):
    """An observation of the policy's actions in the last steps.

    A delayed or noisy observation does not yet hold what the last actions did; together with them
    it is closer to a state. The actions are those at the transform's place: behind
    :class:`~rrl.transforms.ResidualAction` in the list they are the policy's residuals in [-1, 1],
    exploration included, in front of it what the environment was given. Where an
    :class:`~rrl.transforms.Intervention` has overruled the policy it is the residual that would
    have given the operator's command, which is what is stored. The action itself is left alone.

    policy -> env: reads ``action_key``.
    env -> policy: writes ``out_key``, ``[*batch, steps * n_act]``, oldest action first; zeros
    before an episode's first step.

    Args:
        steps: How many actions are remembered, at least 1.
        out_key: Default: "previous_action" at the level of ``action_key``.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If ``steps`` is not a whole number of at least 1, or the observations hold
            ``out_key`` already.
        KeyError: If the action is missing.
        RuntimeError: If it is called outside an environment, where there is no order in time, or
            before a reset.
    """

    written = ("history",)

    def __init__(
        self, steps: int = 1, out_key: NestedKey | None = None, action_key: NestedKey = ACTION
    ) -> None:
        self._out_key = unravel_key(out_key or sibling(action_key, PREVIOUS_ACTION))
        super().__init__(action_key=action_key, out_keys=[self._out_key])
        self.steps = check_whole("steps", steps, 1)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        # Transforms nearer to the environment change the action before the step's outcome is here.
        given = require(self, tensordict, self._action_key)
        self.memory = {**self.memory, "given": given}
        return tensordict

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        nothing = self.nothing(td)
        return {"history": nothing.repeat_interleave(self.steps, -1), "given": nothing}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        history, given = self.recall("history"), self.recall("given").to(self.limits().dtype)
        overruled = next_td.get(sibling(self._action_key, INTERVENTION), None)
        if overruled is not None:
            given = torch.where(overruled["active"], overruled["action"], given)
        return {"history": torch.cat([history[..., given.shape[-1] :], given], -1), "given": given}

    forward = SlotTransform.forward

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the last actions, in the units of the action at this place."""
        spec = self.action_like(self.steps * self.limits().shape[-1])
        return self.add_spec(observation_spec, self._out_key, spec, "out_key")
