"""The policy that a run hands over to whoever uses it."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from rrl.algorithms import Agent
from rrl.controllers import ZeroController
from rrl.keys import ACTION

from ..evaluation.episodes import Comparison
from ..evaluation.evaluator import Evaluator
from ..seeds import Stream


class _NoResidual(ZeroController):
    """Says 0 below any controller: the bounds of an environment's action are not a residual's."""

    def fit(self, middle: Tensor) -> None:
        """Stay at 0."""


class RunPolicy:
    """What a run hands over: the controller alone, until it takes a policy of the learner.

    A checkpoint has it under ``handed_over``, with all of the learner as it was then.

    Args:
        agent: The learner.
        tested: Whether policies have to be taken; without that the latest one is handed over.

    Attributes:
        env_steps: Environment steps that the policy had learned from; 0 stands for the controller.
    """

    def __init__(self, agent: Agent, tested: bool) -> None:
        self.tested, self.env_steps = tested, 0
        self._agent = agent
        self._learner: dict[str, Any] | None = None
        self._policy: TensorDictModuleBase = _NoResidual(agent.action_size, ACTION)

    @property
    def policy(self) -> TensorDictModuleBase:
        """From the inputs to ``action``: zeros, where it is the controller's alone."""
        return self._policy if self.tested else self._agent.policy

    def take(self, env_steps: int) -> None:
        """Hand over the learner's policy as it is now."""
        self.env_steps = env_steps
        self._learner = copy.deepcopy(self._agent.state_dict())
        self._policy = copy.deepcopy(self._agent.policy).requires_grad_(False)

    def restore_learner(self) -> bool:
        """Put the learner back to where the policy comes from; False: it is not the learner's."""
        if not self.tested:
            return True
        if self._learner is not None:
            self._agent.load_state_dict(copy.deepcopy(self._learner))
        return self._learner is not None

    def compare(
        self, evaluator: Evaluator, env_steps: int, scenario: str, stream: Stream, episodes: int
    ) -> Comparison:
        """Compare the learner's latest policy, and what the run hands over, with the controller.

        Args:
            evaluator: Plays the episodes.
            env_steps: Environment steps that the latest policy has learned from.
            scenario: Name of the scenario.
            stream: Whose first episodes are played.
            episodes: How many.
        """
        latest = evaluator.compare(self._agent.policy, scenario, stream, episodes)
        if not self.tested:
            return latest
        if self.env_steps == 0:
            accepted = latest.controller
        elif self.env_steps == env_steps:
            accepted = latest.residual
        else:
            accepted = evaluator.play(self.policy, scenario, stream, episodes)
        return replace(latest, accepted=accepted, accepted_env_steps=self.env_steps)

    def state_dict(self) -> dict[str, Any]:
        """Return the steps and the learner as it was then."""
        return {"env_steps": self.env_steps, "learner": self._learner}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`; the learner stays as it is."""
        self.env_steps, self._learner = state["env_steps"], state["learner"]
        if self._learner is not None:
            now = copy.deepcopy(self._agent.state_dict())
            self.restore_learner()
            self._policy = copy.deepcopy(self._agent.policy).requires_grad_(False)
            self._agent.load_state_dict(now)
