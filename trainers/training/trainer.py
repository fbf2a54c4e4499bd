"""The training loop: collect, store, update, evaluate, log, checkpoint."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tensordict.nn import TensorDictModuleBase

from rrl.algorithms import TD3
from rrl.exploration import GaussianExploration
from rrl.replay import StackedSampler

from ..environment import EnvironmentFactory
from ..evaluation.episodes import Comparison
from ..evaluation.evaluator import Evaluator
from ..loggers import CSVLogger, Guarded, MetricsLogger, metrics
from ..loggers.timing import Stopwatch
from ..seeds import Stream
from ..settings import TrainerSettings
from ..storage.checkpoints import Checkpoints, newest_whole
from ..storage.finite import require_finite
from ..storage.replay_store import ReplayStore
from ..storage.same_run import require_same_run
from .background_collection import Overlapped
from .collection import Experience, InTurn, Metrics
from .episode_state import Holder
from .interruption import Interruption
from .profiling import Profile, measured
from .progress import Progress
from .torch_setup import configure_process

log = logging.getLogger(__name__)

DEFAULT_EXPLORATION = partial(GaussianExploration, sigma=0.2)


class Trainer:
    """Trains ``S`` independent residual policies side by side. In a ``with`` statement it closes itself.

    Args:
        settings: how long, how often, how many.
        environment: builds the training environment.
        agent: makes the learner; called with ``input_sizes``, ``action_size``, ``num_seeds`` and ``seed``.
        exploration: makes the exploration module; called with ``spec``, ``num_slots`` and ``seed``.
        run_dir: where the run writes.
        scenarios: environments that the policies are evaluated on, by name; the first is the one followed during
            training. None: the training environment, as ``training``.
        loggers: sinks for metrics. None: ``metrics.csv``.
        config: what the loggers record as the run's configuration.
        progress: shows how far the run is.

    """

    def __init__(
        self,
        settings: TrainerSettings,
        environment: EnvironmentFactory,
        agent: Callable[..., Any] = TD3,
        exploration: Callable[..., TensorDictModuleBase] = DEFAULT_EXPLORATION,
        run_dir: Path | str = "outputs/run",
        *,
        scenarios: Mapping[str, EnvironmentFactory] | None = None,
        loggers: Sequence[MetricsLogger] | None = None,
        config: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.settings, self.run_dir = settings, Path(run_dir)
        self.loggers = [
            Guarded(logger) for logger in ([CSVLogger()] if loggers is None else loggers)
        ]
        self.config = dict(config or {"trainer": settings.model_dump()})
        self.interruption = Interruption()
        self.progress = progress or Progress.silent()
        self.stopwatch, self.profile = Stopwatch(), Profile()
        configure_process(settings)
        self.run_dir.mkdir(parents=True, exist_ok=True)

        collect = Overlapped if settings.overlap else InTurn
        self.experience: Experience = collect(settings, environment, exploration)
        self.agent = agent(
            input_sizes=self.experience.sizes.inputs,
            action_size=self.experience.sizes.action,
            num_seeds=settings.num_seeds,
            seed=settings.seed,
        )
        self.experience.follow(self.agent.policy)
        self.sampler = StackedSampler(settings.num_seeds, settings.seed, settings.batch_size)
        returns = (
            {"n_step": settings.n_step, "gamma": self.agent.gamma} if settings.n_step > 1 else {}
        )
        self.store = ReplayStore(self.run_dir, self.sampler, settings.buffer_capacity, **returns)
        self.replay = self.store.replay
        self.evaluator = Evaluator(scenarios or {"training": environment}, settings.evaluation)
        self.counters: dict[str, int] = {"env_steps": 0}
        self._resumed = False
        self.checkpoints = Checkpoints(
            self.run_dir,
            settings.checkpoint.keep,
            {
                "agent": self.agent,
                "experience": self.experience,
                "replay": self.store,
                "sampler": self.sampler,
                "progress": Holder(self.counters),
            },
        )

    @property
    def env_steps(self) -> int:
        """Environment steps of one seed so far."""
        return self.counters["env_steps"]

    def resume(self) -> Path:
        """Continue from the run's newest checkpoint that is whole.

        A simulation goes on in the middle of its episode and makes again what it made after the checkpoint. An
        environment without a state starts a new episode; :meth:`run` first learns from the transitions that were stored
        after the checkpoint, as it did before, and goes on from the last of them.

        Raises:
            FileNotFoundError: if there is none.
            ValueError: if none is whole, or the configuration is not the run's own.

        """
        self.checkpoints.claim()
        path, note, torn = newest_whole(
            self.run_dir, lambda note: self.store.check(note["transitions"])
        )
        require_same_run(note["config"], self.config)
        self.checkpoints.load(path, torn)
        if self.experience.continues:
            self.store.set_pending_aside()
        else:
            first_seed = self.settings.seed * self.settings.envs_per_seed
            self.experience.start_anew(first_seed + self.store.log.count)
            self.store.keep_whole_rounds(self.settings.transitions_per_round)
        self._resumed = True
        return path

    def run(self) -> dict[str, Comparison]:
        """Train to ``total_steps``, evaluate every scenario, save.

        Returns:
            For every scenario a comparison with the controller.

        Raises:
            Interrupted: if SIGTERM or Ctrl-C asked for it; the run is saved.
            FileExistsError, BlockingIOError: see :meth:`require_new_or_resumed`.
            FloatingPointError: if losses or parameters are no longer finite; the checkpoint before stays.

        """
        settings = self.settings
        self.require_new_or_resumed()
        for logger in self.loggers:
            logger.start(self.run_dir, self.config, self.env_steps)
        with (
            self.interruption.listening(),
            self.progress.training(settings.total_steps, self.env_steps),
        ):
            if self.env_steps == 0:
                self._save()
                if settings.evaluation.every:
                    self._evaluate()
            while self.env_steps < settings.total_steps:
                self._stop_if_asked()
                self._round()
            self._save()
            return self._evaluate_all()

    def require_new_or_resumed(self) -> None:
        """Claim the run's directory.

        Raises:
            FileExistsError: if it holds a run already and :meth:`resume` was not called.
            BlockingIOError: if another process is training in it.

        """
        self.checkpoints.claim()
        if not self._resumed and (self.checkpoints.exist() or self.store.log.count):
            raise FileExistsError(
                f"{self.run_dir} holds a run already: resume it, or choose another directory"
            )

    def close(self) -> None:
        """Finish the loggers and close the environments, even those that no longer answer."""
        for logger in self.loggers:
            logger.finish()
        self.checkpoints.release()
        self.store.log.close()
        for close in (self.evaluator.close, self.experience.close):
            try:
                close()
            except Exception as error:
                log.warning("closing failed: %s", error)

    def __enter__(self) -> Trainer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _round(self) -> None:
        values = self._recover() if self.store.pending else self._collect_and_store()
        self.counters["env_steps"] += self.settings.steps_per_round
        self.experience.begin(
            self._next_collection(), checkpoint=self._due(self.settings.checkpoint.every)
        )
        if self.env_steps >= self.settings.warmup_steps:
            with self.stopwatch("update"):
                values |= self._update()
        values |= measured(self.stopwatch, self.settings.num_seeds)
        self.profile.add(values, self.settings.steps_per_round)
        with self.stopwatch("log"):
            self._log(values)
        if self._due(self.settings.evaluation.every):
            with self.stopwatch("evaluate"):
                self._evaluate()
        self.progress.advance(self.settings.steps_per_round)
        if self._due(self.settings.checkpoint.every):
            with self.stopwatch("checkpoint"):
                self._save()

    def _collect_and_store(self) -> Metrics:
        with self.stopwatch("collect"):
            transitions, values = self.experience.collect(self.env_steps)
        with self.stopwatch("store"):
            self.store.extend(transitions)
        return values

    def _next_collection(self) -> int | None:
        """Where the next collection starts, if it may begin now."""
        ends = self.env_steps >= self.settings.total_steps or self.interruption.signal is not None
        return None if ends or self.store.pending > 0 else self.env_steps

    def _recover(self) -> Metrics:
        """A round whose transitions come from the log: they were stored after the checkpoint that was resumed."""
        self.store.recover(self.settings.transitions_per_round)
        return {}

    def _update(self) -> Metrics:
        with self.stopwatch("sample"):
            batches = self.store.sample(self.settings.updates_per_round)
        compiled = getattr(self.agent, "compile_seconds", 0.0)
        losses = self.agent.update(batches)
        self.stopwatch.add("compile", getattr(self.agent, "compile_seconds", 0.0) - compiled)
        require_finite(losses, "the update gave")
        return {metrics.name(metrics.LOSS, k): v.tolist() for k, v in losses.items()}

    def _save(self) -> None:
        if not self.settings.total_steps:
            return  # the controller alone: nothing to go on with
        require_finite(dict(self.agent.named_parameters()), "not saved: the agent has")
        for logger in self.loggers:
            logger.flush()
        self.checkpoints.save(
            self.env_steps, {"transitions": self.store.mark(), "config": self.config}
        )
        self.store.log.forget(self.checkpoints.oldest_transition() - self.store.capacity)

    def _stop_if_asked(self) -> None:
        if self.interruption.signal is not None and not self.experience.under_way:
            self._save()
            self.interruption.check()

    def _due(self, every: int) -> bool:
        return bool(every) and self.env_steps % every == 0

    def _evaluate(self) -> None:
        scenario = self.evaluator.followed
        comparison = self.evaluator.compare(
            self.agent.policy_of(0), scenario, Stream.FOLLOWING, self.settings.evaluation.episodes
        )
        self.progress.show(comparison, self.env_steps)
        self._log(metrics.evaluation(metrics.EVALUATION, scenario, comparison.summary()))

    def _evaluate_all(self) -> dict[str, Comparison]:
        results = {}
        for scenario in self.progress.track(self.evaluator.scenarios, "evaluating"):
            self._stop_if_asked()
            results[scenario] = self.evaluator.compare(
                self.agent.policy_of(0),
                scenario,
                Stream.FINAL,
                self.settings.evaluation.final_episodes,
            )
            self._log(metrics.evaluation(metrics.FINAL, scenario, results[scenario].summary()))
        return results

    def _log(self, values: Mapping[str, Any]) -> None:
        one = {name: float(np.mean(value)) for name, value in values.items()}
        for logger in self.loggers:
            logger.log(one, self.env_steps)
