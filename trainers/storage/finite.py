"""No number that is not finite is stored or saved."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor


def require_finite(tensors: Mapping[str, Tensor], what: str) -> None:
    """Stop a run before a number that is not finite is stored or saved.

    Raises:
        FloatingPointError: Naming the entries, and that everything before is safe on disk.
    """
    broken = [
        name
        for name, value in tensors.items()
        if value.is_floating_point() and not value.isfinite().all()
    ]
    if broken:
        more = f" and {len(broken) - 3} more" if len(broken) > 3 else ""
        raise FloatingPointError(
            f"{what} numbers that are not finite in {', '.join(map(str, broken[:3]))}{more}; "
            "everything before is on disk: the newest checkpoint and all transitions"
        )
