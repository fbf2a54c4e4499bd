"""Two groups of runs."""

import pytest

from logged_runs import make_group


@pytest.fixture
def runs(tmp_path):
    folders = {arm: tmp_path / "outputs" / arm / "now" for arm in ("residual", "rl")}
    return [run for arm, folder in folders.items() for run in make_group(folder, arm=arm)]
