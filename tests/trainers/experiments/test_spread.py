"""The variance of visited positions, read back from a log of transitions with known positions."""

import numpy as np
import pytest
import torch
import yaml
from tensordict import TensorDict

from rrl.trainers.experiments.spread import spatial_variance
from rrl.trainers.report.runs import Run
from rrl.trainers.storage.transition_log import TransitionLog

LOC, SCALE = [0.6, 0.0, 0.1], [40.0, 20.0, 10.0]


def make_run(path, inputs, observation):
    config = {
        "trainer": {"seed": 4, "num_seeds": 2},
        "env": {"base": {"_target_": "rrl.envs.InsertionEnv", "variant": "sim"}, "inputs": inputs},
    }
    (path / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    log = TransitionLog(path / "transitions")
    log.append(TensorDict({"observation": observation}, [len(observation)]))
    log.close()
    return Run(path, "run")


def test_variance_is_of_metres_by_seed_and_axis(tmp_path):
    rng = np.random.default_rng(0)
    positions = rng.normal(LOC, [0.01, 0.02, 0.03], size=(500, 2, 3))
    positions[:, 1] += 5 * (positions[:, 1] - LOC)  # the second seed roams six times as far
    goal = np.ones((500, 2, 3))
    observation = np.concatenate([goal, (positions - LOC) * SCALE], -1).reshape(1000, 6)
    inputs = {"goal": {"scale": 10.0}, "end_effector_position": {"loc": LOC, "scale": SCALE}}
    run = make_run(tmp_path, inputs, torch.tensor(observation, dtype=torch.float32))
    found = spatial_variance(run)
    assert list(found) == [4, 5]
    np.testing.assert_allclose(found[4], 1e4 * positions[:, 0].var(axis=0), rtol=1e-3)
    np.testing.assert_allclose(found[5], 1e4 * positions[:, 1].var(axis=0), rtol=1e-3)
    assert found[5].sum() == pytest.approx(36 * found[4].sum(), rel=0.2)


def test_a_policy_that_does_not_see_the_position_is_named(tmp_path):
    run = make_run(tmp_path, {"goal": {}}, torch.zeros(2, 3))
    with pytest.raises(
        ValueError, match=r"expected 'end_effector_position' among the inputs \['goal'\]"
    ):
        spatial_variance(run)
