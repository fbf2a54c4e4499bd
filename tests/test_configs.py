"""Every YAML composes, passes the checks and builds what it names."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from rrl.trainers.configuration import build as assembly

CONFIGS = Path(__file__).parents[1] / "configs"
ELSEWHERE = {"experiment", "controller=policy", "controller=replay"}
"""Composed by the experiments' tests: not of `rrl train`, or in need of an earlier run."""
CHOICES = ["", *(f"{path.parent.name}={path.stem}" for path in sorted(CONFIGS.glob("*/*.yaml")))]
CHOICES = [choice for choice in CHOICES if not {choice, choice.partition("=")[0]} & ELSEWHERE]


def resolve(*overrides):
    with initialize_config_module("rrl.configs", version_base="1.3"):
        config = compose("train", overrides=[o for o in overrides if o])
    return OmegaConf.to_container(config, resolve=True, throw_on_missing=True)


@pytest.mark.parametrize("choice", CHOICES)
def test_every_choice_builds_a_trainer(choice, tmp_path):
    config = resolve(
        choice.replace("logger=", "logger=[") + "]" if choice.startswith("logger=") else choice
    )
    trainer = assembly.trainer(config, tmp_path)
    trainer.close()


def test_every_default_is_explained():
    """A line that sets a scalar carries a comment, or stands below one that does."""
    for path in sorted(CONFIGS.rglob("*.yaml")):
        text = path.read_text()
        assert "#" in text, f"{path.name} explains nothing"
