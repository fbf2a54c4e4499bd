"""Mirror images of a task: what is learned on one side holds on the other."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from rrl.keys import ACTION, OBSERVATION

Map = tuple[int, ...]
"""A signed permutation: number ``i`` of the image is number ``abs(map[i])`` of the original,
counted from 1, times the map's sign."""

MOST_IMAGES = 64


class Symmetry:
    """The group of images that some mirrors generate, the original first.

    Two mirrors, left-right and front-back, give four images. A transition's image is a transition
    of the same task with the same reward.

    Args:
        mirrors: For each mirror the map of the observation and the map of the action, such as
            ``(-1, 2)`` for two numbers of which the mirror turns the first. Centers of mirroring
            must be 0: see :class:`rrl.inputs.Input`.

    Raises:
        ValueError: If a map is no signed permutation, the maps' lengths differ between mirrors, or
            there are more than 64 images.
    """

    def __init__(self, mirrors: Sequence[tuple[Sequence[int], Sequence[int]]]) -> None:
        maps = [
            (as_map("observation", observation), as_map("action", action))
            for observation, action in mirrors
        ]
        sizes = {(len(observation), len(action)) for observation, action in maps}
        if len(sizes) != 1:
            raise ValueError(
                f"mirrors: expected maps of the same lengths, at least one, got {sorted(sizes)}"
            )
        self.observation_size, self.action_size = next(iter(sizes))
        group = _generated(maps)
        self.num_images = len(group)
        back = [
            next(other for other in group if _after(other, image) == group[0]) for image in group
        ]
        self._observation = _Maps([observation for observation, _ in group])
        self._action = _Maps([action for _, action in group])
        self._action_back = _Maps([action for _, action in back])

    def images(self, observation: Tensor) -> Tensor:
        """Return all images of ``observation`` [..., n], ``[..., G, n]``."""
        return self._observation.all(observation)

    def reflect(self, observation: Tensor, which: Tensor) -> Tensor:
        """Return image ``which`` [...], from 0 to G - 1, of each ``observation`` [..., n]."""
        return self._observation.one(observation, which)

    def reflect_action(self, action: Tensor, which: Tensor) -> Tensor:
        """Return image ``which`` [...] of each ``action`` [..., m]."""
        return self._action.one(action, which)

    def reflect_transitions(self, batches: TensorDictBase) -> None:
        """Put a randomly drawn image in the place of each transition ``[*batch]``."""
        drawn = torch.randint(self.num_images, batches.shape)
        which = drawn.to(batches[ACTION].device)  # drawn alike wherever transitions lie
        for key in (OBSERVATION, ("next", OBSERVATION)):
            batches[key] = self.reflect(batches[key], which)
        batches[ACTION] = self.reflect_action(batches[ACTION], which)

    def check_sizes(self, features: int, action: int) -> None:
        """Refuse features and actions of other sizes.

        Raises:
            ValueError: If a size is not that of the maps.
        """
        if (self.observation_size, self.action_size) != (features, action):
            raise ValueError(
                f"symmetry: expected maps of {features} features and {action} numbers of action, "
                f"got {self.observation_size} and {self.action_size}"
            )

    def return_actions(self, actions: Tensor, signed: bool = True) -> Tensor:
        """Return what each image's action ``[..., G, m]`` is in the original."""
        return self._action_back.each(actions, signed)


class _Maps:
    """Signed permutations of vectors, as indices and signs ``[G, n]``."""

    def __init__(self, maps: Sequence[Map]) -> None:
        table = torch.tensor(maps)
        self.index, self.sign = table.abs() - 1, table.sign().float()

    def all(self, x: Tensor) -> Tensor:
        index, sign = self._beside(x)
        return x[..., index] * sign

    def one(self, x: Tensor, which: Tensor) -> Tensor:
        index, sign = self._beside(x)
        return x.gather(-1, index[which]) * sign[which]

    def each(self, x: Tensor, signed: bool) -> Tensor:
        index, sign = self._beside(x)
        moved = x.gather(-1, index.expand_as(x))
        return moved * sign if signed else moved

    def _beside(self, x: Tensor) -> tuple[Tensor, Tensor]:
        if self.index.device != x.device:
            self.index, self.sign = self.index.to(x.device), self.sign.to(x.device)
        return self.index, self.sign


def as_map(name: str, given: Sequence[int]) -> Map:
    """``given`` as a map.

    Raises:
        ValueError: If it is no signed permutation; the message starts with ``name``.
    """
    numbers = tuple(given)
    if not numbers or sorted(map(abs, numbers)) != list(range(1, len(numbers) + 1)):
        raise ValueError(
            f"{name}: expected the numbers 1 to {len(numbers)} once each, with a sign, "
            f"got {list(given)}"
        )
    return numbers


def _after(second: tuple[Map, ...], first: tuple[Map, ...]) -> tuple[Map, ...]:
    """The maps of the image's image: ``first``, then ``second``."""
    return tuple(map(_composed, second, first))


def _composed(outer: Map, inner: Map) -> Map:
    return tuple(inner[abs(i) - 1] * (1 if i > 0 else -1) for i in outer)


def _generated(mirrors: Sequence[tuple[Map, ...]]) -> list[tuple[Map, ...]]:
    group = [tuple(tuple(range(1, len(part) + 1)) for part in mirrors[0])]
    for image in group:  # grows while it is read
        new = [_after(mirror, image) for mirror in mirrors]
        group += [candidate for candidate in dict.fromkeys(new) if candidate not in group]
        if len(group) > MOST_IMAGES:
            raise ValueError(f"mirrors: expected a group of at most {MOST_IMAGES} images, got more")
    return group
