"""What an earlier run has learned, as the start of another one: initial weights, a controller, a recorded sequence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
import yaml
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rrl.algorithms.base import Agent
from rrl.controllers import Controller, PolicyController, ReplayController, ZeroController
from rrl.keys import ACTION, BASE_ACTION, OBSERVATION, PREVIOUS_ACTION, SUCCESS
from rrl.slot_random import seed_env
from rrl.transforms.base import limits_of

from .configuration import build as assembly
from .environment import EnvironmentFactory
from .storage.checkpoints import load_agent
from .storage.run_files import CONFIG_FILE

Config = Mapping[str, Any]
EPISODES_TRIED = 20
"""How many frozen episodes are tried for one that the policy solves."""


def run_config(run: str | Path | None) -> dict[str, Any]:
    """The configuration of a run.

    Raises:
        FileNotFoundError: if there is no run at ``run``.
    """
    path = Path(run or "").expanduser() / CONFIG_FILE
    if run is None or not path.is_file():
        raise FileNotFoundError(
            f"run: expected the directory of a training run, got {run!r}: no {CONFIG_FILE} there"
        )
    return dict(yaml.safe_load(path.read_text(encoding="utf-8")))


def trained_agent(config: Config, run_dir: Path) -> tuple[Agent, Path]:
    """The agent of a run's newest whole checkpoint, and that checkpoint."""
    settings, env = assembly.settings(config), assembly.environment(config).make(1)
    agent: Agent = assembly.agent(config)(
        input_sizes={OBSERVATION: env.observation_spec[OBSERVATION].shape[-1]},
        action_size=env.full_action_spec[ACTION].shape[-1],
        num_seeds=settings.num_seeds,
        seed=settings.seed,
    )
    env.close()
    return agent, load_agent(run_dir, agent)


def start_from(agent: Agent, config: Config) -> None:
    """Give a new agent the initial weights that ``init_from`` of its configuration names, if it names any.

    Raises:
        FileNotFoundError: if there is no such run.
        ValueError: if its policy reads other inputs or has networks of other sizes.
    """
    start = config.get("init_from") or {}
    run = start.get("run")
    if run is None:
        return
    source = run_config(run)
    if source["env"]["inputs"] != config["env"]["inputs"]:
        raise ValueError(
            f"init_from.run: the policy of {run} reads {source['env']['inputs']}, this one would read "
            f"{config['env']['inputs']}: give both runs the same env.inputs"
        )
    trained, _ = trained_agent(source, Path(run))
    agent.start_from(trained, chosen(source, run, start.get("seed")))


def policy_controller(
    run: str | None = None, seed: int | None = None, out_key: str = BASE_ACTION
) -> Controller:
    """A policy that was trained without another controller (``arm=rl``) as the controller: closed loop, frozen.

    Args:
        run: directory of the run that trained it.
        seed: one of its seeds; None: the best of its final evaluation.
        out_key: where the action goes.

    Raises:
        FileNotFoundError: if there is no such run.
        ValueError: if the policy is a residual, or reads what only its own run can give it.
    """
    return PolicyController(_policy(run, seed), out_key=out_key)


def replay_controller(
    run: str | None = None, seed: int | None = None, out_key: str = BASE_ACTION
) -> Controller:
    """The actions of such a policy in its own environment, on a frozen episode that it solves, replayed open loop.

    Arguments and errors are those of :func:`policy_controller`.
    """
    return ReplayController(_actions(run, seed), out_key=out_key)


def chosen(config: Config, run: str | Path, seed: int | None) -> int:
    """Place in the stack of a run's seed; None chooses by success and then return in its final evaluation.

    Raises:
        ValueError: if the run does not have that seed, or has no final evaluation to choose by.
    """
    seeds = assembly.settings(config).seeds
    if seed is None:
        path = Path(run) / "results.json"
        if not path.is_file():
            raise ValueError(
                f"seed: {run} has no final evaluation to choose the best seed by; name one of {seeds}"
            )
        results = next(iter(json.loads(path.read_text(encoding="utf-8")).values()))
        seed = max(
            seeds, key=lambda s: (results[str(s)].get("success", 0.0), results[str(s)]["return"])
        )
    if seed not in seeds:
        raise ValueError(f"seed: expected one of the run's seeds {seeds}, got {seed}")
    return seeds.index(seed)


@lru_cache(maxsize=4)
def _policy(run: str | None, seed: int | None) -> TensorDictSequential:
    """From the source's input entries to ``action`` in units of the environment's action."""
    config, agent, k = _source(run, seed)
    factory = assembly.environment(config)
    unit = _unit(factory)

    def in_action_units(action: Tensor) -> Tensor:
        return action * unit

    return TensorDictSequential(
        factory.reader(),
        agent.policy_of(k),
        TensorDictModule(in_action_units, in_keys=[ACTION], out_keys=[ACTION]),
    )


@lru_cache(maxsize=4)
@torch.no_grad()
def _actions(run: str | None, seed: int | None) -> Tensor:
    """Actions ``[T, n_act]`` of the first frozen episode that the policy solves; of the first one if it solves none."""
    config, agent, k = _source(run, seed)
    factory = next(iter(assembly.scenarios(config).values()))
    env, first = factory.make(1), assembly.settings(config).evaluation.seed
    tried = []
    for episode in range(EPISODES_TRIED):
        actions, solved = _episode(
            env, agent.policy_of(k), first + episode, factory.max_episode_steps
        )
        tried.append(actions)
        if solved:
            break
    env.close()
    return (tried[-1] if solved else tried[0]) * _unit(factory)


def _episode(env: TransformedEnv, policy: Any, seed: int, max_steps: int) -> tuple[Tensor, bool]:
    seed_env(env, seed)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        data = env.rollout(max_steps, policy)
    return data[ACTION].reshape(-1, data[ACTION].shape[-1]), bool(
        data["next"].get(SUCCESS, torch.zeros(1)).ravel()[-1]
    )


def _source(run: str | None, seed: int | None) -> tuple[Config, Agent, int]:
    config = run_config(run)
    assert run is not None
    target = config["controller"]["_target_"]
    if target.rpartition(".")[2] != ZeroController.__name__:
        raise ValueError(
            f"run: expected a policy that acts alone (arm=rl), but {run} has the controller {target}"
        )
    private = {BASE_ACTION, PREVIOUS_ACTION} & set(config["env"]["inputs"])
    if private:
        raise ValueError(
            f"run: the policy of {run} reads {sorted(private)}, which only its own run can give it"
        )
    return config, trained_agent(config, Path(run))[0], chosen(config, run, seed)


def _unit(factory: EnvironmentFactory) -> Tensor:
    """What an action of 1 stands for, ``[n_act]`` in the environment's units."""
    env = factory.make(1)
    half_range = limits_of(env.base_env.full_action_spec[ACTION]).half_range
    env.close()
    return half_range.reshape(-1, half_range.shape[-1])[0] * torch.as_tensor(factory.residual_scale)
