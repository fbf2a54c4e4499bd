"""Collected steps as they are stored: with the residual that was executed, whoever asked for it."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key

from rrl.checks import require
from rrl.keys import ACTION, EXCEEDS_AUTHORITY, INTERVENED, INTERVENTION
from rrl.transforms.base import sibling

__all__ = ["relabel_interventions"]


def relabel_interventions(data: TensorDictBase, action_key: NestedKey = ACTION) -> TensorDictBase:
    """Put an operator's residual in the place of the policy's action, where one has taken over.

    A collector stores what the policy said. Give it this function as ``postproc``, or call it
    before ``ReplayBuffer.extend``.

    Args:
        data: Steps ``[..., T]`` with what :class:`~rrl.transforms.Intervention` writes in ``next``.
        action_key: The policy's action.

    Returns:
        ``data`` with the action as it is to be stored, and two flags of the transition beside it,
        "intervened" and "exceeds_authority", bool ``[..., T, 1]``. The latter says that the
        residual was clipped: what was executed is not what is stored.

    Raises:
        KeyError: If no Intervention has written into the data.
    """
    key = sibling(action_key, INTERVENTION)
    remedy = "; is there an Intervention among the environment's transforms?"
    step = require("relabel_interventions", data, unravel_key(("next", key)), remedy, group=True)
    said = data.get(action_key)
    data.set(action_key, torch.where(step["active"], step["action"].to(said), said))
    data.set(sibling(action_key, INTERVENED), step["active"])
    return data.set(sibling(action_key, EXCEEDS_AUTHORITY), step["exceeds"])
