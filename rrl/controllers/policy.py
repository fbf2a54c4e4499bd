"""A trained policy as the controller."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rrl.checks import require
from rrl.controllers.base import Controller
from rrl.keys import ACTION, BASE_ACTION


class PolicyController(Controller):
    """Any TensorDict module as the controller: frozen, closed loop.

    It is what the paper's figure 5 needs: a policy from simulation under a residual. The policy is
    copied when the controller is built. It runs without gradient, without exploration and in
    evaluation mode, whatever mode its surroundings are in. It sees its own keys only, in its own
    precision; of what it writes only the action is used.

    Args:
        policy: A module from and to a TensorDict, with ``in_keys`` and ``out_keys``.
        checkpoint: File with the policy's ``state_dict``, written by ``torch.save``.
        key_map: Policy's key -> environment's key, for keys that are named differently.
        action_key: The policy's name of its action, ``[*batch, n_act]``.
        out_key: Where the action goes.

    Raises:
        TypeError: If the policy is not a module with ``in_keys`` and ``out_keys``.
        ValueError: If ``key_map`` names a key that the policy does not read, or the policy has a
            memory among its entries, as recurrent ones do.
        KeyError: If the policy does not write ``action_key``; when run, if an observation is
            missing.
        FileNotFoundError: If there is no such checkpoint.
        RuntimeError: If the checkpoint does not fit the policy.
    """

    def __init__(
        self,
        policy: nn.Module,
        checkpoint: str | Path | None = None,
        key_map: Mapping[NestedKey, NestedKey] | None = None,
        action_key: NestedKey = ACTION,
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        if not isinstance(policy, nn.Module) or not hasattr(policy, "in_keys"):
            raise TypeError(
                "policy: expected a TensorDict module with in_keys and out_keys, got a "
                f"{type(policy).__name__}; wrap a function or network in a TensorDictModule"
            )
        self._policy_keys = _keys_of(policy, "in_keys")
        names = {unravel_key(k): unravel_key(v) for k, v in (key_map or {}).items()}
        if unknown := [key for key in names if key not in self._policy_keys]:
            raise ValueError(
                f"key_map: expected keys that the policy reads, of {self._policy_keys}, "
                f"got {unknown}"
            )
        written = _keys_of(policy, "out_keys")
        if handed_on := [k for k in self._policy_keys if unravel_key(("next", k)) in written]:
            raise ValueError(
                f"policy: expected one that reads observations alone, got one that hands "
                f"{handed_on} on to its next step, which nothing keeps; write a StatefulController"
            )
        if unravel_key(action_key) not in written:
            raise KeyError(f"action_key: expected one of {written}, got {action_key!r}")
        super().__init__([names.get(key, key) for key in self._policy_keys], out_key)
        self.action_key = action_key
        self.policy = copy.deepcopy(policy)
        if checkpoint is not None:
            self.policy.load_state_dict(_load(Path(checkpoint)))
        self.policy.requires_grad_(False)
        self.eval()

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the policy's deterministic action ``[*batch, n_act]``."""
        seen = TensorDict({}, batch_size=tensordict.batch_size, device=tensordict.device)
        weight = next(filter(torch.is_floating_point, self.policy.parameters()), None)
        for policy_key, key in zip(self._policy_keys, self.in_keys, strict=True):
            value = require(self, tensordict, key, group=True)
            if weight is not None and isinstance(value, Tensor) and value.is_floating_point():
                value = value.to(weight.dtype)
            seen.set(policy_key, value)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return self.policy(seen).get(self.action_key)

    def train(self, mode: bool = True) -> PolicyController:
        """Keep the policy in evaluation mode: a frozen policy does not train."""
        return super().train(False)


def _load(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FileNotFoundError(f"checkpoint: expected a file with a policy's weights, got {path}")
    return torch.load(path, map_location="cpu", weights_only=True)


def _keys_of(policy: Any, name: str) -> list[NestedKey]:
    return [unravel_key(key) for key in getattr(policy, name)]
