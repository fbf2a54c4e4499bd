"""Arguments of what a configuration names by ``_target_``, compared with what it takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError
from torchrl.data import Bounded

from rrl.algorithms import Agent, mlp
from rrl.encoders import automatic

from ..errors import place
from ..training.factories import build, is_target, locate
from .schema import Target, explain

Config = Mapping[str, Any]
Problems = Iterator[str]


def check_targets(config: Config, built: dict[str, Any]) -> Problems:
    """Check every target's arguments, and the values of those that are made to be checked.

    What an argument may be, a class says where it is made, and nowhere else: so controller,
    learner, exploration, transforms, operator and loggers are made if they are classes, which
    opens nothing. A function, an environment, a robot and a renderer are never called; of an
    environment ``check_arguments`` is, where it has one.

    Args:
        config: Resolved, of the right layout.
        built: Gets what was made, by its path.
    """
    env, algorithm = config["env"], config["algorithm"]
    spec = Bounded(-1.0, 1.0, (1, 1), dtype=torch.float32)
    interface = {"inputs": {"observation": 1}, "action_size": 1}
    interface["episode_steps"] = env["max_episode_steps"]
    nodes: list[tuple[str, Target, Config]] = [
        ("controller", config["controller"], {}),
        ("algorithm.agent", algorithm["agent"], interface),
        ("algorithm.exploration", algorithm["exploration"], {"spec": spec}),
    ]
    groups = {name: config.get(name) for name in ("disturbance", "safety", "operator")}
    groups |= {"env.sensing": env.get("sensing"), "logger": config.get("logger")}
    for group, members in groups.items():
        nodes += [(f"{group}.{name}", n, {}) for name, n in (members or {}).items() if n]
    for path, node, given in nodes:
        yield from _check_build(path, node, given, built)
    slots = {"num_envs": 1} if env["batching"] == "native" else {}
    found = list(_check_environment("env.base", env["base"], slots))
    yield from found
    said = {problem.removeprefix("env.base") for problem in found}
    for name, overrides in env["scenarios"].items():
        path = f"env.scenarios.{name}"
        for problem in _check_environment(path, {**env["base"], **(overrides or {})}, slots):
            if problem.removeprefix(path) not in said:  # its own, not the base's again
                yield problem
    if env.get("renderer"):
        yield from _check_renderer("env.renderer", env["renderer"])


def _check_build(path: str, node: Target, given: Config, built: dict[str, Any]) -> Problems:
    """Check a node's arguments, and their values by building it, unless it is a function.

    A function may read earlier runs or play episodes: only its signature is compared.
    """
    found = [*_check_inner(path, node), *_check_arguments(path, node, given)]
    yield from found
    if found or not inspect.isclass(locate(node["_target_"])):
        return
    make = _learner if path == "algorithm.agent" else build
    try:
        built[path] = make(node)(**given)
    except ValidationError as error:
        yield from explain(error, path)
    except Exception as error:  # a target may say in any way that it does not like its arguments
        yield f"{path}: {_text(error)}"


def _learner(node: Target) -> Callable[..., Any]:
    """Return what makes of a learner what can be made without the environment's entries.

    A learner, an encoder or a network of anybody's may need entries and sizes that only the built
    environment tells: of such a learner the settings alone are made, and ours stand for such parts.
    """
    ours = {"encoder": automatic, "network": mlp}
    parts = {key: value for key, value in node.items() if key in ours and is_target(value)}
    others = {key for key, part in parts.items() if locate(part["_target_"]) is not ours[key]}
    make = build({key: value for key, value in node.items() if key not in others})
    if make.func.__module__.startswith(f"{Agent.__module__.rpartition('.')[0]}."):
        return make
    settings = getattr(make.func, "Settings", dict)
    fields = getattr(settings, "model_fields", ())
    known = {key: value for key, value in make.keywords.items() if key in fields}
    return lambda **_: settings(**known)


def _check_inner(path: str, node: Target) -> Problems:
    """Check the arguments of targets among a node's arguments."""
    for where, inner in _inner(path, node):
        yield from _check_arguments(where, inner, None)


def _inner(path: str, value: Any) -> Iterator[tuple[str, Target]]:
    """Yield the targets below a value, in mappings and lists, and where they stand."""
    items = value.items() if isinstance(value, Mapping) else ()
    for key, inner in enumerate(value) if isinstance(value, list) else items:
        if is_target(inner):
            yield f"{path}.{key}", dict(inner)
        yield from _inner(f"{path}.{key}", inner)


def _check_renderer(path: str, node: Target) -> Problems:
    """Check that a renderer can be called as ``renderer(base_env, states, width=, height=)``."""
    size = {"width": 640, "height": 480}
    found = [*_check_inner(path, node), *_check_arguments(path, node, size, positional=2)]
    yield from found
    if found:
        return
    parameters = _parameters(locate(node["_target_"]))
    lacking = sorted({*size} - {*parameters})
    if lacking and not _takes_any(parameters):
        yield (
            f"{path}: expected a function (base_env, states, width=..., height=...), got "
            f"{node['_target_']} without {' and '.join(lacking)}"
        )


def _check_environment(path: str, node: Target, given: Config) -> Problems:
    """Check an environment's arguments by signature, and by ``check_arguments`` if it has one."""
    found = [*_check_inner(path, node), *_check_arguments(path, node, given)]
    yield from found
    if found:
        return
    try:
        entries(node)
    except Exception as error:
        yield f"{path}: {_text(error)}"


def entries(base: Target) -> dict[str, int] | None:
    """Return the observation entries' sizes, if the environment tells them unbuilt."""
    tell = getattr(locate(base["_target_"]), "check_arguments", None)
    arguments = {key: value for key, value in base.items() if key != "_target_"}
    return None if tell is None else dict(tell(**arguments))


def may_be_robot(config: Config) -> bool:
    """Return whether what a configuration drives may be a robot, as far as it tells unbuilt.

    A robot's class has a method ``stop``. What a function makes is not known: in real time it may
    be one.
    """
    base = locate(config["env"]["base"]["_target_"])
    if inspect.isclass(base):
        return callable(getattr(base, "stop", None))
    return bool(config["trainer"]["collection"] == "realtime")


def _check_arguments(
    path: str, node: Target, given: Config | None, positional: int = 0
) -> Problems:
    """Compare a node with its target's signature.

    Args:
        path: Where the node stands.
        node: The node.
        given: Arguments that others supply by name; None: all that lack.
        positional: How many they supply besides, the first ones.
    """
    target = node.get("_target_")
    if not isinstance(target, str):
        yield f"{path}: expected _target_: package.module.name, got {target!r}"
        return
    try:
        parameters = _parameters(locate(target))
    except (ValueError, TypeError) as error:
        yield f"{path}: {error}{_reason(error.__cause__)}"
        return
    names = [n for n, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    supplied = {*names[:positional], *(given or ())}
    takes = [n for n in names if n not in supplied]
    for key in sorted(supplied.intersection(node)):
        yield f"{path}: {target} gets {key!r} from the run: expected none here, got {node[key]!r}"
    if not _takes_any(parameters):
        for key in sorted(set(node) - set(names) - {"_target_"}):
            yield f"{path}: {target} does not take {key!r}; it takes {', '.join(takes)}"
    for name in takes if given is not None else ():
        if parameters[name].default is inspect.Parameter.empty and name not in node:
            given_names = sorted(set(node) - {"_target_"})
            yield f"{path}: {target} needs {name!r}, got {given_names}{_remedy(path, target)}"


def _remedy(path: str, target: str) -> str:
    """Return what to do with a function of observations in the controller's place."""
    if path != "controller" or not inspect.isfunction(locate(target)):
        return ""
    return (
        "; if these are observations, name it under function: of rrl.controllers.FunctionController"
    )


def _parameters(target: Any) -> dict[str, inspect.Parameter]:
    """Return a target's parameters; an agent's ``**settings`` are fields of its ``Settings``."""
    parameters = dict(inspect.signature(target).parameters)
    settings = getattr(target, "Settings", None)
    if settings is None:
        return parameters
    kept = {n: p for n, p in parameters.items() if p.kind is not p.VAR_KEYWORD}
    keyword = inspect.Parameter.KEYWORD_ONLY
    fields = settings.model_fields
    return kept | {n: inspect.Parameter(n, keyword, default=None) for n in fields}


def _takes_any(parameters: Mapping[str, inspect.Parameter]) -> bool:
    return any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _reason(error: BaseException | None) -> str:
    """Return which line of the user's failed, or where a module that is not there is looked for."""
    if (where := place(error)) or not isinstance(error, ModuleNotFoundError):
        return where
    return f"; a project's modules are found from its folder: call rrl there, not in {Path.cwd()}"


def _text(error: Exception) -> str:
    """Return an error's text on one line, with its place in the user's own code."""
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    return (" ".join(text.split()) or type(error).__name__) + place(error)
