"""Optimizers that take gradients and can be part of a compiled update."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.adam import adam

from rrl.algorithms.compilation import being_traced

OptimizerFactory = Callable[..., nn.Module]
"""Called with the parameters and ``lr``; gives a module whose state is saved, and whose ``step``
takes one gradient per parameter, in their order, and applies one update."""


class Adam(nn.Module):
    """Adam (Kingma and Ba, 2015) on a fixed list of parameters.

    ``torch.optim.Adam.step`` breaks a compiled graph, and ``.grad`` belongs to ``backward``. This
    module keeps the moments as buffers and calls PyTorch's fused kernel; in an update that is
    traced it writes the same rule out.

    Args:
        params: The parameters, updated in place.
        lr: Learning rate.
        betas: Decay rates of the two moments.
        eps: Added to the root of the second moment.

    Raises:
        ValueError: If the learning rate is not above 0.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        lr: float,
        betas: Sequence[float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__()
        if not lr > 0:
            raise ValueError(f"lr: expected a learning rate above 0, got {lr}")
        self.params = list(params)  # a plain list: the loss module owns the parameters
        self.lr, self.betas, self.eps = lr, tuple(betas), eps
        for i, p in enumerate(self.params):
            self.register_buffer(f"exp_avg_{i}", torch.zeros_like(p.data))
            self.register_buffer(f"exp_avg_sq_{i}", torch.zeros_like(p.data))
            self.register_buffer(f"step_{i}", torch.zeros((), device=p.device))

    def _named(self, name: str) -> list[Tensor]:
        return [self.get_buffer(f"{name}_{i}") for i in range(len(self.params))]

    @torch.no_grad()
    def step(self, grads: Sequence[Tensor]) -> None:
        """Apply one update."""
        parameters = [p.data for p in self.params]
        means, squares, steps = map(self._named, ("exp_avg", "exp_avg_sq", "step"))
        beta1, beta2 = self.betas
        if not being_traced():
            # The fused kernel takes every gradient to be laid out in memory as its parameter is.
            laid_out = [
                torch.empty_like(p).copy_(g) for p, g in zip(parameters, grads, strict=True)
            ]
            adam(
                parameters,
                laid_out,
                means,
                squares,
                [],
                steps,
                fused=True,
                amsgrad=False,
                beta1=beta1,
                beta2=beta2,
                lr=self.lr,
                weight_decay=0.0,
                eps=self.eps,
                maximize=False,
            )
            return
        for step in steps:
            step.add_(1.0)
        root = (1 - beta2 ** steps[0]).sqrt()
        # One tensor of both: the compiler would compute each anew in every loop that reads it.
        both = torch.stack([self.lr * root / (1 - beta1 ** steps[0]), self.eps * root])
        rate, eps = both.unbind()
        for p, g, mean, square in zip(parameters, grads, means, squares, strict=True):
            mean.lerp_(g, 1 - beta1)
            square.mul_(beta2).addcmul_(g, g, value=1 - beta2)
            p.sub_(rate * mean / (square.sqrt() + eps))


class TorchOptimizer(nn.Module):
    """Any optimizer of ``torch.optim``, for updates that are not compiled.

    Args:
        params: The parameters, updated in place.
        lr: Learning rate.
        name: Class in ``torch.optim``, such as ``AdamW``.
        arguments: Further arguments of that class.

    Raises:
        ValueError: If ``torch.optim`` has no such optimizer.
    """

    def __init__(self, params: Iterable[Tensor], lr: float, name: str, **arguments: Any) -> None:
        super().__init__()
        make: Any = getattr(torch.optim, name, None)
        base = torch.optim.Optimizer
        is_one = isinstance(make, type) and issubclass(make, base) and make is not base
        if not is_one:
            raise ValueError(f"name: expected an optimizer of torch.optim, got {name!r}")
        self.params = list(params)
        self._optimizer = make(self.params, lr=lr, **arguments)

    def step(self, grads: Sequence[Tensor]) -> None:
        """Apply one update.

        Raises:
            RuntimeError: If the update is compiled.
        """
        if being_traced():
            raise RuntimeError(
                "optimizer: torch.optim cannot be compiled; use rrl.algorithms.Adam, or "
                "compiled=false"
            )
        for parameter, grad in zip(self.params, grads, strict=True):
            parameter.grad = grad
        self._optimizer.step()
        self._optimizer.zero_grad()

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Any:
        super()._apply(fn, recurse)
        # The moments are no buffers: loading puts them where their parameters are by now.
        self._optimizer.load_state_dict(self._optimizer.state_dict())
        return self

    def get_extra_state(self) -> dict[str, Any]:
        """Return the optimizer's state."""
        return self._optimizer.state_dict()

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the optimizer's state; its learning rate and arguments stay as they are."""
        groups = self._optimizer.state_dict()["param_groups"]
        self._optimizer.load_state_dict({**state, "param_groups": groups})
