"""What makes a run the same run: when it is resumed, and for what it comes to."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

NOT_MEASURED = (
    "name",
    "launcher",
    "workers",
    "logger*",
    "render.*",
    "trainer.profile",
    "trainer.keys",
    "trainer.threads",
    "trainer.checkpoint.*",
    "trainer.evaluation.slots",
    "env.base.num_threads",
    "env.renderer*",
    "env.packages*",
)
"""Dotted keys, with ``*`` for anything, that do not decide what is learned and measured."""
MAY_CHANGE = (
    *NOT_MEASURED,
    "trainer.total_steps",
    "trainer.evaluation.*",
    "trainer.acceptance.episodes",
    "env.scenarios*",
    "algorithm.agent.*_lr",
    "algorithm.agent.compiled",
    "agent.*_lr",
    "agent.compiled",
    "environment.base.num_threads",
)
"""What a resumed run may have otherwise. All other keys decide what parameters and transitions
mean, or which random numbers come next."""
SEEDS = ("trainer.seed", "trainer.num_seeds")
"""Dotted keys in which runs differ that are shown as one."""

ABSENT = "(absent)"


def as_json(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration as checkpoints keep it; what JSON does not know becomes text."""
    return dict(json.loads(json.dumps(config, default=str)))


def require_same_run(saved: Mapping[str, Any], current: Mapping[str, Any]) -> None:
    """Refuse to resume a run with a configuration that is not its own.

    Args:
        saved: The configuration that the checkpoint was made with.
        current: The configuration to go on with.

    Raises:
        ValueError: With one line for every key that changed and may not: ``key: old -> new``.
    """
    changed = [
        f"  {key}: {old} -> {new}"
        for key, (old, new) in differences(saved, current).items()
        if not _fits(key, MAY_CHANGE)
    ]
    if changed:
        raise ValueError(
            "expected the configuration that the run was made with, got another one:\n"
            + "\n".join(changed)
            + "\nResume with the old "
            "values or start a new run. What may change: " + ", ".join(MAY_CHANGE)
        )


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Dotted keys of all entries that differ, with both values as JSON."""
    before, after = leaves(old), leaves(new)
    keys = sorted(before.keys() | after.keys())
    values = {key: (before.get(key, ABSENT), after.get(key, ABSENT)) for key in keys}
    return {key: pair for key, pair in values.items() if pair[0] != pair[1]}


def _fits(key: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(key, pattern) for pattern in patterns)


def leaves(node: Any, path: str = "") -> dict[str, str]:
    """Dotted keys of a configuration's entries, with their values as JSON."""
    if isinstance(node, Mapping) and node:
        found: dict[str, str] = {}
        for key, child in node.items():
            found |= leaves(child, f"{path}.{key}" if path else str(key))
        return found
    return {path: json.dumps(node, default=str)} if path else {}


def measured_settings(config: Mapping[str, Any], without: Sequence[str] = ()) -> dict[str, str]:
    """Return the entries that decide what is learned and measured, by dotted key.

    Args:
        config: A resolved configuration.
        without: Further keys to leave out, with ``*`` for anything.
    """
    given = leaves(config)
    patterns = (*NOT_MEASURED, *_unused(given), *without)
    return {key: value for key, value in given.items() if not _fits(key, patterns)}


def _unused(given: Mapping[str, str]) -> list[str]:
    """Return patterns of settings of what is switched off; a new one must not make runs old."""
    budgets = [v for k, v in given.items() if fnmatchcase(k, "env.metrics.*.budget")]
    unused = {
        "trainer.constraints*": all(value == "null" for value in budgets),
        "algorithm.agent.value_bounds": given.get("algorithm.agent.value_bounds") == "false",
        "algorithm.agent.products": given.get("algorithm.agent.products") == '"float32"',
        "trainer.realtime.*": given.get("trainer.collection") != '"realtime"',
    }
    return [pattern for pattern, off in unused.items() if off]
