"""What a run's key is made of: settings of what is switched off do not make it old."""

import pytest

from rrl.trainers.cli.compose import compose
from rrl.trainers.storage.same_run import measured_settings

SWITCHES = {
    "trainer.constraints.rate": (0.5, "env.metrics.contact_force.budget=25"),
    "trainer.constraints.initial": (2.0, "env.metrics.tilt.budget=0.1"),
    "trainer.realtime.budget": (0.1, "trainer.collection=realtime"),
}


def measured(*overrides):
    return measured_settings(compose(["env=insertion-real", *overrides]))


@pytest.mark.parametrize("key", SWITCHES)
def test_settings_of_what_is_off_do_not_count(key):
    value, switch = SWITCHES[key]
    assert measured(f"{key}={value}") == measured()
    assert measured(f"{key}={value}", switch) != measured(switch)


@pytest.mark.parametrize("override", ["trainer.n_step=2", "env.metrics.tilt.budget=0.1"])
def test_what_is_learned_counts(override):
    assert measured(override) != measured()


def test_a_setting_that_is_off_is_one_that_was_not_there():
    without = measured("~algorithm.agent.value_bounds")
    assert measured() == without
    assert measured("algorithm.agent.value_bounds=true") != without
