"""What ``rrl train`` uses where nothing is said, read from ``configs/``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from typing import Any

import yaml

__all__ = ["default_config"]


@lru_cache(maxsize=1)
def default_config() -> dict[str, Any]:
    """Return ``trainer`` and ``algorithm`` of ``rrl train``."""
    train = _read("train")
    chosen = {
        k: v for entry in train["defaults"] if isinstance(entry, dict) for k, v in entry.items()
    }
    algorithm, overrides = _with_parents(chosen["algorithm"])
    exploration = {"exploration": _read(f"exploration/{(chosen | overrides)['exploration']}")}
    merged = _merge(_merge(train, {"algorithm": exploration}), algorithm)
    return {section: merged[section] for section in ("trainer", "algorithm")}


def _with_parents(name: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Return an algorithm's file merged over its parents, and what they choose of other groups."""
    own = _read(f"algorithm/{name}")
    merged: dict[str, Any] = {}
    overrides: dict[str, str] = {}
    for entry in own.pop("defaults", []):
        if isinstance(entry, dict):
            overrides |= {k.removeprefix("override /"): v for k, v in entry.items()}
        elif entry != "_self_":
            parent, chosen = _with_parents(entry)
            merged, overrides = _merge(merged, parent), chosen | overrides
    return _merge(merged, own), overrides


def _read(name: str) -> dict[str, Any]:
    text = files("rrl.configs").joinpath(f"{name}.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merge(merged[key], value) if both else value
    return merged
