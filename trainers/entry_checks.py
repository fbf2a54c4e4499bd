"""What a trainer asks of an environment and its entries, checked before anything is collected."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import torch
from torch import nn
from torchrl.data import Composite, TensorSpec
from torchrl.data.tensor_specs import NonTensor
from torchrl.envs import EnvBase

from rrl.keys import ACTION, DIVERGED, METRICS, REWARD_TERMS, SAFETY, SUCCESS

from .metric_names import ABOVE, P99

__all__ = ["check_action", "check_factory", "check_number", "check_reported", "make_native"]

FLOATING = (torch.float16, torch.float32, torch.float64)
INTEGERS = (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)
NUMBERS = (torch.bool, *INTEGERS, *FLOATING)


def check_factory(fields: Mapping[str, Any]) -> None:
    """Refuse fields of an environment's factory that look right and are something else.

    Raises:
        TypeError: If one of them is a part instead of what makes it, or inputs are a single name.
    """
    _check_controller(fields["controller"])
    for name, given in fields.items():
        for part in given if isinstance(given, (list, tuple)) else [given]:
            if isinstance(part, nn.Module):
                raise TypeError(
                    f"{name}: expected what makes one, such as a class or functools.partial, "
                    f"got a {type(part).__name__}: every environment has parts of its own"
                )
    for name in ("inputs", "critic_inputs"):
        if isinstance(given := fields[name], str):
            raise TypeError(f"{name}: expected names in a list, got {given!r}; write [{given!r}]")


def _check_controller(given: Any) -> None:
    """Refuse a function of observations, or an object, in the place of what makes a controller."""
    if given is None or isinstance(given, nn.Module):  # unused, or refused below
        return
    function = given
    while isinstance(function, partial):
        function = function.func
    if callable(given) and (isinstance(function, type) or not _needs_arguments(given)):
        return
    name = getattr(function, "__name__", "")
    got = f"the function {name}" if name else f"a {type(function).__name__}"
    raise TypeError(
        f"controller: expected what makes a controller, got {got}; write "
        f"functools.partial(FunctionController, {name if name.isidentifier() else '...'}), or in "
        "YAML _target_: rrl.controllers.FunctionController with it under function:"
    )


def _needs_arguments(function: Callable[..., Any]) -> bool:
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # it has no signature, or one that its arguments do not fit
        return False
    many = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return any(p.default is p.empty and p.kind not in many for p in parameters)


def make_native(base: Callable[..., EnvBase], num_envs: int) -> EnvBase:
    """Make an environment with a batch size of its own.

    Raises:
        TypeError: If ``base`` does not take the number of slots.
    """
    try:
        return base(num_envs=num_envs)
    except TypeError as error:
        if "unexpected keyword argument 'num_envs'" not in str(error):
            raise
        raise TypeError(
            f'base: expected what takes num_envs, because batching is "native", got {base!r}; '
            'batching="serial" makes each slot by a call without it'
        ) from error


def check_action(spec: Composite) -> None:
    """Refuse an environment whose action is not one vector of floating point numbers.

    Raises:
        KeyError: If there is no entry ``action``.
        TypeError: If it is not continuous.
        ValueError: If it is no vector, or not the only action.
    """
    names = [str(key) for key in spec.keys(True, True)]
    if ACTION not in names:
        raise KeyError(
            f"action: expected an entry 'action', got {', '.join(names)}; rename it with "
            "torchrl.envs.RenameTransform"
        )
    if len(names) > 1:
        raise ValueError(f"action: expected no other action entry, got {', '.join(names)}")
    leaf = spec[ACTION]
    shape = list(leaf.shape[spec.ndim :])
    if not leaf.dtype.is_floating_point:
        raise TypeError(
            f"action: expected a continuous action, got {type(leaf).__name__} of {leaf.dtype}"
        )
    if len(shape) != 1 or not shape[0]:
        raise ValueError(
            f"action: expected a vector [*batch, n], got the shape {shape} beside the batch; let "
            "the environment take its numbers in one dimension"
        )


def check_number(name: str, spec: TensorSpec) -> None:
    """Refuse an entry that holds no numbers, or such as buffer and disk cannot hold.

    Raises:
        TypeError: If it holds text or other objects, or further entries, or such numbers.
    """
    if isinstance(spec, (Composite, NonTensor)):
        kind = "further entries" if isinstance(spec, Composite) else "text or other objects"
        raise TypeError(f"{name}: expected numbers, got {kind}")
    if spec.dtype not in NUMBERS:
        raise TypeError(
            f"{name}: expected bool, uint8, int8 to int64 or float16 to float64, got "
            f"{spec.dtype}; convert it with torchrl.envs.DTypeCastTransform"
        )


def check_reported(spec: Composite, batch_dims: int, declared: Mapping[str, Any]) -> None:
    """Refuse reserved entries that cannot be reported: each must be one number a slot.

    Raises:
        ValueError: If one is not, has the name of what is derived from another one, or ``declared``
            names one that the environment does not write.
    """
    present = list(spec.keys())
    leaves = {key: spec[key] for key in (SUCCESS, DIVERGED) if key in present}
    for group in (METRICS, SAFETY, REWARD_TERMS):
        entries = spec[group] if group in present else Composite()
        if not isinstance(entries, Composite):
            shape = list(entries.shape[batch_dims:])
            raise ValueError(
                f"environment: {group}: expected named entries ({group!r}, NAME) of one number "
                f"each, got a tensor {shape}"
            )
        leaves |= {f"{group}/{name}": leaf for name, leaf in entries.items()}
    for name, leaf in leaves.items():
        shape = list(leaf.shape[batch_dims:])
        kinds = {Composite: "a nested entry", NonTensor: "text or another object"}
        got = next((k for kind, k in kinds.items() if isinstance(leaf, kind)), f"a tensor {shape}")
        if not got.startswith("a tensor") or leaf.shape[batch_dims:].numel() != 1:
            raise ValueError(
                f"environment: {name}: expected one number a slot [*batch, 1], got {got}: write "
                "each component under its own name, or a norm"
            )
    written = [name.partition("/")[2] for name in leaves if name.startswith(f"{METRICS}/")]
    endings = (P99, *ABOVE.values())
    if taken := [name for name in written if name.endswith(endings)]:
        raise ValueError(
            f"environment: metrics: expected names without the endings {', '.join(endings)}, which "
            f"evaluations add, got {', '.join(taken)}"
        )
    if missing := sorted(set(declared) - set(written)):
        raise ValueError(
            f"environment: metrics: expected names that the environment writes {written}, "
            f"got {missing}"
        )
