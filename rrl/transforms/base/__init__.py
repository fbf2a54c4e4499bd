"""Bases of the transforms: memory and random numbers of each slot, access to the action."""

from rrl.transforms.base.action import ActionTransform, sibling
from rrl.transforms.base.action_bounds import ActionLimits, action_leaf, limits_of, unbounded_like
from rrl.transforms.base.slots import Memory, RandomTransform, SlotTransform

__all__ = [
    "ActionLimits",
    "ActionTransform",
    "Memory",
    "RandomTransform",
    "SlotTransform",
    "action_leaf",
    "limits_of",
    "sibling",
    "unbounded_like",
]
