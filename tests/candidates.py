"""Policies that say what they are told, as candidates for what a run hands over."""

from __future__ import annotations

import numpy as np
import torch

from agents import last_linear
from rrl.trainers import Trainer
from rrl.trainers.evaluation.episodes import Comparison
from rrl.trainers.seeds import Stream
from toy_envs import DRIFT, STEP_SIZE

AGAINST = -DRIFT / STEP_SIZE
"""What solves every episode: it removes the drift."""


def say(trainer: Trainer, x: float) -> None:
    """Have the learner's policy say ``x`` along the drift, whatever it reads."""
    layer = last_linear(trainer.agent.policy)
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias.zero_()
        layer.bias[0] = float(np.arctanh(x))
    trainer.agent.num_updates = 1


def follow(trainer: Trainer) -> Comparison:
    """Evaluate the learner's policy on the followed episodes."""
    episodes = trainer.settings.evaluation.episodes
    return trainer.evaluator.compare(trainer.agent.policy, "drift", Stream.FOLLOWING, episodes)


def consider(trainer: Trainer, env_steps: int) -> tuple[Comparison, dict[str, float]]:
    """Evaluate the learner's policy on the followed episodes, and let it be tested."""
    return trainer.acceptance.consider(follow(trainer), env_steps)
