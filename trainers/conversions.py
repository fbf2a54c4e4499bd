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

from rrl.keys import ACTION, DIVERGED, SUCCESS

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
    for key in (SUCCESS, DIVERGED):  # some environments write 0.0 and 1.0
        spec = env.observation_spec.get(key, None)
        if spec is not None and spec.dtype != torch.bool:
            env.append_transform(DTypeCastTransform(spec.dtype, torch.bool, in_keys=[key]))


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


class _DoubleToFloat(DoubleToFloat):
    """One that leaves an action within double bounds: in float32, 0.1 is more than 0.1."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        out = super()._inv_call(tensordict)
        action = out.get(ACTION, None)
        if action is not None and self.parent is not None:
            out.set(ACTION, self.parent.full_action_spec[ACTION].project(action))
        return out
