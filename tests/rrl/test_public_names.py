"""``import rrl`` gives every public name, and loads nothing before it is used."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import rrl

PACKAGES = [
    *("rrl.algorithms", "rrl.controllers", "rrl.encoders", "rrl.interventions", "rrl.transforms"),
    "rrl.trainers",
]


@pytest.mark.parametrize("name", rrl.__all__)
def test_every_name_is_that_of_its_package(name: str) -> None:
    homes = [importlib.import_module(package) for package in PACKAGES]
    assert any(getattr(home, name, None) is getattr(rrl, name) for home in homes)


@pytest.mark.parametrize("package", PACKAGES[:4])
def test_every_name_of_a_package_is_there(package: str) -> None:
    assert set(importlib.import_module(package).__all__) <= set(rrl.__all__)


def test_listed_for_the_editor_and_named_when_wrong() -> None:
    assert set(rrl.__all__) <= set(dir(rrl))
    with pytest.raises(AttributeError, match=r"rrl: expected one of .*TD3.*, got 'TD4'"):
        rrl.TD4  # noqa: B018 - looking it up is the test


def test_importing_the_package_is_light() -> None:
    program = "import sys, rrl; sys.exit(bool({'torch', 'tensordict', 'hydra'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_importing_the_trainer_is_quiet() -> None:
    program = "import rrl.envs, warnings; warnings.simplefilter('always'); from rrl import Trainer"
    command = [sys.executable, "-c", program]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stderr
    assert "WeightUpdaterBase" not in said
