"""Every switch for sample efficiency is a key of the configuration, and turning it changes what is learned."""

import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from torch.nn import LayerNorm
from torchrl.modules import OrnsteinUhlenbeckProcessModule

from rrl.keys import ACTION
from rrl.n_step import STEPS
from rrl.trainers.cli.compose import compose as compose_train
from rrl.trainers.configuration import build as assembly

UPDATES = 60
"""Of a run without a switch: one a step, in three rounds."""
OF_ALL = {
    "trainer.updates_per_step=2.0": lambda run: run.agent.num_updates == 2 * UPDATES,
    "trainer.n_step=3": lambda run: stored(run, STEPS, torch.ones(1)).max() == 3,
    "trainer.controller_steps=20": lambda run: not stored(run, ACTION)[:20].any(),
    "algorithm.agent.network.layer_norm=true": lambda run: has(run.agent.policy, LayerNorm),
    "algorithm.agent.critic_burn_in=20": lambda run: run.agent.settings.critic_burn_in == 20,
    "+env.inputs.base_action={}": lambda run: "base_action" in run.agent.inputs,
    "+env.inputs.previous_action={}": lambda run: "previous_action" in run.agent.inputs,
}
"""Switches, and whether each has arrived in a run."""
OF_TD3 = {
    "algorithm.agent.target_subset=1": lambda run: run.agent.settings.target_subset == 1,
    "algorithm.agent.num_critics=3": lambda run: run.agent.settings.num_critics == 3,
    "algorithm.exploration.sigma_end=0.0": lambda run: run.collection.exploration.sigma < 0.3,
    "exploration=ornstein-uhlenbeck": lambda run: has(run.collection.exploration, CORRELATED),
}
CORRELATED = OrnsteinUhlenbeckProcessModule
SMALL = {
    "total_steps": 60,
    "warmup_steps": 20,
    "steps_per_collection": 20,
    "batch_size": 16,
    "evaluation": {"every": 0, "episodes": 1, "final_episodes": 1, "seed": 0, "slots": 1},
    "acceptance": {"episodes": 1},
}


def stored(run, key, otherwise=None):
    return run.replay[:].get(key, otherwise)


def has(module, kind):
    return any(isinstance(part, kind) for part in module.modules())


def trained(run_dir, *overrides):
    """A trainer after a short training on the drifting point."""
    with initialize_config_module("rrl.configs", version_base="1.3"):
        config = compose(
            "train",
            overrides=[
                "logger=csv",
                "env=insertion-sim",
                "algorithm.agent.network.hidden=[16]",
                *overrides,
            ],
        )
    config = OmegaConf.to_container(config, resolve=True)
    inputs = config["env"]["inputs"]
    own = {key: inputs[key] for key in ("base_action", "previous_action") if key in inputs}
    config["env"] |= {
        "base": {"_target_": "toy_envs.PointMass"},
        "batching": "serial",
        "inputs": {"end_effector_position": {}, "goal": {}, **own},
        "scenarios": {"drift": {}},
        "sensing": None,
        "metrics": None,
    }
    config["residual_scale"] = 1.0
    config["trainer"] |= SMALL
    with assembly.trainer(config, run_dir) as trainer:
        trainer.run()
        return trainer


def weights(run):
    return dict(run.agent.policy.named_parameters())


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A run of each algorithm without any switch."""
    return {
        name: trained(tmp_path_factory.mktemp(name), f"algorithm={name}") for name in ("td3", "sac")
    }


@pytest.mark.parametrize(
    ("algorithm", "switch"), [("td3", s) for s in OF_ALL | OF_TD3] + [("sac", s) for s in OF_ALL]
)
def test_a_switch_arrives_and_changes_what_is_learned(algorithm, switch, plain, tmp_path):
    arrived, before = (OF_ALL | OF_TD3)[switch], plain[algorithm]
    run = trained(tmp_path, f"algorithm={algorithm}", switch)
    assert arrived(run)
    assert not arrived(before)
    kept = weights(before)
    assert any(
        v.shape != kept[k].shape or not torch.equal(v, kept[k]) for k, v in weights(run).items()
    )


def test_switches_at_their_defaults_change_nothing(plain, tmp_path):
    off = [
        "algorithm.agent.num_critics=2",
        "algorithm.agent.target_subset=2",
    ]
    off += ["algorithm.exploration.sigma_end=0.3", "trainer.n_step=1"]
    kept = weights(trained(tmp_path, "algorithm=td3", *off))
    assert all(torch.equal(kept[name], value) for name, value in weights(plain["td3"]).items())


def test_a_scenario_may_exchange_what_the_environment_is_made_of():
    other = "{_target_: rrl.envs.plant.RemoteRobot, address: 'ipc:///tmp/other'}"
    config = compose_train(["env=robot/plant", f"+env.scenarios.other.robot={other}"])
    base = assembly.scenarios(config)["other"].base
    assert base.keywords["robot"].keywords == {"address": "ipc:///tmp/other"}


@pytest.mark.parametrize(
    ("overrides", "period"),
    [
        ([], None),
        (["env.control_period=0.2"], 0.2),
        (["trainer.realtime.period=0.1"], None),  # the run is not driven in real time
        (["trainer.realtime.period=0.1", "trainer.collection=realtime"], 0.1),
    ],
)
def test_an_exported_policy_is_asked_at_the_period_of_the_training(overrides, period):
    config = compose_train(["env=robot/plant", *overrides])
    assert assembly.control_period(config) == period
