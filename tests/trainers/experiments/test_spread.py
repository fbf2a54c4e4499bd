"""The variance of visited positions, read back from a log of transitions with known positions."""

import numpy as np
import pytest
import torch
import yaml
from tensordict import TensorDict

from experiment_project import SPREAD
from rrl.trainers.experiments.spec import Spread
from rrl.trainers.experiments.spread import spatial_variance
from rrl.trainers.report.runs import Run
from rrl.trainers.storage.transition_log import TransitionLog

POSITIONS = Spread(**SPREAD)


def make_run(path, inputs, positions):
    config = {"trainer": {"seed": 4}, "env": {"inputs": inputs}}
    (path / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    log = TransitionLog(path / "transitions")
    log.append(TensorDict({"end_effector_position": positions}, [len(positions)]))
    log.close()
    return Run(path, "run")


def test_variance_is_of_an_entry_by_axis_in_the_unit_asked_for(tmp_path):
    positions = np.random.default_rng(0).normal([0.6, 0.0, 0.1], [0.01, 0.02, 0.03], size=(500, 3))
    run = make_run(tmp_path, {"end_effector_position": {}}, torch.tensor(positions))
    in_cm, in_m = (spatial_variance(run, Spread(**SPREAD | {"factor": f})) for f in (100.0, 1.0))
    np.testing.assert_allclose(in_cm, 1e4 * positions.var(axis=0), rtol=1e-6)
    np.testing.assert_allclose(in_m, positions.var(axis=0), rtol=1e-6)


def test_axes_that_an_entry_does_not_have_are_named(tmp_path):
    (tmp_path / "positions.json").write_text("[1.0, 2.0]")
    with pytest.raises(ValueError, match=r"expected the axes x, y, z of 'end_effector_position'"):
        spatial_variance(Run(tmp_path, "run"), POSITIONS)


def test_a_run_without_its_transitions_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"{tmp_path}: expected its transitions"):
        spatial_variance(Run(tmp_path, "run"), POSITIONS)
