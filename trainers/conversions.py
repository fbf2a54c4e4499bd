"""From an environment's device and precision to the chain's, and back to them for its actions."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import (
    DeviceCastTransform,
    DoubleToFloat,
    DTypeCastTransform,
    Transform,
)

from rrl.keys import ACTION, DIVERGED, METRICS, REWARD, SUCCESS

__all__ = ["convert"]

CPU = torch.device("cpu")


def convert(env: TransformedEnv) -> None:
    """Append transforms after which entries lie on the CPU, in float32, and flags are bool.

    The environment gets its actions on its own device and in its own precision, within its bounds.
    What it shows is copied, unless its class says ``makes_new_tensors``: a copy takes tens of
    microseconds.
    """
    if not getattr(type(env.base_env), "makes_new_tensors", False):
        env.append_transform(_Copied(in_keys=[]))
    if env.device not in (None, CPU):
        env.append_transform(DeviceCastTransform(CPU))
    if any(spec.dtype == torch.float64 for spec in env.specs.values(True, True)):
        env.append_transform(_DoubleToFloat())
    if (reward := env.full_reward_spec[REWARD].dtype) != torch.float32:  # 0 and 1, for instance
        env.append_transform(DTypeCastTransform(reward, torch.float32, in_keys=[REWARD]))
    made_up = getattr(type(env.base_env), "shows_made_up_values", False)
    flag = DTypeCastTransform if made_up else _Flag
    for key in (SUCCESS, DIVERGED):  # some environments write 0.0 and 1.0
        spec = env.observation_spec.get(key, None)
        if spec is not None and spec.dtype != torch.bool:
            env.append_transform(flag(spec.dtype, torch.bool, in_keys=[key]))


class _Copied(Transform):
    """Has everybody who reads an environment's entries read copies.

    An environment may show a buffer of its own and change it with the next step, before a round is
    stored. Others may write into what they were given, as TorchRL's collector does at a reset.
    """

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.clone()

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.clone()


class _Flag(DTypeCastTransform):
    """Makes flags of zeros and ones. NaN is no success, and diverged.

    Raises:
        ValueError: By steps and resets, if a number is something else, such as a share.
    """

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return super()._step(tensordict, self._checked(next_tensordict))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return super()._reset(tensordict, self._checked(tensordict_reset))

    def _checked(self, td: TensorDictBase) -> TensorDictBase:
        (key,) = self.in_keys
        value = td.get(key, None)
        if value is None:
            return td
        others = value[(value != 0) & (value != 1) & ~value.isnan()]
        if others.numel():
            raise ValueError(
                f"environment: {key}: expected a flag, 0 or 1, got {others[0].item():g}; write a "
                f"flag, and a share or a count under ({METRICS!r}, NAME)"
            )
        return td.set(key, value == 1 if key == SUCCESS else value != 0)


class _DoubleToFloat(DoubleToFloat):
    """One that leaves an action within double bounds: in float32, 0.1 is more than 0.1."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        out = super()._inv_call(tensordict)
        action = out.get(ACTION, None)
        if action is not None and self.parent is not None:
            out.set(ACTION, self.parent.full_action_spec[ACTION].project(action))
        return out
