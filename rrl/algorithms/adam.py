"""Adam whose step can be traced into one compiled graph with the loss and its gradient."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.adam import adam

from rrl.algorithms.compilation import being_traced


class Adam(nn.Module):
    """Adam on a fixed list of parameters, fed with gradients instead of reading ``.grad``.

    ``torch.optim.Adam.step`` breaks a compiled graph, and ``.grad`` belongs to ``backward``. This module keeps
    the moments as buffers, so that they are part of a ``state_dict``, and calls PyTorch's fused kernel; in an
    update that is traced it writes the same rule out. The rule works element by
    element, so that stacked seeds stay independent.

    Args:
        params: the parameters, updated in place.
        lr: learning rate.
        betas: decay rates of the two moments.
        eps: added to the root of the second moment.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__()
        if not lr > 0:
            raise ValueError(f"expected a learning rate above 0, got {lr}")
        self.params = list(params)  # a plain list: the loss module owns the parameters
        self.lr, self.betas, self.eps = lr, betas, eps
        for i, p in enumerate(self.params):
            self.register_buffer(f"exp_avg_{i}", torch.zeros_like(p.data))
            self.register_buffer(f"exp_avg_sq_{i}", torch.zeros_like(p.data))
            self.register_buffer(f"step_{i}", torch.zeros((), device=p.device))

    def _buffers_named(self, name: str) -> list[Tensor]:
        return [self._buffers[f"{name}_{i}"] for i in range(len(self.params))]  # type: ignore[misc]

    @torch.no_grad()
    def step(self, grads: Sequence[Tensor]) -> None:
        """Apply one update with ``grads``, one tensor per parameter in the order of construction."""
        parameters = [p.data for p in self.params]
        means, squares = self._buffers_named("exp_avg"), self._buffers_named("exp_avg_sq")
        if being_traced():
            self._traced_step(parameters, grads, means, squares)
            return
        adam(
            parameters,
            list(grads),
            means,
            squares,
            [],
            self._buffers_named("step"),
            fused=True,
            amsgrad=False,
            beta1=self.betas[0],
            beta2=self.betas[1],
            lr=self.lr,
            weight_decay=0.0,
            eps=self.eps,
            maximize=False,
        )

    def _traced_step(
        self, parameters: list[Tensor], grads: Any, means: list[Tensor], squares: list[Tensor]
    ) -> None:
        """The same rule with the bias corrections taken out of the loops over elements, which halves its time."""
        beta1, beta2 = self.betas
        steps = self._buffers_named("step")
        torch._foreach_add_(steps, 1.0)
        root = (1 - beta2 ** steps[0]).sqrt()
        # one tensor of both: a compiler stores it, where it would compute each anew in every loop that reads it
        rate, eps = torch.stack(
            [self.lr * root / (1 - beta1 ** steps[0]), self.eps * root]
        ).unbind()
        for p, g, mean, square in zip(parameters, grads, means, squares, strict=True):
            mean.lerp_(g, 1 - beta1)
            square.mul_(beta2).addcmul_(g, g, value=1 - beta2)
            p.sub_(rate * mean / (square.sqrt() + eps))
