"""The training loop: collect, store, update, evaluate, log, checkpoint."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.transforms import InitTracker
from torchrl.envs.utils import ExplorationType

from rrl.keys import ACTION, OBSERVATION
from rrl.random import seed_env
from rrl.replay import StackedSampler

from . import metrics
from .checkpointing import Checkpoints, EnvironmentState, Holder, ReplayContent
from .config import TrainerSettings
from .diagnostics import experience_metrics
from .environment import EnvironmentFactory
from .evaluation import Comparison
from .evaluator import Evaluator
from .loggers import MetricsLogger
from .progress import Progress
from .timing import Stopwatch

STORED = (
    OBSERVATION,
    ACTION,
    ("next", OBSERVATION),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""What the replay buffer keeps: the *policy's* action, before controller and disturbance (algorithm 1)."""


class Trainer:
    """Trains ``S`` independent residual policies side by side.

    Args:
        settings: how long, how often, how many.
        environment: builds the training environment.
        agent: makes the learner; called with ``input_sizes``, ``action_size``, ``num_seeds`` and ``seed``.
        exploration: makes the exploration module; called with ``spec``, ``num_slots`` and ``seed``.
        run_dir: where the run writes.
        scenarios: environments that the policies are evaluated on, by name; the first is the one followed during
            training.
        loggers: sinks for metrics.
        config: what the loggers record as the run's configuration.
        progress: shows how far the run is.

    """

    def __init__(
        self,
        settings: TrainerSettings,
        environment: EnvironmentFactory,
        agent: Callable[..., Any],
        exploration: Callable[..., TensorDictModuleBase],
        run_dir: Path,
        *,
        scenarios: Mapping[str, EnvironmentFactory],
        loggers: Sequence[MetricsLogger] = (),
        config: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.settings, self.run_dir = settings, run_dir
        self.loggers, self.config = list(loggers), dict(config or {})
        self._started: list[MetricsLogger] = []
        self.progress = progress or Progress.silent()
        self.stopwatch = Stopwatch()
        _configure_torch(settings)
        run_dir.mkdir(parents=True, exist_ok=True)

        num_envs = settings.num_seeds * settings.envs_per_seed
        first_seed = settings.seed * settings.envs_per_seed
        self.env = environment.make(num_envs)
        seed_env(self.env, first_seed)
        action_spec = self.env.full_action_spec[ACTION]
        self.agent = agent(
            input_sizes={OBSERVATION: self.env.observation_spec[OBSERVATION].shape[-1]},
            action_size=action_spec.shape[-1],
            num_seeds=settings.num_seeds,
            seed=settings.seed,
        )
        self.exploration = exploration(spec=action_spec, num_slots=num_envs, seed=first_seed)
        if "is_init" in self.exploration.in_keys:
            self.env.append_transform(InitTracker())
        self.behaviour = TensorDictSequential(self.agent.policy, self.exploration)
        self.collector = Collector(
            self.env,
            self.behaviour,
            frames_per_batch=num_envs * settings.steps_per_collection,
            track_traj_ids=False,
            use_buffers=False,
            trust_policy=True,
            auto_register_policy_transforms=False,
            exploration_type=ExplorationType.RANDOM,
        )
        self.sampler = StackedSampler(settings.num_seeds, settings.seed, settings.batch_size)
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(settings.buffer_capacity * settings.num_seeds),
            sampler=self.sampler,
        )
        self.evaluator = Evaluator(scenarios, settings.evaluation)
        self.counters: dict[str, int] = {"env_steps": 0}
        self.checkpoints = Checkpoints(
            run_dir,
            settings.checkpoint.keep,
            {
                "agent": self.agent,
                "exploration": self.exploration,
                "environment": EnvironmentState(self.env),
                "collector": CarriedObservation(self.collector),
                "replay": ReplayContent(self.replay),
                "sampler": self.sampler,
                "progress": Holder(self.counters),
            },
        )

    @property
    def env_steps(self) -> int:
        """Environment steps of one seed so far."""
        return self.counters["env_steps"]

    def resume(self) -> Path:
        """Continue from the run's newest checkpoint.

        Raises:
            FileNotFoundError: if there is none.

        """
        return self.checkpoints.load_latest()

    def run(self) -> dict[str, list[Comparison]]:
        """Train to ``total_steps``, evaluate every scenario, save.

        Returns:
            For every scenario one comparison with the controller per seed.

        """
        settings = self.settings
        for logger in self.loggers:
            logger.start(self.run_dir, self.config, settings.seeds, self.env_steps)
            self._started.append(logger)
        with self.progress.training(settings.total_steps, self.env_steps):
            if self.env_steps == 0:
                self._evaluate()
            while self.env_steps < settings.total_steps:
                self._round()
        results = self.evaluator.final(self.agent, settings.num_seeds, self.progress)
        for scenario, comparisons in results.items():
            self._log_evaluation(scenario, comparisons)
        if settings.total_steps and not self._due(settings.checkpoint.every):
            self.checkpoints.save(self.env_steps)
        return results

    def close(self) -> None:
        """Finish the loggers and close the environments."""
        for logger in self._started:
            logger.finish()
        self.evaluator.close()
        self.collector.shutdown()

    def _round(self) -> None:
        with self.stopwatch("collect"):
            data = self._collect()
        with self.stopwatch("store"):
            self.replay.extend(self._transitions(data))
        self.counters["env_steps"] += self.settings.steps_per_round
        losses = {}
        if self.env_steps >= self.settings.warmup_steps:
            with self.stopwatch("update"):
                losses = self._update()
        self._log_training(data, losses)
        if self._due(self.settings.evaluation.every) and self.env_steps < self.settings.total_steps:
            with self.stopwatch("evaluate"):
                self._evaluate()
        self.progress.advance(self.settings.steps_per_round)
        if self._due(self.settings.checkpoint.every):
            with self.stopwatch("checkpoint"):
                self.checkpoints.save(self.env_steps)

    def _collect(self) -> TensorDictBase:
        explores = self.settings.warmup_exploration or self.env_steps >= self.settings.warmup_steps
        self.collector.exploration_type = ExplorationType.RANDOM if explores else ExplorationType.DETERMINISTIC
        return self.collector.rollout()

    def _transitions(self, data: TensorDictBase) -> TensorDictBase:
        """Interleave the seeds: ``[S * E, T]`` to ``[E * T * S]``; see :class:`rrl.replay.StackedSampler`."""
        stored = data.select(*STORED).reshape(self.settings.num_seeds, -1)
        return stored.transpose(0, 1).reshape(-1)

    def _update(self) -> dict[str, torch.Tensor]:
        k = self.settings.updates_per_round
        shape = k, self.settings.num_seeds, self.settings.batch_size
        with self.stopwatch("sample"):
            batches = self.replay.sample(k * shape[1] * shape[2]).select(*STORED).reshape(shape)
        return self.agent.update(batches)

    def _due(self, every: int) -> bool:
        return bool(every) and self.env_steps % every == 0

    def _evaluate(self) -> None:
        scenario, comparisons = self.evaluator.during_training(self.agent, self.settings.num_seeds)
        self.progress.show(comparisons, self.env_steps)
        self._log_evaluation(scenario, comparisons)

    def _log_evaluation(self, scenario: str, comparisons: list[Comparison]) -> None:
        rows = [metrics.evaluation(scenario, c.summary()) for c in comparisons]
        self._log({name: [row[name] for row in rows] for name in rows[0]})

    def _log_training(self, data: TensorDictBase, losses: Mapping[str, torch.Tensor]) -> None:
        values = experience_metrics(data, self.settings.num_seeds, self.env)
        values |= {metrics.name(metrics.LOSS, k): v.tolist() for k, v in losses.items()}
        for section, seconds in self.stopwatch.lap().items():
            values[metrics.name(metrics.TIME, section)] = [seconds] * self.settings.num_seeds
        self._log(values)

    def _log(self, values: metrics.Values) -> None:
        for logger in self.loggers:
            logger.log(values, self.env_steps)


class CarriedObservation:
    """The collector's current TensorDict, as a component of a checkpoint.

    TorchRL's collector saves neither the environment's state nor the observation it is about to act on, and starts
    a new episode after loading. With this and the environment's own state the episode goes on.
    """

    def __init__(self, collector: Collector) -> None:
        self.collector = collector

    def state_dict(self) -> dict[str, Any]:
        """The entries by flattened key."""
        flat = self.collector._carrier.flatten_keys("/")
        return {str(key): value for key, value in flat.items()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Replace the entries."""
        carrier = self.collector._carrier
        for key, value in state.items():
            carrier.set(tuple(key.split("/")), value)


def _configure_torch(settings: TrainerSettings) -> None:
    torch.set_num_threads(settings.threads)
    torch.set_float32_matmul_precision(settings.matmul_precision)
    if settings.flush_denormals and not torch.set_flush_denormal(True):
        warnings.warn("this processor cannot flush denormal numbers; going on without", stacklevel=2)
