"""With ``safety=all`` no limit is exceeded, whatever is asked for, and what the limits did is counted and logged.

What counts is what reaches the physics and what the physics then does, in every environment of
training and evaluation.
"""

import csv
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from torchrl.envs.utils import step_mdp

from rrl.controllers import FunctionController
from rrl.envs import InsertionEnv
from rrl.trainers.configuration import build as assembly

VARIANTS = {"real": [], "sim": ["env=insertion-sim"]}
CORNERS = [[x, y, z] for x in (-1.0, 0.0, 1.0) for y in (0.0, 1.0) for z in (-1.0, 0.0, 1.0)]


def resolve(*overrides):
    with initialize_config_module("rrl.configs", version_base="1.3"):
        config = compose(
            "train", overrides=["safety=all", "residual_scale=2.0", "logger=csv", *overrides]
        )
    return OmegaConf.to_container(config, resolve=True)


class Watch:
    """Sees every step of every insertion environment."""

    def __init__(self, monkeypatch, safety):
        self.safety, self.steps = safety, 0
        self.worst = dict.fromkeys(("outside", "force", "size", "change"), -math.inf)
        self._last = {}
        reset, step = InsertionEnv._reset, InsertionEnv._step

        def watched_reset(env, *args, **kwargs):
            out = reset(env, *args, **kwargs)
            self._last[id(env)] = None
            return out

        def watched_step(env, tensordict):
            out = step(env, tensordict)
            self._see(env, tensordict["action"].clone(), out)
            return out

        monkeypatch.setattr(InsertionEnv, "_reset", watched_reset)
        monkeypatch.setattr(InsertionEnv, "_step", watched_step)

    def _see(self, env, action, out):
        low, high = (torch.tensor(self.safety["workspace"][name]) for name in ("low", "high"))
        position, last = out["end_effector_position"], self._last[id(env)]
        change = action - (torch.zeros_like(action) if last is None else last)
        now = {
            "outside": torch.maximum(low - position, position - high).max(),
            "force": out["metrics", "contact_force"].max() - self.safety["force"]["limit"],
            "size": action.abs().max() - self.safety["step"]["size"],
            "change": change.abs().max() - self.safety["step"]["change"],
        }
        self.worst = {name: max(self.worst[name], float(value)) for name, value in now.items()}
        self._last[id(env)] = action
        self.steps += len(action)

    def require_within_limits(self):
        assert self.worst["outside"] <= 0.0, self.worst  # m
        assert self.worst["force"] <= 0.0, self.worst  # N
        assert self.worst["size"] <= 1e-6, self.worst
        assert self.worst["change"] <= 1e-6, self.worst


@pytest.mark.parametrize("variant", VARIANTS)
def test_nobody_who_pushes_hard_exceeds_a_limit(variant, monkeypatch):
    config = resolve(*VARIANTS[variant])
    watch = Watch(monkeypatch, config["safety"])
    pushes = torch.tensor(CORNERS).repeat(3, 1)
    env = assembly.environment(config).make(len(pushes) + 2)
    generator = torch.Generator().manual_seed(0)
    td, limited = env.reset(), {}
    for _ in range(50):
        erratic = torch.randn(2, 3, generator=generator).sign()
        td = env.step(td.set("action", torch.cat([pushes, erratic])))
        for name, flag in td["next", "safety"].items():
            limited[name] = limited.get(name, 0) + int(flag.sum())
        td = step_mdp(td)
    watch.require_within_limits()
    assert all(limited[name] for name in ("workspace", "force")), limited


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_training_exceeds_no_limit_even_towards_harm(variant, monkeypatch, tmp_path):
    """A policy is rewarded for what the task punishes: distance, force, blocks that tilt and move."""
    config = resolve(
        *VARIANTS[variant],
        "disturbance=noise",
        "algorithm.agent.reward_scale=-10.0",
        "algorithm=td3",
        "algorithm.agent.network.hidden=[32,32]",
        "trainer.num_envs=2",
        "trainer.steps_per_collection=25",
        "trainer.total_steps=1200",
        "trainer.warmup_steps=400",
        "trainer.evaluation.every=400",
        "trainer.evaluation.episodes=10",
        "trainer.evaluation.final_episodes=10",
        "trainer.evaluation.slots=10",
    )
    watch = Watch(monkeypatch, config["safety"])
    with assembly.trainer(config, tmp_path) as trainer:
        results = trainer.run()
    watch.require_within_limits()
    assert watch.steps >= 1200 + 4 * 10 * 50  # training and evaluations
    first = next(iter(results))
    comparison = results[first]
    # It did learn harm.
    assert comparison.residual.returns.mean() < comparison.controller.returns.mean()
    assert comparison.summary()["safety_force"] > 0
    with (tmp_path / "metrics.csv").open() as file:
        logged = {row["metric"] for row in csv.DictReader(file)}
    assert {"safety/workspace", "safety/force", "safety/step"} <= logged
    assert {f"eval/{first}/safety_{name}" for name in ("workspace", "force", "step")} <= logged


def nothing(position):
    return np.full(2, np.nan)


def test_a_controller_that_gives_no_numbers_ends_the_run_with_its_name(make_trainer, factory):
    """Though the policy does not read what the controller says."""
    broken = partial(FunctionController, nothing, ["end_effector_position"])
    trainer = make_trainer("run", environment=replace(factory, controller=broken))
    with trainer, pytest.raises(FloatingPointError, match="base_action: expected finite numbers"):
        trainer.run()
