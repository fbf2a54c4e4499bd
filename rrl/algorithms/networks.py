"""Networks whose leading dimension is the training seed.

Ten runs of a small network cost little more than one when their weights are stacked, ``[S, in, out]``, and
multiplied in one batched product. A single run is ``S = 1``. Nothing couples the stack: every seed has its own
weights, its own batch and its own gradient.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


class StackedLinear(nn.Module):
    """``S`` independent linear layers evaluated in one batched product.

    Args:
        num_seeds: size ``S`` of the stack.
        in_features: size of the last input dimension.
        out_features: size of the last output dimension.
        bound: weights and biases are drawn from ``U(-bound, bound)``; ``1 / sqrt(in_features)`` when left out.
        generators: one generator per seed, so that a seed's weights do not depend on the stack it is in.
    """

    def __init__(
        self,
        num_seeds: int,
        in_features: int,
        out_features: int,
        *,
        bound: float | None = None,
        generators: Sequence[torch.Generator],
    ) -> None:
        super().__init__()
        if len(generators) != num_seeds:
            raise ValueError(
                f"expected {num_seeds} generators, one per seed, got {len(generators)}"
            )
        bound = 1.0 / math.sqrt(in_features) if bound is None else bound

        def draw(*shape: int) -> nn.Parameter:
            rows = [torch.empty(shape).uniform_(-1.0, 1.0, generator=g) for g in generators]
            return nn.Parameter(bound * torch.stack(rows))

        self.weight = draw(in_features, out_features)  # (S, in, out)
        self.bias = draw(1, out_features)  # (S, 1, out)

    def forward(self, x: Tensor) -> Tensor:
        """Map ``[S, B, in]`` to ``[S, B, out]``."""
        return torch.baddbmm(self.bias, x, self.weight)


class StackedLayerNorm(nn.Module):
    """Layer normalisation with one scale and one offset per seed, on ``[S, B, features]``."""

    def __init__(self, num_seeds: int, features: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(num_seeds, 1, features))
        self.bias = nn.Parameter(torch.zeros(num_seeds, 1, features))

    def forward(self, x: Tensor) -> Tensor:
        """Normalise the last dimension."""
        return nn.functional.layer_norm(x, x.shape[-1:]) * self.weight + self.bias


class StackedMLP(nn.Module):
    """``S`` independent multilayer perceptrons with ReLU units.

    Inputs are concatenated along their last dimension. All leading dimensions are folded, seed first, so ``[in]``
    (``S = 1``), ``[S * E, in]`` (``E`` environments per seed) and ``[S, B, in]`` are accepted alike; the
    output has the leading dimensions of the input.

    Args:
        num_seeds: size ``S`` of the stack.
        in_features: summed size of the inputs' last dimensions.
        out_features: size of the output's last dimension.
        hidden: widths of the hidden layers.
        last_layer_bound: the output layer is drawn from ``U(-bound, bound)``; 0 makes the untrained output zero.
        layer_norm: normalise each hidden layer before its ReLU.
        squash: apply ``tanh`` to the output.
        generators: one generator per seed.
    """

    def __init__(
        self,
        num_seeds: int,
        in_features: int,
        out_features: int,
        hidden: Sequence[int],
        *,
        last_layer_bound: float | None = None,
        layer_norm: bool = False,
        squash: bool = False,
        generators: Sequence[torch.Generator],
    ) -> None:
        super().__init__()
        if isinstance(hidden, str) or not all(
            isinstance(width, int) and width > 0 for width in hidden
        ):
            raise ValueError(
                f"hidden: expected a list of widths, whole numbers of at least 1, got {hidden!r}"
            )
        self.num_seeds = num_seeds
        self.squash = squash
        layers: list[nn.Module] = []
        width = in_features
        for size in hidden:
            layers.append(StackedLinear(num_seeds, width, size, generators=generators))
            if layer_norm:
                layers.append(StackedLayerNorm(num_seeds, size))
            layers.append(nn.ReLU())
            width = size
        layers.append(
            StackedLinear(
                num_seeds, width, out_features, bound=last_layer_bound, generators=generators
            )
        )
        self.layers = nn.Sequential(*layers)

    def forward(self, *inputs: Tensor) -> Tensor:
        """Map inputs ``[..., in_i]`` to ``[..., out]``."""
        x = torch.cat(inputs, -1) if len(inputs) > 1 else inputs[0]
        y = self.layers(x.reshape(self.num_seeds, -1, x.shape[-1]))
        if self.squash:
            y = y.tanh()
        return y.reshape(*x.shape[:-1], y.shape[-1])
