"""The controller that does nothing."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from rrl.controllers import ZeroController


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_zeros_of_the_batch(batch: tuple[int, ...]) -> None:
    action = ZeroController(3)(TensorDict({}, batch_size=batch))["base_action"]
    assert torch.equal(action, torch.zeros(*batch, 3))


def test_bad_size() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        ZeroController(0)
