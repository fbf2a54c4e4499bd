"""Ratios to Stable-Baselines3 with their spread over the rounds, as a table and as a bar chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

Measurement = Mapping[str, Any]
Rounds = Mapping[str, Sequence[Measurement]]
"""Contender to one measurement a round."""
REFERENCE = "sb3"
LABELS = {
    "rrl": "rrl",
    "rrl-plain": "rrl, plain settings",
    "rrl-default": "rrl, its default algorithm",
    "sb3": "Stable-Baselines3",
    "sb3-several": "Stable-Baselines3, five environments",
    "sbx": "SBX (JAX)",
    "cleanrl": "CleanRL style",
    "torchrl": "TorchRL's TD3Trainer",
}


def ratios(rounds: Rounds, name: str, quantity: str) -> np.ndarray:
    """``quantity`` of a contender in units of the reference's, round by round."""
    pairs = zip(rounds[name], rounds[REFERENCE], strict=True)
    return np.array([mine[quantity] / reference[quantity] for mine, reference in pairs])


def reached(measurement: Measurement, rate: float) -> float | None:
    """Seconds from the process's start to the first evaluation of at least ``rate``."""
    return next((seconds for seconds, value in measurement["curve"] if value >= rate), None)


def table(rounds: Rounds, rate: float | None) -> str:
    """Markdown; medians over the rounds, ratios with their least and largest."""
    header = [
        "contender",
        "steps/s",
        "to SB3",
        "processor, to SB3",
        "first update [s]",
        "peak [MB]",
    ]
    header += [] if rate is None else [f"{rate:.0%} success [s]"]
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    for name, measurements in rounds.items():
        wall, busy = (
            ratios(rounds, name, "steps_per_second"),
            1 / ratios(rounds, name, "processor_ms_per_step"),
        )
        medians = {
            q: np.median([m[q] for m in measurements])
            for q in ("steps_per_second", "first_update_s", "peak_mb")
        }
        cells = [
            LABELS[name],
            f"{medians['steps_per_second']:.0f}",
            *(f"{np.median(r):.2f} [{r.min():.2f}, {r.max():.2f}]" for r in (wall, busy)),
            f"{medians['first_update_s']:.1f}",
            f"{medians['peak_mb']:.0f}",
        ]
        if rate is not None:
            times = [reached(m, rate) for m in measurements]
            cells.append(", ".join("-" if t is None else f"{t:.0f}" for t in times))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def chart(rounds: Rounds, title: str, path: Path) -> None:
    """Bars of the speed in units of the reference's; whiskers from the slowest to the fastest round."""
    names = sorted(
        rounds, key=lambda name: float(np.median(ratios(rounds, name, "steps_per_second")))
    )
    values = [ratios(rounds, name, "steps_per_second") for name in names]
    middle = np.array([np.median(v) for v in values])
    spread = np.array([[m - v.min(), v.max() - m] for m, v in zip(middle, values, strict=True)]).T
    figure, axes = plt.subplots(figsize=(7, 0.5 * len(names) + 1.2), layout="constrained")
    colors = ["tab:blue" if name.startswith("rrl") else "0.65" for name in names]
    axes.barh(
        [LABELS[name] for name in names], middle, xerr=spread, color=colors, error_kw={"capsize": 3}
    )
    for y, value in enumerate(middle):
        axes.text(
            0.02 * middle.max(), y, f"{value:.2f}", va="center", color="white", fontweight="bold"
        )
    axes.axvline(1.0, color="0.3", linewidth=0.8)
    axes.set_xlabel("steps a second, in units of Stable-Baselines3's")
    axes.set_title(title)
    axes.spines[["top", "right"]].set_visible(False)
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=150)
    plt.close(figure)
