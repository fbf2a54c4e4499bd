"""From what one agent has learned to another agent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from rrl.algorithms.base import Agent


@torch.no_grad()
def take_over(agent: Agent, other: Agent) -> None:
    """Copy networks, targets and temperature, and what ``other`` has derived; the rest stays.

    Raises:
        ValueError: If ``other`` is of another algorithm or has networks of other sizes.
    """
    given, own = _learned(other), _learned(agent)
    for name in sorted(given.keys() | own.keys()):
        shapes = [tuple(d[name].shape) if name in d else None for d in (own, given)]
        if shapes[0] != shapes[1]:
            raise ValueError(
                f"initial weights: expected {type(agent).__name__} with {name} of {shapes[0]}, "
                f"got {type(other).__name__} with {shapes[1]}"
            )
    for name, value in own.items():
        value.copy_(given[name])
    if other.is_calibrated:  # a policy means what it learned only behind its own encoder
        for ours, theirs in zip(agent.encoders, other.encoders, strict=True):
            ours.load_state_dict(theirs.state_dict())
        agent.rewards.copy(other.rewards)
        agent.is_calibrated = True


def ingredients(agent: Agent) -> tuple[Any, ...]:
    """Return what :func:`remade` makes an equal agent of."""
    lengths = {"gamma": agent.gamma, "penalty_updates": agent.penalty_updates}
    beside = {"critic_inputs": agent.critic_inputs, "symmetry": agent.symmetry}
    arguments = {**dict(agent.settings), **lengths, **beside}
    return type(agent), agent.inputs, agent.action_size, arguments, agent.state_dict()


def remade(
    kind: type[Agent], inputs: Any, action_size: int, arguments: dict[str, Any], state: Any
) -> Agent:
    """Return an agent of these arguments and state, on the state's device.

    To copy or pickle one part after the other would not do: TorchRL's losses copy their parameters
    apart from the policy and the optimizers, which have to hold the same ones.
    """
    with torch.random.fork_rng(devices=[]):
        agent = kind(inputs, action_size, **arguments)
    agent.to(state["residual_weight"].device).load_state_dict(state)
    return agent


def _learned(agent: Agent) -> dict[str, Tensor]:
    """Return what an agent has learned: not its discount, nor what it is told to aim at."""
    state = agent.loss.state_dict()
    learned = {k: v for k, v in state.items() if "_params." in k or k == "log_alpha"}
    for i, encoder in enumerate(agent.encoders):
        learned |= {f"encoder {i} {k}": v for k, v in encoder.named_parameters()}
    return learned
