"""What a trainer asks of an environment and its entries, checked before anything is collected."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from math import isclose
from numbers import Integral
from typing import Any, Literal, get_args

import torch
from torch import nn
from torchrl.data import Composite, TensorSpec
from torchrl.data.tensor_specs import NonTensor
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv

from rrl.inputs import Input
from rrl.keys import ACTION, DIVERGED, METRICS, REWARD, REWARD_TERMS, SAFETY, SUCCESS
from rrl.pace import Pace

from .metric import Metric
from .metric_names import ABOVE, P99

__all__ = [
    "Batching",
    "check_action",
    "check_base",
    "check_factory",
    "check_number",
    "check_period",
    "check_reported",
    "check_reward",
    "check_slots",
    "make_native",
]

Batching = Literal["native", "serial", "parallel"]
BATCHINGS = get_args(Batching)

FLOATING = (torch.float16, torch.float32, torch.float64)
INTEGERS = (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)
NUMBERS = (torch.bool, *INTEGERS, *FLOATING)


def check_factory(fields: Mapping[str, Any]) -> None:
    """Refuse fields of an environment's factory that look right and are something else.

    Raises:
        TypeError: If one of them is a part instead of what makes it, inputs are a single name, or a
            list, an input or a metric is something else.
        ValueError: If ``batching`` is unknown or there are no steps.
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
        if isinstance(given, (set, frozenset)):
            raise TypeError(f"{name}: expected names in their order, in a list, got {given!r}")
        _check_values(name, given, Input)
    _check_values("metrics", fields["metrics"], Metric)
    for name in ("safety", "disturbances", "sensing"):
        if not isinstance(given := fields[name], (list, tuple)):
            raise TypeError(f"{name}: expected a list of what makes transforms, got {given!r}")
    if fields["batching"] not in BATCHINGS:
        choices = ", ".join(BATCHINGS)
        raise ValueError(f"batching: expected one of {choices}, got {fields['batching']!r}")
    steps = fields["max_episode_steps"]
    if not isinstance(steps, Integral) or isinstance(steps, bool) or steps < 1:
        raise ValueError(f"max_episode_steps: expected a whole number above 0, got {steps!r}")


def _check_values(name: str, given: Any, kind: type) -> None:
    """Refuse plain dictionaries, as YAML has them, in the place of a dataclass."""
    for key, value in given.items() if isinstance(given, Mapping) else ():
        if not isinstance(value, kind):
            raise TypeError(f"{name}: expected {key!r} to be a {kind.__name__}(...), got {value!r}")


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


def check_base(base: Any) -> EnvBase:
    """Return ``base``, which ``base`` made, if it is a TorchRL environment.

    Raises:
        TypeError: If it is anything else.
    """
    if isinstance(base, EnvBase):
        return base
    remedy = "; rrl.envs.gymnasium_env makes one of it" if hasattr(base, "action_space") else ""
    got = "None" if base is None else f"a {type(base).__name__}"
    raise TypeError(f"base: expected what makes a torchrl.envs.EnvBase, got {got}{remedy}")


def check_slots(batch_size: torch.Size, num_envs: int) -> None:
    """Refuse an environment with another number of slots than it was asked for.

    Raises:
        ValueError: If it has.
    """
    if batch_size.numel() != num_envs:
        raise ValueError(
            f"base: expected an environment of {num_envs} slots (num_envs), got the batch size "
            f"{list(batch_size)}"
        )


def check_period(base: EnvBase, given: float | None, name: str = "control_period") -> None:
    """Refuse another control period than the one that a robot is driven at.

    Raises:
        ValueError: If ``base`` keeps a pace of its own, and not this one.
    """
    if given is None:
        return
    while isinstance(base, TransformedEnv):
        base = base.base_env
    batched = isinstance(base, (SerialEnv, ParallelEnv))  # of a robot there are no copies
    pace = None if batched else getattr(base, "pace", None)
    if isinstance(pace, Pace) and not isclose(given, pace.period):
        raise ValueError(
            f"{name}: expected null or {pace.period:g}, the robot's own, got {given:g}"
        )


def check_reward(spec: Composite) -> None:
    """Refuse an environment whose reward is not one number a slot, under the name ``reward``.

    Raises:
        ValueError: If there is none, or further ones, or of another shape.
    """
    leaves = {str(key): spec[key] for key in spec.keys(True, True)}
    shapes = {name: list(leaf.shape) for name, leaf in leaves.items()}
    if list(leaves) != [REWARD] or shapes[REWARD] != [*spec.shape, 1]:
        raise ValueError(
            f"reward: expected one entry {REWARD!r} of the shape {[*spec.shape, 1]}, one number a "
            f"slot, got {shapes}"
        )


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
