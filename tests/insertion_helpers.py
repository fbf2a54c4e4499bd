"""What several tests of the insertion task need."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from rrl.envs import InsertionEnv


def act(env: InsertionEnv, action: torch.Tensor) -> TensorDictBase:
    """Step with the same action [3] or one per slot [B, 3]; returns the next tensordict."""
    action = action.expand(env.num_envs, 3).clone()
    return env.step(TensorDict({"action": action}, env.batch_size))["next"]


def random_actions(num_steps: int, num_envs: int, seed: int = 0) -> torch.Tensor:
    """Actions [num_steps, num_envs, 3] that go down and sideways, so that contact is made."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.rand((num_steps, num_envs, 3), generator=generator) * 2 - 1
    return (0.4 * noise + torch.tensor([0.0, 0.0, -0.8])).clamp(-1, 1)


def flat(td: TensorDictBase) -> dict[str, np.ndarray]:
    """All leaves as arrays, nested names joined by dots."""
    return {
        ".".join(key) if isinstance(key, tuple) else key: value.numpy()
        for key, value in td.items(True, True)
    }


def assert_same(left: TensorDictBase, right: TensorDictBase) -> None:
    """Bit for bit the same entries."""
    a, b = flat(left), flat(right)
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)
