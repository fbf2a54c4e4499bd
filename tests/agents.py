"""Small agents and data for them, for the tests of the algorithms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from rrl.algorithms import TD3, Agent

BATCH, OBSERVATION, ACTION = 16, 5, 2


def make_agent(algorithm: Any = TD3, num_seeds: int = 1, **arguments: Any) -> Any:
    return algorithm(
        {"observation": OBSERVATION}, ACTION, num_seeds=num_seeds, hidden=[32, 32], **arguments
    )


def batches(k: int, num_seeds: int, seed: int = 0) -> TensorDict:
    """Random transitions ``[k, S, B]``, one in ten of them terminal."""
    g = torch.Generator().manual_seed(seed)
    shape = k, num_seeds, BATCH

    def normal(size: int) -> Tensor:
        return torch.randn(*shape, size, generator=g)

    terminated = torch.rand(*shape, 1, generator=g) < 0.1
    following = {
        "observation": normal(OBSERVATION),
        "reward": normal(1),
        "done": terminated.clone(),
    }
    root = {"observation": normal(OBSERVATION), "action": normal(ACTION).tanh()}
    return TensorDict({**root, "next": {**following, "terminated": terminated}}, shape)


def parameters(agent: Agent) -> dict[str, Tensor]:
    return {k: v for k, v in agent.state_dict().items() if isinstance(v, Tensor)}


def critics(agent: Agent, params: str) -> Iterator[Any]:
    """The critics as functions of observation and action to values [S, B], with the parameters of that name."""
    for stacked in getattr(agent.loss, params).unbind(0):

        def q(observation: Tensor, action: Tensor, stacked: Any = stacked) -> Tensor:
            td = TensorDict({"observation": observation, "action": action}, observation.shape[:-1])
            with stacked.data.to_module(agent.loss.qvalue_network):
                return agent.loss.qvalue_network(td)["state_action_value"].squeeze(-1)

        yield q
