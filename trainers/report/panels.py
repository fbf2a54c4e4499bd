"""Which metrics are looked at, under which title: one list for report, pictures and dashboard."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rrl.keys import METRICS

from ..loggers import metrics
from ..metric_names import ABOVE, ACCEPTED, CONTROLLER, P99, is_share
from .curves import ANY

Declared = Mapping[str, Mapping[str, Any]]
"""What an environment says of its quantities, by name: ``unit``, ``budget``, ``limit``."""

FOLLOWED = "{followed}"
"""Stands in a metric's name for the scenario that is evaluated during training."""
SHARE = 100.0
"""Scale of what is logged as a share, and drawn as per cent."""


@dataclass(frozen=True)
class Panel:
    """One small chart over environment steps.

    Attributes:
        metric: The metric's name, with ``{followed}`` for a scenario.
        title: What it shows, with its unit.
        scale: Factor from the logged value to the drawn one.
        counted: Whether it is a share of the evaluation's episodes.
        controller: Metric of the controller alone on the same episodes.
        accepted: Metric of what the run would hand over, on the same episodes.
    """

    metric: str
    title: str
    scale: float = 1.0
    counted: bool = False
    controller: str = ""
    accepted: str = ""

    @property
    def bounds(self) -> tuple[float, float]:
        """The possible values."""
        return (0.0, 1.0) if self.scale == SHARE else ANY


def _evaluated(entry: str, title: str, *, counted: bool = False, paired: bool = True) -> Panel:
    name = metrics.name(metrics.EVALUATION, FOLLOWED, entry)
    others = [
        metrics.name(metrics.EVALUATION, FOLLOWED, prefix + entry) if paired else ""
        for prefix in (CONTROLLER, ACCEPTED)
    ]
    return Panel(name, title, SHARE if counted else 1.0, counted, *others)


LEARNING = (
    _evaluated("success", "success rate [%]", counted=True),
    _evaluated("return", "return of an episode"),
)
CHANGES = (
    _evaluated("rescue_rate", "rescued by the residual [%]", counted=True, paired=False),
    _evaluated("regression_rate", "broken by the residual [%]", counted=True, paired=False),
)  # fmt: skip
SHARES = (
    Panel("action/residual_share", "residual's share of the action [%]", SHARE),
    Panel("action/residual_rms", "residual, root mean square [action units]"),
    Panel("action/clip_fraction", "components clipped at the action's bounds [%]", SHARE),
)
LENGTH = _evaluated("episode_length", "control steps of an episode")


def quantities(entries: Iterable[str], declared: Declared) -> list[Panel]:
    """Return a panel for every ``metrics/<name>`` of an evaluation."""
    found = [entry for entry in entries if entry.startswith(f"{METRICS}/")]
    return [_evaluated(e, quantity_title(e, declared), counted=is_share(e)) for e in found]


def agreed(declarations: Iterable[Declared]) -> Declared:
    """Return what all say that say anything of a quantity's unit, budget or limit."""
    said: dict[str, dict[str, set[Any]]] = {}
    for name, how in (pair for declared in declarations for pair in declared.items()):
        entries = said.setdefault(name, {})
        for key, value in how.items():
            if value is not None:
                entries.setdefault(key, set()).add(value)
    return {
        name: {key: values.pop() for key, values in entries.items() if len(values) == 1}
        for name, entries in said.items()
    }


def quantity_title(entry: str, declared: Declared) -> str:
    """Name a mean, ``..._p99`` or a share ``..._above_...`` of ``metrics/<name>`` in words."""
    name = entry.partition("/")[2]
    bound = next((kind for kind, ending in ABOVE.items() if name.endswith(ending)), "")
    base = name.removesuffix(ABOVE[bound] if bound else P99)
    how, words = declared.get(base, {}), base.replace("_", " ")
    unit = how.get("unit", "")
    if bound:
        value = how.get(bound)
        above = f"its {bound}" if value is None else f"the {bound} {value:g} {unit}".rstrip()
        return f"{words} above {above} [%]"
    tail = ", 99th percentile" if base != name else ", mean"
    return words + tail + (f" [{unit}]" if unit else "")


def logged(names: Iterable[str]) -> list[Panel]:
    """Return a panel for every name, called by what follows its group."""
    words = {name: name.partition("/")[2].replace("/", ": ").replace("_", " ") for name in names}
    return [Panel(name, title) for name, title in words.items()]


def budgets(names: Iterable[str], declared: Declared) -> list[Panel]:
    """Return a panel for every ``constraint/<quantity>/multiplier`` and ``.../episode``."""
    found = []
    for name in names:
        quantity, _, what = name.partition("/")[2].rpartition("/")
        words, unit = quantity.replace("_", " "), declared.get(quantity, {}).get("unit", "")
        used = f"{words} of an episode" + (f" [{unit}]" if unit else "")
        found.append(Panel(name, used if what == "episode" else f"{words}, price of the budget"))
    return found


def safety(limits: Iterable[str]) -> list[Panel]:
    """Return two panels for every safety limit: steps that it changed in training, and followed."""
    evaluation = metrics.name(metrics.EVALUATION, FOLLOWED, f"{metrics.SAFETY}_")
    kinds = {"training": f"{metrics.SAFETY}/", "evaluation": evaluation}
    return [
        Panel(prefix + limit, f"{limit}, {kind} [%]", SHARE)
        for limit in limits
        for kind, prefix in kinds.items()
    ]
