"""What an earlier run has learned, as the start of another: weights, a controller, a recording."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor
from torchrl.envs import EnvBase

from rrl.algorithms.base import Agent
from rrl.controllers import Controller, PolicyController, ReplayController, ZeroController
from rrl.keys import ACTION, BASE_ACTION, PREVIOUS_ACTION, SUCCESS
from rrl.transforms.base.action_bounds import limits_of

from .configuration import build as assembly
from .environment import EnvironmentFactory
from .evaluation.rollout import rollout
from .generators import isolated_generators
from .metric_names import ACCEPTED
from .report.runs import Run
from .seeds import Stream, first_seed
from .storage.checkpoints import load_components, saved_note
from .storage.run_files import CONFIG_FILE, seed_directories
from .training.interface import interface_of
from .training.run_policy import RunPolicy

__all__ = [
    "TrainedRun",
    "best_run",
    "policy_controller",
    "replay_controller",
    "start_from",
    "trained_run",
]

Config = Mapping[str, Any]
READ = ("inputs", "critic_inputs")
EPISODES_TRIED = 20
"""How many frozen episodes are tried for one that the policy solves."""

log = logging.getLogger(__name__)


def best_run(run: str | Path | None) -> Path:
    """Return a run's directory; of several seeds that of the best one.

    The best one hands over the policy of the highest success, then return, by the last evaluation
    during training. The final evaluation decides nothing, so that its numbers stay those of a
    policy not chosen by them.

    Raises:
        FileNotFoundError: If there is no run.
        ValueError: If no seed was evaluated during training.
    """
    path = Path(run or "").expanduser()
    if seeds := seed_directories(path):
        scores = {seed: score for seed in seeds if (score := _score(Run(seed, seed.name)))}
        if not scores:
            raise ValueError(
                f"run: expected evaluations during training to choose a seed of {path} by, got "
                "none: name the directory of one seed"
            )
        best = max(scores, key=lambda seed: scores[seed])
        log.info("%s: taking %s, the best during training", path, best.name)
        return best
    if run is None or not (path / CONFIG_FILE).is_file():
        raise FileNotFoundError(
            f"run: expected the directory of a training run, got {run!r}: no {CONFIG_FILE} there"
        )
    return path


@dataclass(frozen=True)
class TrainedRun:
    """What a run's newest whole checkpoint holds.

    Attributes:
        checkpoint: The checkpoint; None: nothing was trained, it is the controller alone.
        env_steps: Environment steps at which it was made.
        agent: The learner as it was then.
        handed_over: What the run hands over; whoever uses a run uses its ``policy``.
    """

    checkpoint: Path | None
    env_steps: int
    agent: Agent
    handed_over: RunPolicy


def trained_run(config: Config, run_dir: Path) -> TrainedRun:
    """Return what a run's newest whole checkpoint holds; without training, the controller.

    Raises:
        FileNotFoundError: If something is to be trained, and there is no checkpoint.
        ValueError: If none is whole, or ``config`` reads other entries than the run, or in another
            order.
    """
    factory = assembly.environment(config)
    env = factory.make(1)
    interface = interface_of(factory, env)
    agent: Agent = assembly.agent(config)(**interface.arguments())
    env.close()
    settings = assembly.settings(config)
    if not settings.total_steps:
        return TrainedRun(None, 0, agent, RunPolicy(agent, tested=True))
    reads = interface.described()
    learned = saved_note(run_dir).get("interface", reads)
    for group in READ:  # their order is that of the networks' columns
        if reads[group] != learned[group]:
            raise ValueError(
                f"env.{group}: expected {learned[group]} in this order, as {run_dir} has learned, "
                f"got {reads[group]}; leave env.{group} as the run has it"
            )
    handed_over = RunPolicy(agent, settings.acceptance.enabled)
    found = load_components(run_dir, {"agent": agent, "handed_over": handed_over})
    return TrainedRun(*found, agent, handed_over)


def start_from(agent: Agent, config: Config) -> None:
    """Give a new agent the initial weights that ``init_from.run`` names, if it names any.

    They are those of the policy that the run hands over, critics included. A run that hands over
    the controller has none to give.

    Raises:
        FileNotFoundError: If there is no such run.
        ValueError: If it reads other entries, or in another order, or has networks of other sizes.
    """
    run = (config.get("init_from") or {}).get("run")
    if run is None:
        return
    path = best_run(run)
    source = Run(path, path.name).config
    for group in READ:
        reads, learned = (c["env"].get(group) or {} for c in (config, source))
        if list(reads.items()) != list(learned.items()):
            raise ValueError(
                f"init_from.run: expected a run with env.{group} {reads} in this order, got {run} "
                f"with {learned}; give both runs the same env.{group}, in the same order"
            )
    trained = trained_run(source, path)
    if trained.handed_over.restore_learner():
        agent.start_from(trained.agent)
    else:
        log.warning("init_from.run: %s hands over the controller; starting from scratch", path)


def policy_controller(run: str | None = None, out_key: str = BASE_ACTION) -> Controller:
    """Make a policy that was trained alone (``arm=rl``) the controller: closed loop, frozen.

    Args:
        run: Directory of the run that trained it, or of several seeds, as for :func:`best_run`.
        out_key: Where the action goes.

    Raises:
        FileNotFoundError: If there is no such run.
        ValueError: If the policy is a residual, or reads what only its own run can give it.
    """
    return PolicyController(_policy(run), out_key=out_key)


def replay_controller(run: str | None = None, out_key: str = BASE_ACTION) -> Controller:
    """Replay open loop what such a policy does on a frozen episode that it solves.

    Arguments and errors are those of :func:`policy_controller`.
    """
    return ReplayController(_actions(run), out_key=out_key)


@lru_cache(maxsize=4)
def _policy(run: str | None) -> TensorDictSequential:
    """Return a module from the source's inputs to ``action`` in the environment's units."""
    config, policy = _source(run)
    factory = assembly.environment(config)
    in_units = TensorDictModule(_to_units(factory), in_keys=[ACTION], out_keys=[ACTION])
    return TensorDictSequential(policy, in_units)


@lru_cache(maxsize=4)
@torch.no_grad()
def _actions(run: str | None) -> Tensor:
    """Return actions ``[T, n_act]`` of the first episode that is solved, or of the first."""
    config, policy = _source(run)
    factory = next(iter(assembly.scenarios(config).values()))
    env = factory.make(1)
    first = first_seed(Stream.FOLLOWING, assembly.settings(config).evaluation.seed)
    tried = []
    for seed in range(first, first + EPISODES_TRIED):
        tried.append(_episode(env, policy, seed, factory.max_episode_steps))
        if tried[-1][1]:
            break
    env.close()
    actions, _ = tried[-1] if tried[-1][1] else tried[0]
    return _to_units(factory)(actions)


def _episode(env: EnvBase, policy: Any, seed: int, max_steps: int) -> tuple[Tensor, bool]:
    with isolated_generators(seed):
        _, *steps = (td for td, _ in rollout(env, policy, seed, max_steps))
    actions = torch.stack([td[ACTION].flatten() for td in steps])
    return actions, bool(steps[-1].get(SUCCESS, torch.zeros(1)).any())


def _source(run: str | None) -> tuple[Config, Any]:
    """Return configuration and policy of a run that can be a controller."""
    path = best_run(run)
    config = Run(path, path.name).config
    target = config["controller"]["_target_"]
    if target.rpartition(".")[2] != ZeroController.__name__:
        raise ValueError(f"run: expected a policy that acts alone (arm=rl), got {run} on {target}")
    private = {BASE_ACTION, PREVIOUS_ACTION} & set(config["env"]["inputs"])
    if private:
        raise ValueError(
            f"run: expected a policy that reads what any environment says, got {run}, which reads "
            f"{sorted(private)}"
        )
    return config, trained_run(config, path).handed_over.policy


def _to_units(factory: EnvironmentFactory) -> Callable[[Tensor], Tensor]:
    """Return what makes of a policy's action the command of a policy that acts alone."""
    env = factory.make(1)
    limits = limits_of(env.base_env.full_action_spec[ACTION])
    env.close()
    middle, half_range = (
        x.reshape(-1, x.shape[-1])[0].cpu() for x in (limits.middle, limits.half_range)
    )
    unit = half_range * torch.as_tensor(factory.residual_scale)
    return lambda action: middle + action * unit


def _score(run: Run) -> tuple[float, float] | None:
    """Return success and return, of what the run hands over, in the last evaluation of training."""
    score = []
    for entry in ("success", "return"):
        found = run.evaluations(ACCEPTED + entry) or run.evaluations(entry)
        values = [value for step, value in found if step]
        score.append(values[-1] if values else None)
    return None if score[1] is None else (score[0] or 0.0, score[1])
