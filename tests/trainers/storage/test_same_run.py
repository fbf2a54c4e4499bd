"""Only the same run is resumed, and what may change in it."""

import json

import pytest

from rrl.trainers.settings import CheckpointSettings
from rrl.trainers.storage.same_run import differences, require_same_run
from runs import assert_same


def test_a_changed_run_is_refused_with_the_difference(stopped, make):
    trainer = make(batch_size=16, seed=2)
    with pytest.raises(ValueError, match=r"(?s)trainer.batch_size: 32 -> 16.*trainer.seed: 0 -> 2"):
        trainer.resume()
    trainer.close()


def test_more_steps_other_loggers_other_cadence_are_the_same_run(stopped, make):
    trainer = make(
        total_steps=240,
        loggers=[],
        checkpoint=CheckpointSettings(every=40, keep=3),
        evaluation={"every": 0, "episodes": 1, "final_episodes": 2, "slots": 1},
    )
    trainer.resume()
    trainer.run()
    trainer.close()
    whole = make("whole", total_steps=240)
    whole.run()
    whole.close()
    assert_same(dict(whole.agent.state_dict()), dict(trainer.agent.state_dict()))


BASE = {
    "name": "a",
    "trainer": {"total_steps": 100, "num_seeds": 1, "threads": 1},
    "algorithm": {"agent": {"tau": 0.1, "actor_lr": 0.1}},
    "env": {"base": {"variant": "sim"}, "scenarios": {"one": {}}},
    "logger": {"csv": {"_target_": "x"}},
}


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        ("algorithm.agent.tau", 0.2, "algorithm.agent.tau: 0.1 -> 0.2"),
        ("env.base.variant", "real", 'env.base.variant: "sim" -> "real"'),
        ("env.base.clearance", 0.1, "env.base.clearance: (absent) -> 0.1"),
        ("trainer.num_seeds", 2, "trainer.num_seeds: 1 -> 2"),
        ("trainer.total_steps", 200, None),
        ("trainer.threads", 2, None),
        ("name", "b", None),
        ("logger", {}, None),
        ("env.scenarios.two", {"yaw_range": 1.0}, None),
        ("algorithm.agent.actor_lr", 0.01, None),
    ],
)
def test_what_may_change(path, value, line):
    changed = json.loads(json.dumps(BASE))
    *parents, last = path.split(".")
    node = changed
    for parent in parents:
        node = node[parent]
    node[last] = value
    assert len(differences(BASE, changed)) >= 1
    if line is None:
        require_same_run(BASE, changed)
    else:
        with pytest.raises(ValueError) as caught:
            require_same_run(BASE, changed)
        assert f"  {line}\n" in str(caught.value)
