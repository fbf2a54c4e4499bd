"""Small agents and data for them, for the tests of the algorithms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from rrl.algorithms import TD3, Agent, mlp
from rrl.algorithms.networks import Linear
from rrl.trainers.environment import EnvironmentFactory

BATCH, OBSERVATION, ACTION = 16, 5, 2
SMALL = partial(TD3, network=partial(mlp, hidden=[16, 16]))


def make_agent(
    algorithm: Any = TD3,
    *,
    seed: int = 0,
    hidden: Sequence[int] = (32, 32),
    layer_norm: bool = False,
    **arguments: Any,
) -> Any:
    """An agent with the initial weights of that seed."""
    torch.manual_seed(seed)
    network = partial(mlp, hidden=hidden, layer_norm=layer_norm)
    return algorithm({"observation": OBSERVATION}, ACTION, **{"network": network, **arguments})


class Joining(nn.Sequential):
    """Layers one after the other, the first of which gets all inputs side by side."""

    def forward(self, *inputs: Tensor) -> Tensor:
        return super().forward(torch.cat(inputs, -1))


def last_linear(policy: nn.Module) -> Any:
    """The output layer of a policy whose network registers its layers in order."""
    return [m for m in policy.modules() if isinstance(m, (nn.Linear, Linear))][-1]


def batches(k: int, seed: int = 0) -> TensorDict:
    """Random transitions ``[k, B]``, one in ten of them terminal."""
    g = torch.Generator().manual_seed(seed)
    shape = k, BATCH

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


def learn(agent: Agent, k: int, seed: int = 0) -> dict[str, Tensor]:
    """Take ``k`` updates whose data and random numbers are those of that seed."""
    torch.manual_seed(seed)
    return agent.update(batches(k, seed))


def parameters(agent: Agent) -> dict[str, Tensor]:
    return {k: v for k, v in agent.state_dict().items() if isinstance(v, Tensor)}


def critics(loss: Any, params: str) -> Iterator[Any]:
    """The critics as functions of observation and action to values [B], with the parameters of that name."""
    for one in getattr(loss, params).unbind(0):

        def q(observation: Tensor, action: Tensor, one: Any = one) -> Tensor:
            first = loss.qvalue_network.in_keys[0]
            td = TensorDict({first: observation, "action": action}, observation.shape[:-1])
            with one.data.to_module(loss.qvalue_network):
                return loss.qvalue_network(td)["state_action_value"].squeeze(-1)

        yield q


def random_policy(factory: EnvironmentFactory, make_agent: Any = SMALL, seed: int = 0) -> Any:
    """A policy with weights that nobody has trained, but not the zeros of an untrained residual."""
    env = factory.make(1)
    torch.manual_seed(seed)
    agent = make_agent(
        inputs=factory.read_inputs(env), action_size=env.full_action_spec["action"].shape[-1]
    )
    env.close()
    with torch.no_grad():
        for parameter in agent.policy.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return agent.policy
