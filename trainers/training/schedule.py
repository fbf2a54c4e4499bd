"""When a run evaluates, and how many episodes it will play, said before the first one."""

from __future__ import annotations

import logging

from ..evaluation.evaluator import Evaluator
from ..evaluation.replay_check import FEW
from ..settings import TrainerSettings
from .acceptance import Acceptance

log = logging.getLogger(__name__)

TESTS = "at most in tests of policies"


def announce(
    settings: TrainerSettings, evaluator: Evaluator, acceptance: Acceptance, env_steps: int
) -> None:
    """Say how many episodes a run plays from ``env_steps`` on, at most."""
    ahead = episodes_ahead(settings, evaluator, acceptance, env_steps)
    parts = ", ".join(f"{count} {what}" for what, count in ahead.items() if count)
    log.info("episodes on the environment: %s; %d in all", parts, sum(ahead.values()))
    if in_tests := ahead[TESTS]:
        pairs = settings.acceptance.episodes
        log.info(
            "acceptance: at most %d episodes in %d evaluations, beside the evaluations' own: "
            "%d pairs of policy and controller each; a test ends as soon as it is decided",
            in_tests,
            in_tests // (2 * pairs),
            pairs,
        )


def episodes_ahead(
    settings: TrainerSettings, evaluator: Evaluator, acceptance: Acceptance, env_steps: int
) -> dict[str, int]:
    """Return how many episodes a run plays from ``env_steps`` on, by what they are for.

    Each is a bound but that of training: there an episode may end before its time limit.
    """
    shown, scenarios = settings.evaluation, len(evaluator.scenarios)
    steps = evaluator.scenarios[evaluator.followed].max_episode_steps
    rounds = range(env_steps, settings.total_steps, settings.steps_per_round)
    due = [t for start in rounds if evaluation_due(settings, t := start + rounds.step)]
    tests = 0
    if settings.acceptance.enabled:  # no policy has learned before the warm-up ends
        tests = sum(t >= (settings.warmup_steps or 0) for t in due)
    evaluations = len(due) + (env_steps == 0 and settings.evaluation.every > 0)
    # The controller plays each set once; a few episodes of each scenario are played twice, to see
    # whether they are frozen; at the end there may be an accepted policy beside the latest one.
    # A resumed run plays what it hands over once more.
    players = 3 if settings.acceptance.enabled else 2
    sets = evaluations + 1 + acceptance.plays_again
    followed = sets * shown.episodes if evaluations else 0
    return {
        "in training": -(-(settings.total_steps - env_steps) // steps),
        "in evaluations": followed,
        TESTS: 2 * settings.acceptance.episodes * tests,
        "at the end": scenarios * (players * shown.final_episodes + 2 * FEW),
    }


def require_no_shorter(settings: TrainerSettings, env_steps: int) -> None:
    """Refuse to go on with a run that has done more than it is to do in all.

    Raises:
        ValueError: If ``env_steps`` is above ``total_steps``.
    """
    if env_steps > settings.total_steps:
        raise ValueError(
            f"trainer.total_steps: expected at least {env_steps}, which the run has made already, "
            f"got {settings.total_steps}"
        )


def evaluation_due(settings: TrainerSettings, env_steps: int) -> bool:
    """Return whether the followed episodes are played after ``env_steps`` of training.

    At the end they are played too, where what is handed over depends on it.
    """
    ends = settings.acceptance.enabled and env_steps >= settings.total_steps
    every = settings.evaluation.every
    return ends or (every > 0 and env_steps % every == 0)


def checkpoint_due(settings: TrainerSettings, env_steps: int) -> bool:
    """Return whether the run is saved after ``env_steps`` of training."""
    every = settings.checkpoint.every
    return every > 0 and env_steps % every == 0
