"""The variance of visited positions, read back from a log of transitions with known positions."""

import numpy as np
import pytest
import torch
import yaml
from tensordict import TensorDict

from rrl.trainers.experiments.spread import spatial_variance
from rrl.trainers.report.runs import Run
from rrl.trainers.storage.transition_log import TransitionLog


def make_run(path, inputs, positions):
    config = {"trainer": {"seed": 4}, "env": {"inputs": inputs}}
    (path / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    log = TransitionLog(path / "transitions")
    log.append(TensorDict({"end_effector_position": positions}, [len(positions)]))
    log.close()
    return Run(path, "run")


def test_variance_is_of_meters_by_axis(tmp_path):
    positions = np.random.default_rng(0).normal([0.6, 0.0, 0.1], [0.01, 0.02, 0.03], size=(500, 3))
    run = make_run(tmp_path, {"end_effector_position": {}}, torch.tensor(positions))
    np.testing.assert_allclose(spatial_variance(run), 1e4 * positions.var(axis=0), rtol=1e-6)


def test_a_run_without_its_transitions_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"{tmp_path}: expected its transitions"):
        spatial_variance(Run(tmp_path, "run"))
