"""The names of all metrics: ``group/metric``, one number over ``env_steps``."""

from __future__ import annotations

from collections.abc import Mapping

STEP_AXIS = "env_steps"
"""Environment steps: the common horizontal axis."""

Values = Mapping[str, float]
"""Metric name to value."""

TRAIN = "train"
"""What the exploring policy meets: ``train/return``, ``.../success``, ``.../reward_terms/TERM``."""

LEAST_RETURN = "train/least_return"
"""Of the episodes of which ``train/return`` is the mean."""

LOSS = "loss"
"""What the updates report: ``loss/loss_critic``, ``loss/q_value``, ``loss/target_value``."""

EVALUATION = "eval"
"""Followed episodes during training: ``eval/<scenario>/success``, ``.../rescues``,
``.../controller_success``, ``.../episodes`` (their number), ``.../metrics/<name>``,
``.../metrics/<name>_p99``, shares of episodes ``.../metrics/<name>_above_budget`` and
``.../<name>_above_limit``; of what the run would hand over ``.../accepted_success``,
``.../accepted_env_steps`` (0: the controller). Of a robot also ``.../faults``, a number, with the
same prefixes."""

ACCEPTANCE = "acceptance"
"""The test of a candidate: ``acceptance/episodes`` (pairs; 0: it was none), ``.../evidence`` (1 or
more accepts), ``.../accepted`` (0 or 1), ``.../alpha_left``; of a robot ``.../faults`` and
``.../controller_faults``."""

FINAL = "final"
"""The same of the final episodes, of every scenario: ``final/<scenario>/success``."""

ACTION = "action"
"""Who does the work: ``action/residual_rms``, ``.../residual_share``, ``.../clip_fraction``."""

INTERVENTION = "intervention"
"""Share of the training steps that an operator has taken over, ``intervention/steps``, and that no
residual would have given, ``intervention/exceeds``."""

SAFETY = "safety"
"""Share of the training steps in which a limit changed the action: ``safety/workspace``,
``safety/step``, ``safety/force``; in evaluations ``eval/<scenario>/safety_<limit>``."""

REALTIME = "realtime"
"""Of collection in wall-clock time: ``realtime/period_error_ms_p50``, ``_p99`` and ``_max``, the
same of ``inference_ms``; ``realtime/missed_deadlines`` and ``.../faults``, counts;
``.../policy_age``, environment steps since the acting policy's; ``.../reset_seconds``."""

CONSTRAINT = "constraint"
"""Of every quantity with a budget: ``constraint/<name>/multiplier``, the price of one budget, and
``constraint/<name>/episode``, what the exploring policy's episodes came to."""

TIME = "time"
"""Seconds since the last row: ``time/collect`` (waiting, where it overlaps), ``store``, ``sample``,
``update``, ``evaluate``, ``checkpoint``, ``log``; ``sample`` and ``compile`` are parts of
``update``. With ``trainer.profile`` also the parts of a collection, ``time/collect/<part>``, or of
``time/background`` where a second process collects."""

CLOCK = "clock"
"""Seconds since the run began: ``clock/training`` of updates, ``clock/robot`` of the environment's
steps, evaluations included and pauses not, ``clock/reset`` of its resets."""

WHOLE_SECTIONS = ("collect", "store", "update", "evaluate", "checkpoint", "log")
"""Of ``time/``: they follow one another, so that their sum is the time of the run."""


def name(group: str, *parts: str) -> str:
    """Join the parts of a metric's name."""
    return "/".join((group, *parts))


def evaluation(group: str, scenario: str, summary: Mapping[str, float]) -> dict[str, float]:
    """Name the entries of an evaluation's summary; ``group`` is ``EVALUATION`` or ``FINAL``."""
    return {name(group, scenario, key): value for key, value in summary.items()}


def clock(seconds: Mapping[str, float]) -> dict[str, float]:
    """Name seconds by what they were spent on."""
    return {name(CLOCK, part): value for part, value in seconds.items()}
