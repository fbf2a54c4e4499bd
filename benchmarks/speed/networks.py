"""The networks of the hand-written contenders."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import nn


class Networks:
    """An actor whose untrained action is zero, and two critics, of the configuration's sizes."""

    def __init__(self, agent: dict[str, Any], inputs: int) -> None:
        def mlp(size: int, out: int, *last: nn.Module) -> nn.Sequential:
            sizes = [size, *agent["network"]["hidden"]]
            hidden = [m for a, b in pairwise(sizes) for m in (nn.Linear(a, b), nn.ReLU())]
            return nn.Sequential(*hidden, nn.Linear(sizes[-1], out), *last)

        self.actor = mlp(inputs, 3, nn.Tanh())
        self.critics = [mlp(inputs + 3, 1) for _ in range(2)]
        nn.init.zeros_(self.actor[-2].weight)
        nn.init.zeros_(self.actor[-2].bias)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The action without exploration."""
        with torch.no_grad():
            return np.asarray(self.actor(torch.from_numpy(observation)).numpy())
