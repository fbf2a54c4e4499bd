"""Networks that a configuration can name."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictParams
from torch import Tensor, nn

from rrl.checks import check_sizes

NetworkFactory = Callable[..., nn.Module]
"""Called with ``in_features`` and ``out_features``."""


class Linear(nn.Module):
    """A linear layer with weights ``[in, out]``, so that their gradient comes in the same layout.

    ``torch.nn.Linear`` keeps them transposed: a compiled update of stacked critics then takes a
    tenth longer. Initialized as ``torch.nn.Linear`` is.
    """

    def __init__(self, in_features: int, out_features: int) -> None:
        super().__init__()
        bound = 1 / math.sqrt(in_features)
        self.weight = nn.Parameter(torch.empty(in_features, out_features).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(out_features).uniform_(-bound, bound))

    def forward(self, x: Tensor) -> Tensor:
        """Map ``[*batch, in]`` to ``[*batch, out]``."""
        flat = torch.addmm(self.bias, x.reshape(-1, x.shape[-1]), self.weight)
        return flat.reshape(*x.shape[:-1], self.bias.numel())


class _MLP(nn.Sequential):
    def forward(self, *inputs: Tensor) -> Tensor:
        return super().forward(torch.cat(inputs, -1) if len(inputs) > 1 else inputs[0])


def mlp(
    in_features: int,
    out_features: int,
    *,
    hidden: Sequence[int] = (256, 256),
    layer_norm: bool = False,
) -> nn.Module:
    """Make a multilayer perceptron with ReLU units.

    Args:
        in_features: Size of the last input dimension; several inputs are concatenated.
        out_features: Size of the last output dimension.
        hidden: Widths of the hidden layers.
        layer_norm: Normalize every hidden layer before its ReLU.

    Raises:
        ValueError: If ``hidden`` is no list of whole numbers above 0.
    """
    check_sizes("hidden", hidden)
    layers: list[nn.Module] = []
    width = in_features
    for size in hidden:
        layers += [Linear(width, size), *([nn.LayerNorm(size)] if layer_norm else []), nn.ReLU()]
        width = size
    return _MLP(*layers, Linear(width, out_features))


class ActingNetwork(nn.Module):
    """A network behind its encoder as it acts, on whatever device it lies.

    It shares the network's tensors and is without what is for learning alone, such as dropout.

    Args:
        encoder: From input entries to features.
        network: From features to the output.
    """

    def __init__(self, encoder: nn.Module, network: nn.Module) -> None:
        super().__init__()
        shared = {id(tensor): tensor for tensor in (*network.parameters(), *network.buffers())}
        self.encoder, self.network = encoder, copy.deepcopy(network, shared).eval()

    def forward(self, *values: Tensor) -> Tensor:
        """Return the network's output ``[*batch, out]`` on the device of the values."""
        device = next(self.network.parameters()).device
        features = self.encoder(*(value.to(device) for value in values))
        return self.network(features).to(values[0].device)


def learned(params: TensorDictBase) -> list[Tensor]:
    """Return what is learned of a network's tensors: no buffers, and nothing that is frozen."""
    return [value for value in params.values(True, True) if value.requires_grad]


def once_each(convert: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """Return the same conversion that gives what shares memory the same result.

    A module that is moved to another device makes a new tensor of every buffer. What a network that
    learns and the one that acts have in common, such as a running mean, would fall apart.

    Args:
        convert: From a module's tensor to another one.
    """
    converted: dict[object, tuple[Tensor, Tensor]] = {}

    def once(tensor: Tensor) -> Tensor:
        memory = tensor.data_ptr() or id(tensor), tensor.shape, tensor.stride(), tensor.dtype
        if memory not in converted:
            converted[memory] = tensor, convert(tensor)  # kept, so that nobody gets its memory
        return converted[memory][1]

    return once


class Movable(nn.Module):
    """A module with losses that can be moved to another device, also when it has learned."""

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Any:
        super()._apply(once_each(fn), recurse)
        for module in self.modules():
            if isinstance(module, TensorDictParams) and module.is_locked:
                # Losses read detached tensors, which a lock keeps: they would stay what they were.
                module.unlock_().lock_()
        return self


class FirstOnly(nn.Module):
    """A network that gets more than it reads: the first value.

    Args:
        network: From the first value to the output.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, first: Tensor, *others: Tensor) -> Tensor:
        """Return the network's output."""
        return self.network(first)


@torch.no_grad()
def output_layer(network: nn.Module, *sizes: int) -> str:
    """Return the name of a network's output layer, as in its ``state_dict``.

    It is the last linear layer that makes the output zero by being zero itself. A network may
    register its layers in any order.

    Args:
        network: Is called with values ``[n, size]``, one for each of ``sizes``; left as it is.
        sizes: Of the inputs.

    Raises:
        ValueError: If it has no such layer.
    """
    one: Any = next(network.parameters(), torch.empty(0))
    values = [torch.linspace(-2.0, 2.0, 8 * size).reshape(8, size).to(one) for size in sizes]
    layers = [(n, m) for n, m in network.named_modules() if isinstance(m, (nn.Linear, Linear))]
    learning = [module for module in network.modules() if module.training]
    network.eval()  # or dropout would draw, and running means would move
    with torch.random.fork_rng(devices=[]):
        found = [name for name, layer in layers if not _without(layer, network, values).any()]
    for module in learning:
        module.training = True
    if not found:
        raise ValueError(
            f"network: expected one linear output layer, without which the output is zero, got "
            f"{network}; let a single layer give all of its outputs"
        )
    return found[-1]


def _without(layer: nn.Module, network: nn.Module, values: Sequence[Tensor]) -> Tensor:
    """Return the network's output where a layer is zero."""
    kept = [parameter.clone() for parameter in layer.parameters()]
    for parameter in layer.parameters():
        parameter.zero_()
    out = network(*values)
    for parameter, value in zip(layer.parameters(), kept, strict=True):
        parameter.copy_(value)
    return out
