"""The names of all metrics. A name is ``group/metric``; every value is one number per seed over ``env_steps``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

STEP_AXIS = "env_steps"
"""Environment steps of one seed: the common horizontal axis."""

Values = Mapping[str, Sequence[float]]
"""Metric name to one value per seed."""

TRAIN = "train"
"""What the exploring policy experiences: ``train/return``, ``train/success``, ``train/reward_terms/<term>``."""

LOSS = "loss"
"""What the updates report: ``loss/loss_critic``, ``loss/q_value``, ``loss/target_value``, ``loss/loss_actor``."""

EVALUATION = "eval"
"""Frozen episodes, by scenario: ``eval/<scenario>/success``, ``.../rescues``, ``.../controller_success``."""

ACTION = "action"
"""The split of work: ``action/residual_rms``, ``action/residual_share``, ``action/clip_fraction``."""

SAFETY = "safety"
"""Share of the training steps in which a limit changed the action: ``safety/workspace``, ``safety/step``,
``safety/force``; in evaluations ``eval/<scenario>/safety_<limit>``."""

TIME = "time"
"""Seconds since the last row: ``time/collect`` (waiting, where it overlaps), ``store``, ``sample``, ``update``,
``evaluate``, ``checkpoint``, ``log``; ``sample`` and ``compile`` are parts of ``update``. With ``trainer.profile`` also
the parts of a collection, ``time/collect/<part>``, or of ``time/beside`` where a second process collects.
"""


def name(group: str, *parts: str) -> str:
    """Join the parts of a metric's name."""
    return "/".join((group, *parts))


def evaluation(scenario: str, summary: Mapping[str, float]) -> dict[str, float]:
    """Name the entries of one evaluation's summary."""
    return {name(EVALUATION, scenario, key): value for key, value in summary.items()}
