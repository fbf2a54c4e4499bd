"""Losses of ensembles on small networks, beside TorchRL's."""

import pytest
import torch
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import nn
from torchrl.modules import NormalParamExtractor, TanhNormal
from torchrl.objectives import SACLoss, SoftUpdate, TD3Loss
from torchrl.objectives.utils import ValueEstimators

from agents import ACTION, OBSERVATION
from rrl.algorithms import EnsembleSACLoss, EnsembleTD3Loss, mlp

TORCHRL = {EnsembleTD3Loss: TD3Loss, EnsembleSACLoss: SACLoss}
AS_TORCHRL = {EnsembleTD3Loss: "first", EnsembleSACLoss: "least"}
each_loss = pytest.mark.parametrize("kind", [EnsembleTD3Loss, EnsembleSACLoss])


def actor(kind, action, observation="observation"):
    if issubclass(kind, TD3Loss):
        network = nn.Sequential(mlp(OBSERVATION, ACTION, hidden=[16]), nn.Tanh())
        return TensorDictModule(network, [observation], [action])
    network = nn.Sequential(mlp(OBSERVATION, 2 * ACTION, hidden=[16]), NormalParamExtractor())
    return ProbabilisticTensorDictSequential(
        TensorDictModule(network, [observation], ["loc", "scale"]),
        ProbabilisticTensorDictModule(
            in_keys=["loc", "scale"],
            out_keys=[action],
            distribution_class=TanhNormal,
            return_log_prob=True,
        ),
    )


def make_loss(
    kind,
    num_critics=2,
    keys=None,
    dropout=0.0,
    estimator=None,
    observation="observation",
    **arguments,
):
    """A loss on small networks, the same ones for every kind with the same actor, with targets of their own."""
    torch.manual_seed(0)
    names = {"action": "action", "state_action_value": "state_action_value"} | (keys or {})
    networks = [
        nn.Sequential(mlp(OBSERVATION + ACTION, 16, hidden=[16]), nn.Dropout(dropout), mlp(16, 1))
        if dropout
        else mlp(OBSERVATION + ACTION, 1, hidden=[16])
        for _ in range(num_critics)
    ]
    inputs = [observation, names["action"]]
    if dropout:
        networks = [Joined(network) for network in networks]
    qs = [TensorDictModule(n, inputs, [names["state_action_value"]]) for n in networks]
    if issubclass(kind, TD3Loss):
        arguments["bounds"] = (-1.0, 1.0)
    else:
        arguments |= {"target_entropy": -float(ACTION), "alpha_init": 0.5}
        if arguments.get("reduction") == "none":
            arguments["scalar_output_mode"] = "exclude"
    if kind in TORCHRL:
        arguments = {"policy_value": AS_TORCHRL[kind]} | arguments
    loss = kind(
        actor(kind, names["action"], observation), qs, num_qvalue_nets=num_critics, **arguments
    )
    if keys:
        loss.set_keys(**keys)
    loss.make_value_estimator(estimator or ValueEstimators.TD0, gamma=0.9)
    SoftUpdate(loss, tau=0.5)  # without one, a loss with targets warns
    targets = [loss.target_qvalue_network_params]
    if issubclass(kind, TD3Loss):
        targets.append(loss.target_actor_network_params)
    for params in targets:
        for value in params.values(True, True):
            value.data.add_(0.1 * torch.randn_like(value))
    return loss


class Joined(nn.Module):
    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, *inputs):
        return self.network(torch.cat(inputs, -1))


def losses_and_gradients(loss, data):
    """What a call gives, and the gradients of each loss for all parameters."""
    torch.manual_seed(5)
    out = loss(data)
    found = {}
    params = dict(loss.named_parameters())
    for name in sorted(key for key in set(out.keys()) if key.startswith("loss_")):
        found[name] = out[name].detach()
        gradients = torch.autograd.grad(
            out[name].sum(), list(params.values()), retain_graph=True, allow_unused=True
        )
        for parameter, gradient in zip(params, gradients, strict=True):
            if gradient is not None:
                found[f"{name} of {parameter}"] = gradient
    return found, out


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    assert len(found) >= 10  # both losses, and gradients of critics and actor
    for name, value in expected.items():
        torch.testing.assert_close(
            found[name], value, rtol=1e-4, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}"
        )
