"""The task for the peers: the same physics, reward, controller and sensing faults in plain NumPy.

A Gymnasium environment around the functions that :class:`rrl.envs.InsertionEnv` is made of. Nothing of TensorDict,
TorchRL or our transforms is charged to a peer.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from rrl.envs.insertion import quantities
from rrl.envs.insertion.config import make_config
from rrl.envs.insertion.physics.control import set_points
from rrl.envs.insertion.physics.simulation import BatchSimulation
from rrl.envs.insertion.physics.start import draw_episode
from rrl.trainers.cli.compose import compose

Config = dict[str, Any]


def configuration(overrides: list[str], algorithm: str | None = "td3") -> Config:
    """The configuration of ``rrl train`` with ``overrides``, by default with the algorithm that all libraries have."""
    chosen = [] if algorithm is None else [f"algorithm={algorithm}"]
    if not any(override.startswith("env=") for override in overrides):
        chosen.append("env=insertion-real")  # the others know no budgets
    return compose(["logger=[csv]", *chosen, *overrides])


class PlainInsertion(gymnasium.Env[np.ndarray, np.ndarray]):
    """One environment; the action is the residual in [-1, 1], the observation what our policy reads.

    Args:
        config: of ``rrl train``; its base, inputs, sensing, controller and residual scale are used.
        seed: of the episodes and of the sensing noise.

    """

    def __init__(self, config: Config, seed: int) -> None:
        env = config["env"]
        base = {
            k: v
            for k, v in env["base"].items()
            if k not in ("_target_", "variant", "num_threads", "seed")
        }
        self.config = make_config(env["base"]["variant"], base)
        self.simulation = BatchSimulation(self.config, 1, 1)
        self.random = np.random.default_rng(seed)
        self.keys = list(env["inputs"])
        sizes = {
            **quantities.observation_sizes(self.config),
            "base_action": 3,
            "previous_action": 3,
        }

        def column(name: str, default: float) -> np.ndarray:
            entries = [
                np.broadcast_to((env["inputs"][k] or {}).get(name, default), sizes[k])
                for k in self.keys
            ]
            return np.concatenate(entries).astype(np.float64)

        self.loc, self.scale = column("loc", 0.0), column("scale", 1.0)
        sensing = env.get("sensing") or {}
        self.noise = np.asarray((sensing.get("camera_noise") or {}).get("sigma", 0.0))
        self.latency = int((sensing.get("camera_latency") or {}).get("steps", 0))
        controller = config["controller"]
        self.gain, self.clip = controller["gain"] / controller["unit"], controller["clip"]
        self.residual_scale = np.asarray(config["residual_scale"])
        self.reward_scale = config["algorithm"]["agent"]["reward_scale"]
        self.goal = np.asarray(self.config.goal)
        size = sum(sizes[key] for key in self.keys)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: Any = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start the next episode; ``seed`` starts the random numbers anew."""
        if seed is not None:
            self.random = np.random.default_rng(seed)
        trace = self.simulation.reset(0, draw_episode(self.config, self.random))
        self.steps, self.queue, self.previous_action = 0, [], np.zeros(3)
        return self._observe(self._evaluate(trace)), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Add the residual to the controller's action, and step."""
        executed = np.clip(self.base_action + self.residual_scale * action, -1.0, 1.0)[None]
        signals = self.simulation.start.layout.views(self.simulation.sensors)
        controls = set_points(signals, executed, self.config, self.simulation.start.home)
        trace, diverged = self.simulation.step(controls)
        self.steps += 1
        self.previous_action = action
        outputs = self._evaluate(trace)
        reward = float(outputs["reward"][0, 0]) * self.reward_scale
        over = self.steps >= self.config.episode_length or bool(diverged[0])
        info = {"success": bool(outputs["success"][0, 0])} if over else {}
        return self._observe(outputs), reward, False, over, info

    def _evaluate(self, trace: np.ndarray) -> dict[str, np.ndarray]:
        start = self.simulation.start
        return quantities.evaluate(start.layout.views(trace), start.tare, self.config)

    def _observe(self, outputs: dict[str, np.ndarray]) -> np.ndarray:
        entries = {name: value[0] for name, value in outputs.items()}
        seen = entries["blocks"]
        if self.noise.any():
            seen = seen + self.noise * self.random.standard_normal(seen.shape)
        self.queue = (
            [*self.queue, seen][-self.latency - 1 :] if self.queue else [seen] * (self.latency + 1)
        )
        entries["blocks"] = self.queue[0]
        position = entries["end_effector_position"]
        self.base_action = np.clip(self.gain * (self.goal - position), -self.clip, self.clip)
        entries |= {"base_action": self.base_action, "previous_action": self.previous_action}
        values = np.concatenate([entries[key] for key in self.keys])
        return ((values - self.loc) * self.scale).astype(np.float32)


def success_rate(
    env: PlainInsertion, act: Callable[[np.ndarray], np.ndarray], episodes: int, seed: int
) -> float:
    """Share of the frozen episodes ``seed .. seed + episodes - 1`` that ``act`` solves."""
    solved = 0
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        over = False
        while not over:
            observation, _, _, over, info = env.step(act(observation))
        solved += info["success"]
    return solved / episodes
