"""Every YAML composes, passes the checks and builds what it names."""

import re
from pathlib import Path

import pytest
import yaml
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


SELF_EXPLAINED = {"defaults", "_target_", "hydra"}
"""Hydra's own keys, and what names a class that says of itself what it is."""


def settings_of(name):
    """Yield the keys of a file with a value that is no block: full path, whether it is explained.

    It is by a comment on its line or right above it, and so is what stands in a block by one that
    the block's own line has.
    """
    text = (CONFIGS / f"{name}.yaml").read_text()
    lines = text.splitlines()
    group = name.partition("/")[0] if "/" in name else "_global_"
    package = (re.findall("^# @package (.+)", text) or [group])[0]
    prefix = () if package == "_global_" else tuple(package.split("."))

    def commented(key):
        line = key.start_mark.line
        return "#" in lines[line] or lines[max(line - 1, 0)].lstrip().startswith("#")

    def below(node, path, block):
        for key, value in node.value:
            if key.value in SELF_EXPLAINED:
                continue
            if isinstance(value, yaml.MappingNode) and not value.flow_style:
                yield from below(value, (*path, key.value), commented(key))
            else:
                yield (*path, key.value), block or commented(key)

    return below(yaml.compose(text), prefix, False)


def bases_of(name):
    """Return the files that a file derives from, by Hydra's lists of defaults."""
    found = []
    for entry in yaml.safe_load((CONFIGS / f"{name}.yaml").read_text()).get("defaults", ()):
        if isinstance(entry, dict):
            found += [f"{k.removeprefix('override /')}/{v}" for k, v in entry.items()]
        elif entry != "_self_":
            file, here = entry.partition("@")[0], f"{name.partition('/')[0]}/"
            found.append(file[1:] if file.startswith("/") else here + file)
    found = [base for base in found if (CONFIGS / f"{base}.yaml").is_file()]
    return [*found, *(above for base in found for above in bases_of(base))]


def explained_before(name):
    """Return the keys that are explained in what a file derives from, or is composed with."""
    group = f"{name.partition('/')[0]}/"
    around = [] if name == "train" else ["train", *bases_of("train")]
    files = [*bases_of(name), *(file for file in around if not file.startswith(group))]
    return {path for file in files for path, says in settings_of(file) if says}


NAMES = [str(p.relative_to(CONFIGS).with_suffix("")) for p in sorted(CONFIGS.rglob("*.yaml"))]


@pytest.mark.parametrize("name", [name for name in NAMES if not name.startswith("experiment/")])
def test_every_default_is_explained(name):
    """An experiment sets nothing itself: its overrides name keys that these files explain."""
    known = explained_before(name)
    silent = [".".join(p) for p, says in settings_of(name) if not says and p not in known]
    assert not silent, f"{name}.yaml does not explain {', '.join(silent)}"
