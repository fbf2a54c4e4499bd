"""The whole way from raw entries to the executed command, as a function of entries and state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rrl.controllers import Controller, FunctionController, StatefulController
from rrl.deploy.contract import COMMAND
from rrl.keys import ACTION, BASE_ACTION, SAFETY
from rrl.transforms import FiniteAction
from rrl.transforms.base import SlotTransform

from ..environment import EnvironmentFactory
from .specs_only import SpecsOnly, chain_on

Values = dict[str, Tensor]
"""Tensors without batch dimensions, by name."""

Path = tuple[str, ...]

RESIDUAL = "residual"
LAST, STARTS = "last", "starts"
"""Parts of the state: what the last step sent to the robot, and whether an episode starts."""


class StaysOutside(TypeError):
    """A controller that cannot be recorded, whatever it does."""


class _Elsewhere(Controller):
    """A controller that runs outside: its action comes among the entries."""

    def __init__(self) -> None:
        super().__init__([])

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action that came, ``[*batch, n_act]``."""
        return self.read(tensordict, BASE_ACTION)


class Chain:
    """The trainer's own transforms, controller and policy, with their memory as an argument.

    What runs is what runs in training on an environment that resets itself: the memory of every
    part is put in place before a step and taken out after it. Nothing is written twice, and a part
    that somebody adds is exported as it is.

    Args:
        like: The bare environment, for its specs.
        environment: Makes the transforms on it.
        policy: From the inputs to the residual ``action``.
        with_controller: Whether the controller is inside; else ``base_action`` is an entry.

    Raises:
        StaysOutside: If the controller is to be inside and leaves torch.

    Attributes:
        entries: What may be read, zeros.
        initial: The state before an episode's first step.
        reports: Names of what a step tells beside the command.
        guard: The report of what replaces a command that is not finite; None: nothing does.
        guard_ends_episode: Whether the episode is over with such a command.
    """

    def __init__(
        self,
        like: Any,
        environment: EnvironmentFactory,
        policy: TensorDictModuleBase,
        with_controller: bool = True,
    ) -> None:
        robot = SpecsOnly(like, resets_itself=True)
        outside: dict[str, Any] = {} if with_controller else {"controller": _Elsewhere}
        self._env = chain_on(robot, environment, **outside)
        for module in self._env.transform.modules():
            if isinstance(module, FunctionController) and (why := module.outside_torch):
                raise StaysOutside(f"{module.called()} {why}")
        self._policy, self._batch = policy, robot.batch_size
        self._done, self._blank = robot.done_keys, robot.blank()
        self._keys = robot.entry_keys()
        if not with_controller:
            self._keys[BASE_ACTION] = BASE_ACTION
            self._blank[BASE_ACTION] = self._env.observation_spec[BASE_ACTION].zero()
        self.entries = {n: self._single(self._blank.get(key)) for n, key in self._keys.items()}
        self._owners = dict(self._named_owners())
        guards = [m for m in self._owners.values() if isinstance(m, FiniteAction)]
        self.guard = ".".join(_path(guards[0].out_keys[0])) if guards else None
        self.guard_ends_episode = any(guard.truncate for guard in guards)
        acted, sent = self._act(self._env.transform._reset(self._blank, self._blank.clone()))
        self.reports = list(self._told(acted, sent))[1:]
        held = self._taken(sent)
        self._paths = {".".join(path): path for path in held}
        self.initial = {name: torch.zeros_like(held[path]) for name, path in self._paths.items()}
        self.initial[STARTS] = torch.tensor([True])

    def step(self, entries: Values, state: Values) -> tuple[Values, Values]:
        """Take one control step.

        Args:
            entries: Of :attr:`entries`; what is missing counts as zeros.
            state: Of :attr:`initial`, all of it.

        Returns:
            The command and the reports; the state for the next step.
        """
        td = self._blank.copy()
        for name, value in entries.items():
            td.set(self._keys[name], self._batched(value))
        for key in self._done:
            td.set(key, self._batched(state[STARTS]).expand_as(td.get(key)))
        last = self._put({path: state[name] for name, path in self._paths.items()})
        acted, sent = self._act(self._env.transform._step(last, td))
        told, held = self._told(acted, sent), self._taken(sent)
        following = {name: held[path] for name, path in self._paths.items()}
        return told, {**following, STARTS: torch.tensor([False])}

    def _act(self, seen: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        """Return what the policy made of the observation, and what that came to at the robot."""
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            acted = self._policy(seen)
        return acted, self._env.transform.inv(acted)

    def _told(self, acted: TensorDictBase, sent: TensorDictBase) -> Values:
        told = {COMMAND: sent[ACTION], BASE_ACTION: acted[BASE_ACTION], RESIDUAL: acted[ACTION]}
        flags = sent.select(SAFETY, strict=False)
        told |= {".".join(path): flag for path, flag in _leaves(flags)}
        return {name: self._single(value) for name, value in told.items()}

    # ---------------------------------------------------------------- memory

    def _named_owners(self) -> Iterator[tuple[str, SlotTransform | StatefulController]]:
        """Yield everything that remembers, with a name of its own."""
        own = (SlotTransform, StatefulController)
        seen: dict[str, int] = {}
        for module in self._env.transform.modules():
            # A function inside has no memory: one that remembers stays outside.
            if isinstance(module, own) and not isinstance(module, FunctionController):
                name = type(module).__name__
                seen[name] = seen.get(name, 0) + 1
                yield (name if seen[name] == 1 else f"{name}{seen[name]}"), module

    def _taken(self, sent: TensorDictBase) -> dict[Path, Tensor]:
        """Return all that the parts remember, and what was sent."""
        held: dict[str, Any] = {LAST: sent}
        for name, owner in self._owners.items():
            held[name] = owner.memory if isinstance(owner, SlotTransform) else owner.state or {}
        return {path: self._single(value) for path, value in _leaves(held)}

    def _put(self, held: Mapping[Path, Tensor]) -> TensorDictBase:
        """Give the parts their memory, and return what was sent."""
        parts = _nested({path: self._batched(value) for path, value in held.items()})
        for name, owner in self._owners.items():
            if isinstance(owner, SlotTransform):
                owner.memory = parts.get(name, {})
            else:
                owner.set_extra_state({"state": parts.get(name), "fresh": None})
        return TensorDict(parts[LAST], batch_size=self._batch)

    def _batched(self, value: Tensor) -> Tensor:
        return value.reshape((*self._batch, *value.shape))

    def _single(self, value: Tensor) -> Tensor:
        return value.reshape(value.shape[len(self._batch) :])


def _path(key: Any) -> Path:
    return (key,) if isinstance(key, str) else tuple(key)


def _leaves(nested: Any, path: Path = ()) -> Iterator[tuple[Path, Tensor]]:
    for key, value in nested.items():
        if isinstance(value, Tensor):
            yield (*path, key), value
        else:
            yield from _leaves(value, (*path, key))


def _nested(leaves: Mapping[Path, Tensor]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for (*parents, name), value in leaves.items():
        place = nested
        for parent in parents:
            place = place.setdefault(parent, {})
        place[name] = value
    return nested
