"""How the paper's claims are tested: whether one holds, and by which numbers."""

from __future__ import annotations

import numpy as np

from ..evaluation.statistics import Interval, mean_interval, rate_interval
from ..metric_names import CONTROLLER
from ..report.tables import brackets, with_interval
from .outcomes import ROUNDING, SOLVED, Finding, Outcome

RESIDUAL, ALONE = "residual RL", "RL alone"
SIM_ARM = "residual RL on the policy from simulation"
LEVEL = 1 / 3
"""A residual is level if it loses at most this share of what the controller loses over a sweep."""
FEW_STEPS = 1000


def learns_faster(finding: Finding) -> tuple[bool, str]:
    """Mean return over all evaluations: the intervals over seeds are apart."""
    residual, alone = (
        finding.arm(arm)[0].curve("return").values.mean(axis=1) for arm in (RESIDUAL, ALONE)
    )
    text = f"mean return over training: residual {_with_interval(residual)}, "
    text += f"RL alone {_with_interval(alone)}"
    return _interval(residual)[0] > _interval(alone)[1], text


def ends_above(finding: Finding) -> tuple[bool, str]:
    """The paired gain in return over the controller is above zero by its interval over seeds."""
    outcome = finding.arm(RESIDUAL)[0]
    gain = outcome.final("return_gain")
    controller = outcome.final("controller_return")[0]
    text = f"final return: residual {_with_interval(outcome.final('return'))}, "
    text += f"controller {controller:.2f}, gain {_with_interval(gain)}"
    return _interval(gain)[0] > 0, text


def stays_level(finding: Finding) -> tuple[bool, str]:
    """The controller loses more than 5 % of its return, the residual a third of that at most."""
    first, last = _ends(finding)
    lost = {
        name: _mean(first.final(name) - last.final(name))
        for name in ("return", "controller_return")
    }
    falls = lost["controller_return"] > 0.05 * abs(_mean(first.final("controller_return")))
    text = f"return lost from {first.point.value:g} to {last.point.value:g}: "
    text += f"residual {lost['return']:.2f}, "
    text += f"controller {lost['controller_return']:.2f}; {_rates(first, last)}"
    return falls and lost["return"] <= LEVEL * lost["controller_return"], text


def withstands_noise(finding: Finding) -> tuple[bool, str]:
    """From the smallest noise to the largest the residual loses less than a tenth of its return."""
    first, last = _ends(finding)
    before, after = (_mean(outcome.final("return")) for outcome in (first, last))
    controller = [float(outcome.final("controller_return").mean()) for outcome in (first, last)]
    text = f"return at sigma = {first.point.value:g} and {last.point.value:g}: "
    text += f"residual {before:.2f} and {after:.2f}, "
    text += f"controller {controller[0]:.2f} and {controller[1]:.2f}"
    return before - after < 0.1 * abs(before), text


def solves_misaligned(finding: Finding) -> tuple[bool, str]:
    """At least 15 of 20 by the residual, at most 5 of 20 by the controller."""
    residual, controller, text = _counts(finding.outcomes[0], "misaligned")
    return residual >= 15 / 20 and controller <= 5 / 20, text


def solves_aligned(finding: Finding) -> tuple[bool, str]:
    """At least 19.5 of 20 by both."""
    residual, controller, text = _counts(finding.outcomes[0], "aligned")
    return min(residual, controller) >= 19.5 / 20, text


def success_grows(finding: Finding) -> tuple[bool, str]:
    """The last evaluation is at 15 of 20 or more, and above the first by its interval."""
    curve = finding.outcomes[0].curve("success")
    first, last = curve.values[:, 0], curve.values[:, -1]
    episodes = int(finding.outcomes[0].point.config["trainer"]["evaluation"]["episodes"])
    interval = rate_interval(np.rint(last * episodes), episodes)
    text = f"success at step {curve.steps[0]:.0f}: {first.mean():.0%}, "
    text += f"at {curve.steps[-1]:.0f}: {last.mean():.0%} "
    text += brackets(interval, ".0f", 100.0, "%")
    return bool(last.mean() >= 15 / 20 - ROUNDING and interval[0] > first.mean()), text


def learns_under_bias(finding: Finding) -> tuple[bool, str]:
    """At every bias the residual ends at 15 of 20 or more, and not below the controller."""
    parts, holds = [], True
    for outcome in finding.arm(RESIDUAL):
        residual = _mean(outcome.final("success"))
        controller = _mean(outcome.final("controller_success"))
        rates = f"residual {residual:.0%}, controller {controller:.0%}"
        parts.append(f"mu = {outcome.point.value:g}: {rates}")
        holds &= residual >= max(15 / 20, controller) - ROUNDING
    return holds, "; ".join(parts)


def transfers_quickly(finding: Finding) -> tuple[bool, str]:
    """From before environment step 1000 to the end the mean success over seeds is 90 % or more."""
    parts = [f"{arm}: {_steps_text(finding.arm(arm)[0])}" for arm in finding.arms]
    steps = _steps_to_solve(finding.arm(SIM_ARM)[0])
    text = f"steps after which success stays at {SOLVED:.0%}: {'; '.join(parts)}"
    return steps is not None and steps < FEW_STEPS, text


def explores_wider(finding: Finding) -> tuple[bool, str]:
    """The summed variance of the positions visited: the intervals over seeds are apart."""
    residual, alone = (finding.arm(arm)[0].variances().sum(axis=1) for arm in (RESIDUAL, ALONE))
    spread = finding.arm(ALONE)[0].point.spread
    assert spread is not None
    text = f"variance of the {spread.name}s visited [{spread.unit}^2]: "
    text += f"RL alone {_with_interval(alone)}, "
    text += f"residual {_with_interval(residual)}"
    return _interval(alone)[0] > _interval(residual)[1], text


def _ends(finding: Finding) -> tuple[Outcome, Outcome]:
    outcomes = sorted(finding.arm(RESIDUAL), key=lambda outcome: outcome.point.value or 0.0)
    if len(outcomes) < 2:
        raise IndexError("at least two settings")
    return outcomes[0], outcomes[-1]


def _rates(first: Outcome, last: Outcome) -> str:
    rates = [
        f"{100 * o.final(entry).mean():.0f} %"
        for entry in ("success", "controller_success")
        for o in (first, last)
    ]
    return f"success: residual {rates[0]} to {rates[1]}, controller {rates[2]} to {rates[3]}"


def _counts(outcome: Outcome, scenario: str) -> tuple[float, float, str]:
    """Return the rates of residual and controller, and their counts by seed in words."""
    both = outcome.counts(scenario), outcome.counts(scenario, CONTROLLER)
    named = zip(("residual", "controller"), both, strict=True)
    text = "; ".join(f"{name} {counts}, {20 * counts.rate:.1f} of 20" for name, counts in named)
    return both[0].rate, both[1].rate, text


def _steps_to_solve(outcome: Outcome) -> int | None:
    curve = outcome.curve("success")
    first = max(np.flatnonzero(curve.mean < SOLVED - ROUNDING), default=-1) + 1
    return int(curve.steps[first]) if first < len(curve.steps) else None


def _steps_text(outcome: Outcome) -> str:
    steps, start = _steps_to_solve(outcome), outcome.curve("success").mean[0]
    return f"{'not reached' if steps is None else steps} (from {start:.0%})"


def _mean(values: np.ndarray) -> float:
    """The mean over seeds; without numbers a claim cannot be tested."""
    mean = float(values.mean())
    if np.isnan(mean):
        raise IndexError("numbers from all seeds")
    return mean


def _interval(values: np.ndarray) -> Interval:
    """The interval of a mean over seeds, without which a claim cannot be tested."""
    interval = mean_interval(values)
    if np.isnan(interval).any():
        raise IndexError("at least two seeds, and numbers from all of them that differ")
    return interval


def _with_interval(values: np.ndarray) -> str:
    return with_interval(float(values.mean()), _interval(values))
