"""Returns over several steps, made of collected transitions before they are stored."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from rrl.checks import check_whole

STEPS = "steps_to_next_obs"
"""Steps between an observation and the next one; value estimators raise the discount to it."""


def n_step_transitions(data: TensorDictBase, n: int, gamma: float) -> TensorDictBase:
    """Sum the rewards of up to ``n`` steps, and make the observation after them the next one.

    A transition spans ``m`` steps, the least of ``n``, the steps to the end of its episode and the
    steps to the end of ``data``. Its reward is ``r_0 + gamma r_1 + ... + gamma^(m-1) r_(m-1)``; the
    whole of ``next`` (observation, done, terminated) is that of its last step, and
    ``steps_to_next_obs`` is ``m``. So the return of every transition that reaches a terminal state
    is the sum of its rewards, without a bootstrapped value, and one that is cut off bootstraps with
    ``gamma^m``.

    Args:
        data: ``[..., T]`` in the order of time along the last dimension, with ``next`` holding
            ``reward`` and ``done`` of shape ``[..., T, 1]``; left as it is.
        n: Largest number of steps, at least 1.
        gamma: Discount.

    Returns:
        The same entries, ``[..., T]``, and ``steps_to_next_obs`` [..., T, 1], float32.

    Raises:
        ValueError: If ``n`` is no whole number of at least 1.
    """
    n = check_whole("n_step", n, 1)
    flat = data.reshape(-1, data.shape[-1])  # (B, T)
    done, rewards = flat["next", "done"].squeeze(-1), flat["next", "reward"].squeeze(-1)
    batch, time = done.shape
    steps = torch.arange(time, device=done.device)
    last = steps.repeat(batch, 1)  # (B, T): index of the last step of each window
    total, rows = rewards.clone(), torch.arange(batch, device=done.device).unsqueeze(-1)
    for i in range(1, n):
        following = (last + 1).clamp_max(time - 1)
        goes_on = ~done[rows, last] & (last + 1 < time)
        total += torch.where(goes_on, gamma**i * rewards[rows, following], 0.0)
        last = torch.where(goes_on, following, last)
        # a window that ended stays where it is, and so does not go on in the next turn either
    out = flat.exclude("next")
    out["next"] = flat["next"][rows, last]
    out["next", "reward"] = total.unsqueeze(-1)
    out[STEPS] = (last - steps + 1).to(torch.float32).unsqueeze(-1)
    return out.reshape(data.shape)
