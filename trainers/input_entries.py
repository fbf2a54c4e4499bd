"""The entries that policy and critics read, as they are in an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torchrl.envs import EnvBase

from rrl.inputs import Input, channels_of
from rrl.keys import ACTION, BASE_ACTION, PREVIOUS_ACTION, dotted
from rrl.transforms.base.action_bounds import limits_of

from .entry_checks import check_number

__all__ = ["as_inputs", "read_inputs"]


def as_inputs(given: Mapping[str, Input] | Sequence[str]) -> dict[str, Input]:
    """Return inputs by name; a list names some of which nothing else is said."""
    return dict(given) if isinstance(given, Mapping) else {name: Input() for name in given}


def read_inputs(what: str, wanted: dict[str, Input], env: EnvBase) -> dict[str, Input]:
    """Return inputs with the shapes that they have in ``env``, by their keys there.

    Args:
        what: What they are called in messages.
        wanted: The inputs, by key; dots may join the parts of a nested one, as in YAML.
        env: The environment.

    Raises:
        KeyError: If ``env`` lacks one of them.
        TypeError: If one of them holds no numbers.
        ValueError: If a center or scale does not fit its entry.
    """
    spec = env.observation_spec
    keys = list(spec.keys(True, True))
    nested: dict[str, Any] = {dotted(key): key for key in keys if isinstance(key, tuple)}
    wanted = {n if n in keys else nested.get(n, n): entry for n, entry in wanted.items()}
    if missing := [name for name in wanted if name not in keys]:
        raise KeyError(
            f"{what}: expected entries of the environment, which are "
            f"{', '.join(sorted(map(dotted, keys)))}, got {missing[0]!r}"
        )
    for name in wanted:
        check_number(f"{what}.{name}", spec[name])
    inputs = {}
    for name, entry in (wanted | _actions(wanted, env)).items():
        shape = tuple(spec[name].shape[env.ndim :])
        channels = entry.channels or channels_of(shape, spec[name].dtype)
        inputs[name] = replace(entry, shape=shape, channels=channels)
        for column in ("loc", "scale"):
            try:
                inputs[name].column(column)
            except ValueError as error:
                raise ValueError(f"{what}.{name}.{error}") from error
    return inputs


def _actions(inputs: Mapping[str, Input], env: EnvBase) -> dict[str, Input]:
    """Return the inputs that are actions, in half ranges if nothing else is said."""
    limits = limits_of(env.base_env.full_action_spec[ACTION])
    half_range = limits.half_range.reshape(-1, limits.half_range.shape[-1])[0]
    scale = torch.where(half_range == 0, 1.0, 1.0 / half_range)  # without range it never changes
    scales: dict[str, list[float] | float] = {BASE_ACTION: scale.tolist(), PREVIOUS_ACTION: 1.0}
    return {
        name: replace(entry, scale=scales[name])
        for name, entry in inputs.items()
        if name in scales and entry.is_derived
    }
