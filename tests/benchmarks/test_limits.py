"""The limits of ``configs/safety`` hold under the benchmark's worst commands, and the benchmark sees it where they do not."""

import pytest

from benchmarks import limits


@pytest.mark.slow
@pytest.mark.parametrize("case", ["nominal", "delay and stiff"])
@pytest.mark.parametrize("name", [*limits.WATCHED, "all"])
@pytest.mark.parametrize("variant", ["sim", "real"])
def test_no_limit_is_exceeded(variant, name, case):
    found = limits.measure(variant, name, limits.CASES[case], episodes=500)
    assert sum(worst.episodes for worst in found.values()) >= 500
    assert not limits.excesses(variant, name, found)
    if name == "force":  # it was tried
        assert max(worst.values[limits.FORCE] for worst in found.values()) > 20.0


def test_a_limit_that_does_not_hold_is_named():
    found = limits.measure("real", "step", limits.CASES["nominal"], episodes=50)
    assert not limits.excesses("real", "step", found)
    text = "\n".join(limits.excesses("real", "all", found))  # which it was not asked to keep
    assert "real, all, random, held: outside the box [mm]" in text
