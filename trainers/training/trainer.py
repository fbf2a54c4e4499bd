"""The training loop: collect, store, update, evaluate, log, checkpoint."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from tensordict.nn import TensorDictModuleBase
from torchrl.checkpoint import GlobalRNGState

from rrl.algorithms import Agent

from ..environment import EnvironmentFactory
from ..evaluation.episodes import Comparison
from ..evaluation.evaluator import Evaluator
from ..loggers import CSVLogger, Guarded, MetricsLogger, metrics
from ..seeds import Stream, first_seed
from ..settings import TrainerSettings
from ..storage.checkpoints import Checkpoints, newest_whole, saved_note
from ..storage.files import require_unclaimed
from ..storage.finite import require_finite
from ..storage.replay_store import ReplayStore
from ..storage.same_run import as_json, require_same_run
from ..storage.space_needed import require_room
from .acceptance import Acceptance
from .clock import Clock, Counters
from .collection import Metrics
from .constraints import Constraints
from .factories import agent_or_default, default_exploration, in_python, settings_of
from .interface import Exploration
from .interruption import Interrupted, Interruption
from .keyboard import listening
from .learning import Learning
from .person import Person
from .profiling import Profile, Stopwatch, measured
from .progress import Progress
from .schedule import announce, checkpoint_due, evaluation_due, require_no_shorter
from .torch_setup import configure_torch
from .ways_to_collect import make_collection

log = logging.getLogger(__name__)


class Trainer(AbstractContextManager["Trainer"]):
    """Trains one residual policy, by default as ``rrl train`` does; ``with`` closes it.

    Args:
        environment: Builds the training environment.
        settings: How long, how often, how many; of one run, so one seed.
        agent: Makes the learner; called with ``inputs`` and ``action_size``.
        exploration: Makes TorchRL's exploration module; called with ``spec``.
        run_dir: Where the run writes.
        scenarios: Environments that the policy is evaluated on, by name; the first is the one
            followed during training. None: the training environment, as ``training``.
        loggers: Sinks for metrics. None: ``metrics.csv``.
        config: What the loggers record as the run's configuration.
        progress: Shows how far the run is.
    """

    def __init__(
        self,
        environment: EnvironmentFactory,
        settings: TrainerSettings | None = None,
        agent: Callable[..., Agent] | None = None,
        exploration: Exploration | None = None,
        run_dir: Path | str = "outputs/run",
        *,
        scenarios: Mapping[str, EnvironmentFactory] | None = None,
        loggers: Sequence[MetricsLogger] | None = None,
        config: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
    ) -> None:
        given, self.run_dir = settings_of(environment, settings), Path(run_dir)
        require_unclaimed(self.run_dir)  # before anything touches a robot that is at work
        lengths = saved_note(self.run_dir).get("lengths")
        self.settings = settings = given.derived(environment.max_episode_steps, lengths)
        self.loggers = [Guarded(g) for g in ([CSVLogger()] if loggers is None else loggers)]
        self.config = as_json(config or in_python(given, environment, agent, exploration))
        self.interruption, self.stopwatch, self.profile = Interruption(), Stopwatch(), Profile()
        self.progress = progress or Progress(Console(quiet=True))
        settings.check_operator(environment.intervention is not None)
        configure_torch(settings)
        self.run_dir.mkdir(parents=True, exist_ok=True)
        self.constraints = Constraints(environment.metrics, settings.constraints, settings.n_step)
        explore = exploration or default_exploration()
        self.collection = make_collection(settings, environment, explore, self.run_dir)
        with ExitStack() as if_it_fails:
            if_it_fails.callback(self.collection.close)
            make_agent = agent_or_default(agent, environment)
            self.agent = make_agent(**self.collection.interface.arguments()).to(settings.device)
            self.collection.set_policy(self.agent.policy)
            self.store = ReplayStore.of(settings, self.run_dir, self.agent.gamma)
            stored = self.store.log.count
            require_room(self.run_dir, settings, *self.collection.interface.room, stored)
            self.replay = self.store.replay
            self.person = Person(self.collection, self.interruption)
            scenarios = {"training": environment} if scenarios is None else scenarios
            self.evaluator = Evaluator(scenarios, settings.evaluation, self.collection.requests)
            self.acceptance = Acceptance(settings, self.agent, self.evaluator)
            self.learning = Learning(
                self.agent, self.store, self.constraints, settings, self.run_dir, self.stopwatch
            )
            self.counters, self.clock = Counters(env_steps=0), Clock(self.evaluator.lap)
            self.checkpoints = Checkpoints(self.run_dir, settings.checkpoint.keep, self._parts())
            if_it_fails.pop_all()
        self._resumed, self._generators = False, GlobalRNGState().state_dict()  # as the run begins

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self.counters["env_steps"]

    @property
    def policy(self) -> TensorDictModuleBase:
        """What the run hands over so far: the controller's alone until a policy is accepted."""
        return self.acceptance.handed_over.policy

    def resume(self) -> Path:
        """Continue from the run's newest checkpoint that is whole.

        A simulation goes on in its episode and makes again what came after the checkpoint. For any
        other environment, :meth:`run` learns again from what is stored, and an episode begins.

        Raises:
            FileNotFoundError, ValueError: If none is whole, this is another run, or more is done.
        """
        self.checkpoints.claim()
        path, note, torn = newest_whole(self.run_dir, lambda n: self.store.check(n["transitions"]))
        reads = self.collection.interface.described()
        require_same_run(note["config"] | note["interface"], self.config | reads)
        self.checkpoints.load(path, torn)
        require_no_shorter(self.settings, self.env_steps)
        self.acceptance.require_tested_on(note["config"], self.config)
        if self.collection.can_continue:
            self.store.set_pending_aside()
        else:
            self.store.keep_whole_rounds(self.settings.steps_per_round, self.collection.recoverable)
            # Of what is stored already nothing is drawn again, however often the run dies.
            seed = first_seed(Stream.TRAINING, self.settings.seed, self.store.log.count)
            self.collection.start_episode(seed)
        self._resumed, self._generators = True, GlobalRNGState().state_dict()
        return path

    def run(self) -> dict[str, Comparison]:
        """Train to ``total_steps``, evaluate every scenario, save.

        Returns:
            By scenario the learner's comparison; its ``handed_over`` is that of :attr:`policy`.

        Raises:
            Interrupted: If a signal asked for it; the run is saved.
            FileExistsError, BlockingIOError: See :meth:`require_new_or_resumed`.
            FloatingPointError: If losses or parameters are not finite; the checkpoint before stays.
            RuntimeError: If a scenario cannot be played.
        """
        self.require_new_or_resumed()
        self._resumed = False  # to go on once more is to resume again, or noise would come again
        GlobalRNGState().load_state_dict(self._generators)
        for logger in self.loggers:
            logger.start(self.run_dir, self.config, self.env_steps)
        announce(self.settings, self.evaluator, self.acceptance, self.env_steps)
        progress = self.progress.training(self.settings.total_steps, self.env_steps)
        keys = listening(self.person, self.settings.keys)
        with self.collection.attended(), self.interruption.listening(), progress, keys:
            if self.env_steps == 0:
                self._save()
            if self.settings.collection != "realtime":
                self.evaluator.try_out()
            elif self.env_steps == 0:  # the robot is another process's, which hands it over once
                with self.collection.paused():
                    self.evaluator.try_out()
            if self.env_steps == 0 and self.settings.evaluation.every:
                self._evaluate()
            while self.env_steps < self.settings.total_steps:
                self._stop_if_asked()
                self._round()
            self._save()
            return self._evaluate_all()

    def require_new_or_resumed(self) -> None:
        """Claim the run's directory.

        Raises:
            FileExistsError: If it holds a run and :meth:`resume` was not called since the last one.
            BlockingIOError: If another process is training in it.
        """
        self.checkpoints.claim()
        if not self._resumed and (self.checkpoints.exist() or self.store.log.count):
            what = "expected a directory without a run; resume it, or choose another"
            raise FileExistsError(f"{self.run_dir}: {what}")

    def close(self) -> None:
        """Finish the loggers and close the environments, even those that no longer answer."""
        parts = self.store, self.evaluator, self.collection
        ends = [logger.finish for logger in self.loggers] + [part.close for part in parts]
        for end in (*ends, self.checkpoints.release):
            try:
                end()
            except Exception as error:
                log.warning("closing failed: %s", error)

    def __exit__(self, *error: object) -> None:
        self.close()

    def _parts(self) -> dict[str, Any]:
        """Return what checkpoints hold, by name and in their order."""
        return {
            "agent": self.agent,
            "collection": self.collection,
            "replay": self.store,
            "handed_over": self.acceptance,
            "constraints": self.constraints,
            "generator": self.learning.generator,
            "progress": self.counters,
            "clock": self.clock,
        }

    def _round(self) -> None:
        try:
            values = self._collect_and_store()
        except Interrupted:  # it waited for a robot, in vain
            return
        self.counters["env_steps"] += self.settings.steps_per_round
        saves = checkpoint_due(self.settings, self.env_steps)
        self.collection.before_updates(self._next_round(), saves)
        if self.env_steps >= (self.settings.warmup_steps or 0):
            with self.stopwatch("update"):
                values |= self.learning.update()
        values |= measured(self.stopwatch)
        self.profile.add(values, self.settings.steps_per_round)
        with self.stopwatch("log"):
            self._log(values)
        if evaluation_due(self.settings, self.env_steps):
            self._evaluate()
        self.progress.advance(self.settings.steps_per_round)
        if saves:
            with self.stopwatch("checkpoint"):
                self._save()

    def _collect_and_store(self) -> Metrics:
        if self.store.pending:  # stored after the checkpoint that was resumed
            values = self.collection.recover(self.env_steps)
            stored = self.store.recover(self.settings.steps_per_round)
        else:
            with self.stopwatch("collect"):
                transitions, values = self.collection.collect(self.env_steps)
            with self.stopwatch("store"):
                stored = self.store.extend(transitions)
        self.acceptance.notice(values)
        return values | self.constraints.adapt(stored)

    def _next_round(self) -> int | None:
        """Return where the next round starts, if it may be collected now."""
        ends = self.env_steps >= self.settings.total_steps or self.interruption.signal is not None
        return None if ends or self.store.pending > 0 else self.env_steps

    def _save(self) -> None:
        if not self.settings.total_steps:
            return  # the controller alone: nothing to go on with
        require_finite(dict(self.agent.named_parameters()), "not saved: the agent has")
        for logger in self.loggers:
            logger.flush()
        note = {"config": self.config, "interface": self.collection.interface.described()}
        note |= {"transitions": self.store.mark(), "lengths": self.settings.lengths}
        self.checkpoints.save(self.env_steps, note)
        first = self.checkpoints.oldest_transition() - self.store.capacity
        self.store.forget(first)
        self.collection.forget(first)

    def _stop_if_asked(self) -> None:
        if self.interruption.signal is not None and not self.collection.is_ahead:
            self._save()
            self.interruption.check()

    def _evaluate(self) -> None:
        with self.stopwatch("evaluate"), self.collection.paused():
            comparison, values = self.acceptance.follow(self.env_steps)
        self.progress.show(comparison, self.env_steps)
        self._log(values)

    def _evaluate_all(self) -> dict[str, Comparison]:
        results, episodes = {}, self.settings.evaluation.final_episodes
        compare = partial(self.acceptance.handed_over.compare, self.evaluator, self.env_steps)
        for scenario in self.progress.track(self.evaluator.scenarios, "evaluating"):
            self._stop_if_asked()
            with self.stopwatch("evaluate"), self.collection.paused():
                results[scenario] = compare(scenario, Stream.FINAL, episodes)
            summary = metrics.evaluation(metrics.FINAL, scenario, results[scenario].summary())
            self._log(summary | measured(self.stopwatch))
        return results

    def _log(self, values: Mapping[str, float]) -> None:
        values = self.clock.totals(values)
        for logger in self.loggers:
            logger.log(values, self.env_steps)
