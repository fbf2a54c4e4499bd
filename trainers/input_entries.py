"""The entries that policy and critics read, as they are in an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torchrl.data import TensorSpec
from torchrl.envs import EnvBase

from rrl.inputs import Input, channels_of
from rrl.keys import ACTION, BASE_ACTION, PREVIOUS_ACTION
from rrl.transforms.base.action_bounds import limits_of

from .entry_checks import check_number

__all__ = ["as_inputs", "read_inputs"]


def as_inputs(given: Mapping[str, Input] | Sequence[str]) -> dict[str, Input]:
    """Return inputs by name; a list names some of which nothing else is said."""
    return dict(given) if isinstance(given, Mapping) else {name: Input() for name in given}


def read_inputs(what: str, wanted: dict[str, Input], env: EnvBase) -> dict[str, Input]:
    """Return inputs with the shapes that they have in ``env``.

    Args:
        what: What they are called in messages.
        wanted: The inputs.
        env: The environment.

    Raises:
        KeyError: If ``env`` lacks one of them.
        TypeError: If one of them holds no numbers.
        ValueError: If a center or scale does not fit its entry.
    """
    spec = env.observation_spec
    keys = list(spec.keys(True, True))
    if missing := [name for name in wanted if name not in keys]:
        raise KeyError(
            f"{what}: expected entries of the environment, which are "
            f"{', '.join(sorted(map(str, keys)))}, got {missing[0]!r}"
        )
    for name in wanted:
        check_number(f"{what}.{name}", spec[name])
    inputs = {
        name: _filled_in(entry, spec[name], env.ndim)
        for name, entry in (wanted | _actions(wanted, env)).items()
    }
    for name, entry in inputs.items():
        for column in ("loc", "scale"):
            try:
                entry.column(column)
            except ValueError as error:
                raise ValueError(f"{what}.{name}.{error}") from error
    return inputs


def _filled_in(entry: Input, spec: TensorSpec, batch_dims: int) -> Input:
    shape = tuple(spec.shape[batch_dims:])
    return replace(entry, shape=shape, channels=entry.channels or channels_of(shape, spec.dtype))


def _actions(inputs: Mapping[str, Input], env: EnvBase) -> dict[str, Input]:
    """Return the inputs that are actions, in half ranges if nothing else is said."""
    limits = limits_of(env.base_env.full_action_spec[ACTION])
    half_range = limits.half_range.reshape(-1, limits.half_range.shape[-1])[0]
    scale = torch.where(half_range == 0, 1.0, 1.0 / half_range)  # without range it never changes
    scales: dict[str, list[float] | float] = {
        BASE_ACTION: scale.tolist(),
        PREVIOUS_ACTION: 1.0,
    }
    return {
        name: replace(inputs[name], scale=scale)
        for name, scale in scales.items()
        if name in inputs and inputs[name].is_derived
    }
