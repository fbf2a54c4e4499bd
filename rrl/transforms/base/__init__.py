"""Bases of the transforms: memory and random numbers of each slot, access to the action."""

from rrl.transforms.base.action import CASTS, ActionTransform, sibling
from rrl.transforms.base.action_bounds import ActionLimits, action_leaf, limits_of, share_within
from rrl.transforms.base.slots import Mask, Memory, RandomTransform, SlotTransform

__all__ = [
    "CASTS",
    "ActionLimits",
    "ActionTransform",
    "Mask",
    "Memory",
    "RandomTransform",
    "SlotTransform",
    "action_leaf",
    "limits_of",
    "share_within",
    "sibling",
]
