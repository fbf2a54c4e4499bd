"""Numbers: normalized, one after the other."""

from __future__ import annotations

import torch
from tensordict import NestedKey
from torch import Tensor, nn

from rrl.encoders.interface import Inputs

LEAST_SPREAD = 0.05
"""A number that hardly moves counts as if it moved by this share of its entry's mean spread."""
FEATURE_LIMIT = 10.0
"""Standard deviations at which a standardized number is clipped."""


class Concatenate(nn.Module):
    """The encoder of numbers: flatten, normalize and concatenate all inputs.

    Entries without center and scale are left as they are until :meth:`calibrate`.

    Args:
        inputs: Observation entries with shape, center and scale.

    Raises:
        ValueError: If a center or scale does not fit its entry; the message names the entry.
    """

    loc: Tensor
    scale: Tensor
    limit: Tensor

    def __init__(self, inputs: Inputs) -> None:
        super().__init__()
        columns: dict[str, list[Tensor]] = {"loc": [], "scale": []}
        for key, entry in inputs.items():
            for field, parts in columns.items():
                try:
                    parts.append(entry.column(field))
                except (ValueError, TypeError) as error:
                    raise ValueError(f"inputs.{key}.{error}") from error
        self._inputs = dict(inputs)
        for field, parts in columns.items():
            self.register_buffer(field, torch.cat(parts))
        self.register_buffer("limit", torch.full_like(self.loc, torch.inf))
        self.out_features = self.loc.numel()

    def calibrate(self, *values: Tensor) -> dict[NestedKey, dict[str, list[float]]]:
        """Standardize the entries that have neither center nor scale.

        Args:
            values: Of every entry ``[n, *shape]``.

        Returns:
            Center and scale of the entries that were standardized.
        """
        found: dict[NestedKey, dict[str, list[float]]] = {}
        first = 0
        for (key, entry), value in zip(self._inputs.items(), values, strict=True):
            part = slice(first, first + entry.size)
            first += entry.size
            if entry.is_derived:
                flat = value.reshape(len(value), -1)
                loc, scale = standardization(flat)
                self.loc[part], self.scale[part] = loc.to(self.loc), scale.to(self.scale)
                # An entry that stood still does not tell its unit: it keeps its own, unclipped.
                self.limit[part] = FEATURE_LIMIT if (flat != flat[:1]).any() else torch.inf
                found[key] = {"loc": loc.tolist(), "scale": scale.tolist()}
        return found

    def forward(self, *values: Tensor) -> Tensor:
        """Return features ``[*batch, n]`` of entries ``[*batch, *shape]``."""
        flat = [
            value.reshape(*value.shape[: value.ndim - len(entry.shape)], entry.size).to(self.loc)
            for value, entry in zip(values, self._inputs.values(), strict=True)
        ]
        joined = torch.cat(flat, -1) if len(flat) > 1 else flat[0]
        return ((joined - self.loc) * self.scale).clamp(-self.limit, self.limit)


def standardization(values: Tensor) -> tuple[Tensor, Tensor]:
    """Return center and scale ``[size]`` that standardize an entry's numbers.

    Args:
        values: The entry's numbers ``[n, size]``.
    """
    values = values.double()
    spread = values.std(0, correction=0)
    floor = LEAST_SPREAD * spread.square().mean().sqrt()
    scale = 1.0 / torch.where(spread > floor, spread, floor)
    return values.mean(0).float(), torch.where(floor > 0, scale, 1.0).float()
