"""One training run of one contender in a process of its own: ``python -m benchmarks.speed.contenders NAME ...``."""

from __future__ import annotations

import argparse
import copy
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.speed.meter import Meter
from benchmarks.speed.networks import Networks
from benchmarks.speed.task import Config, PlainInsertion, configuration, success_rate
from benchmarks.speed.torchrl_trainer import td3_trainer

SEVERAL = ["trainer.num_envs=5", "trainer.steps_per_collection=10"]
PLAIN = [
    "algorithm.agent.compiled=false",
    "trainer.collection=turn",
    "trainer.steps_per_collection=1",
]


def ours(config: Config, options: argparse.Namespace, meter: Meter) -> None:
    """``rrl train`` without table and video."""
    from rrl.trainers.configuration import build as assembly
    from rrl.trainers.seeds import Stream

    folder = tempfile.TemporaryDirectory()
    trainer = assembly.trainer(config, Path(folder.name))
    process = getattr(trainer.collection, "_process", None)
    meter.processes = [] if process is None else [process.pid]
    one_round, compare = trainer._round, trainer.evaluator.compare

    def observed() -> None:
        one_round()
        meter.step(trainer.env_steps)

    def evaluated(*args: Any) -> Any:
        start = time.perf_counter()
        comparison = compare(*args)
        if Stream.FOLLOWING in args:  # the final evaluation is of one episode
            meter.evaluated(comparison.summary()["success"], time.perf_counter() - start)
        return comparison

    trainer._round, trainer.evaluator.compare = observed, evaluated  # type: ignore[method-assign]
    with folder, trainer:
        trainer.run()


def stable_baselines(
    config: Config, options: argparse.Namespace, meter: Meter, library: str = "sb3"
) -> None:
    """Stable-Baselines3's TD3, or SBX's."""
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise
    from stable_baselines3.common.vec_env import DummyVecEnv

    if library == "sbx":
        from sbx import TD3
    else:
        from stable_baselines3 import TD3
    agent, trainer = config["algorithm"]["agent"], config["trainer"]
    count, test = trainer["num_envs"], PlainInsertion(config, 0)
    seeds = range(trainer["seed"], trainer["seed"] + count)
    env = DummyVecEnv([partial(PlainInsertion, config, seed) for seed in seeds])
    noise = NormalActionNoise(
        np.zeros(3), np.full(3, config["algorithm"]["exploration"]["sigma_init"])
    )

    class Observer(BaseCallback):  # type: ignore[misc]
        def _on_step(self) -> bool:
            meter.step(self.num_timesteps - count)  # called before the updates of this step
            _evaluate(
                options,
                meter,
                test,
                lambda o: self.model.predict(o, deterministic=True)[0],
                self.num_timesteps,
            )
            return True

    smoothing = {
        "target_policy_noise": agent["target_noise"],
        "target_noise_clip": agent["target_noise_clip"],
    }
    model = TD3(
        "MlpPolicy",
        env,
        learning_rate=agent["actor_lr"],
        learning_starts=trainer["warmup_steps"],
        batch_size=trainer["batch_size"],
        tau=agent["tau"],
        gamma=agent["gamma"],
        train_freq=1,
        gradient_steps=count,
        policy_delay=agent["policy_delay"],
        action_noise=VectorizedActionNoise(noise, count),
        policy_kwargs={"net_arch": list(agent["network"]["hidden"])},
        seed=trainer["seed"],
        **(smoothing if library == "sb3" else {}),
    )
    model.learn(trainer["total_steps"], callback=Observer(), log_interval=10**6)


def sbx(config: Config, options: argparse.Namespace, meter: Meter) -> None:
    """SBX: Stable-Baselines3's loop with updates in JAX."""
    stable_baselines(config, options, meter, "sbx")


def cleanrl(config: Config, options: argparse.Namespace, meter: Meter) -> None:
    """TD3 in one loop, in the manner of CleanRL's single file."""
    agent, trainer = config["algorithm"]["agent"], config["trainer"]
    env, test = PlainInsertion(config, trainer["seed"]), PlainInsertion(config, 0)
    size = env.observation_space.shape[0]
    nets = Networks(agent, size)
    target = copy.deepcopy(nets)
    actor_optimizer = torch.optim.Adam(nets.actor.parameters(), agent["actor_lr"])
    critic_params = [p for critic in nets.critics for p in critic.parameters()]
    critic_optimizer = torch.optim.Adam(critic_params, agent["critic_lr"])
    pairs = [*zip(nets.actor.parameters(), target.actor.parameters(), strict=True)]
    for online, slow in zip(nets.critics, target.critics, strict=True):
        pairs += zip(online.parameters(), slow.parameters(), strict=True)
    total, batch, sigma = (
        trainer["total_steps"],
        trainer["batch_size"],
        config["algorithm"]["exploration"]["sigma_init"],
    )
    observations, following = (np.empty((total, size), np.float32) for _ in range(2))
    actions, rewards = np.empty((total, 3), np.float32), np.empty((total, 1), np.float32)
    random = np.random.default_rng(trainer["seed"])
    observation, _ = env.reset(seed=trainer["seed"])
    for step in range(total):
        action = np.clip(nets.act(observation) + sigma * random.standard_normal(3), -1, 1).astype(
            np.float32
        )
        new, reward, _, over, _ = env.step(action)
        observations[step], actions[step], rewards[step], following[step] = (
            observation,
            action,
            reward,
            new,
        )
        observation = env.reset()[0] if over else new
        if step + 1 >= trainer["warmup_steps"]:
            rows = random.integers(0, step + 1, batch)
            o, a, r, n = (
                torch.from_numpy(x[rows]) for x in (observations, actions, rewards, following)
            )
            with torch.no_grad():
                noise = (torch.randn_like(a) * agent["target_noise"]).clamp(
                    -agent["target_noise_clip"], agent["target_noise_clip"]
                )
                pair = torch.cat([n, (target.actor(n) + noise).clamp(-1, 1)], -1)
                goal = r + agent["gamma"] * torch.min(*(critic(pair) for critic in target.critics))
            pair = torch.cat([o, a], -1)
            loss: Tensor = sum(
                nn.functional.mse_loss(critic(pair), goal) for critic in nets.critics
            )  # type: ignore
            critic_optimizer.zero_grad()
            loss.backward()
            critic_optimizer.step()
            if step % agent["policy_delay"] == 0:
                climb = -nets.critics[0](torch.cat([o, nets.actor(o)], -1)).mean()
                actor_optimizer.zero_grad()
                climb.backward()
                actor_optimizer.step()
                with torch.no_grad():
                    for online_p, slow_p in pairs:
                        slow_p.lerp_(online_p, agent["tau"])
        meter.step(step + 1)
        _evaluate(options, meter, test, nets.act, step + 1)


def _evaluate(
    options: argparse.Namespace,
    meter: Meter,
    env: PlainInsertion,
    act: Callable[[np.ndarray], np.ndarray],
    env_steps: int,
) -> None:
    if options.every and env_steps % options.every == 0:
        start = time.perf_counter()
        rate = success_rate(env, act, options.episodes, seed=10_000)
        meter.evaluated(rate, time.perf_counter() - start)


CONTENDERS: dict[str, Callable[..., None]] = {
    "rrl": ours,
    "rrl-plain": ours,
    "rrl-default": ours,
    "sb3": stable_baselines,
    "sb3-several": stable_baselines,
    "sbx": sbx,
    "cleanrl": cleanrl,
    "torchrl": td3_trainer,
}


def main() -> None:
    """Train once and print the measurements as the last line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name", choices=CONTENDERS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=0, help="steps between evaluations; 0: none")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    torch.set_flush_denormal(True)
    settings = {"rrl": ["speed=fast"], "rrl-plain": PLAIN, "sb3-several": SEVERAL}
    switches = settings.get(options.name, [])
    config = configuration(
        [
            f"trainer.seed={options.seed}",
            f"trainer.evaluation.every={options.every}",
            f"trainer.evaluation.episodes={options.episodes if options.every else 1}",
            "trainer.evaluation.final_episodes=1",
            f"trainer.evaluation.slots={options.episodes if options.every else 1}",
            "trainer.checkpoint.every=0",
            "trainer.acceptance.enabled=false",
            *switches,
            *options.overrides,
        ],
        algorithm=None if options.name == "rrl-default" else "td3",
    )
    torch.manual_seed(options.seed)
    meter = Meter(config["trainer"]["warmup_steps"])
    CONTENDERS[options.name](config, options, meter)
    print(meter.report(), flush=True)


if __name__ == "__main__":
    main()
