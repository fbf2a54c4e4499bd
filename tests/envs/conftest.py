from __future__ import annotations

import pytest

from rrl.envs.insertion.config import PRESETS


@pytest.fixture(params=PRESETS)
def variant(request: pytest.FixtureRequest) -> str:
    return request.param
