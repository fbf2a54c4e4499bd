"""What the transforms that change or watch an action share."""

from __future__ import annotations

from typing import Any

from tensordict import NestedKey, unravel_key
from torchrl.envs.transforms import Transform

from rrl.transforms.action_bounds import ActionLimits, action_leaf, limits_of

__all__ = ["ActionTransform", "sibling"]


class ActionTransform(Transform):
    """Mixin for transforms that change or watch an action and need its limits at their place."""

    _limits: ActionLimits | None = None
    _action_key: NestedKey

    def limits(self) -> ActionLimits:
        """Return the limits of the action as the transforms nearer to the environment leave it.

        Raises:
            RuntimeError: If the transform is not attached to an environment.

        """
        limits = self._limits
        if limits is None:
            parent = self.parent
            if parent is None:
                raise RuntimeError(
                    f"{type(self).__name__} changes actions on their way to an environment and is "
                    "attached to none. Append it to a TransformedEnv; in a replay buffer it would "
                    "change the stored actions a second time."
                )
            limits = self._take_limits(parent.full_action_spec)
        return limits

    def _take_limits(self, action_spec: Any) -> ActionLimits:
        self._limits = limits_of(action_leaf(action_spec, self._action_key))
        return self._limits

    def clone(self) -> ActionTransform:
        """Return a copy without a parent; it reads its limits anew."""
        twin = super().clone()
        twin._limits = None
        return twin

    def empty_cache(self) -> None:
        """Forget what was derived from the environment's specs."""
        super().empty_cache()
        self._limits = None

    def reset_parent(self) -> None:
        """Detach the transform from its environment."""
        super().reset_parent()
        self._limits = None


def sibling(key: NestedKey, name: str) -> NestedKey:
    """Return ``name`` at the level of ``key``: ("arm", "action") -> ("arm", name)."""
    return name if isinstance(key, str) else unravel_key((*key[:-1], name))
