"""The learner's side of collection in wall-clock time."""

from __future__ import annotations

import copy
import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from rrl.pace import prioritized

from ...environment import EnvironmentFactory
from ...loggers import metrics
from ...requests import Request, Requests
from ...seeds import Stream, first_seed
from ...settings import TrainerSettings
from ...storage.replay_store import as_stored
from ...storage.transition_log import FOLDER as TRANSITIONS
from ...storage.transition_log import TransitionLog
from ..collection import Apart, Metrics
from ..collection_metrics import EpisodeReturns, collection_metrics
from ..interface import Exploration
from ..policy_vector import flatten
from .acting_process import POLL, ActingProcess
from .hand_over import FOLDER, HandOver, Weights
from .records import TIMING, cut_episodes, read_usable, seconds_of, timing_metrics

log = logging.getLogger(__name__)


class RealTime(Apart):
    """Takes what an acting process collects, which steps the environment whatever the learner does.

    The process is one of its own. It outlives a learner that is killed, goes on with the last
    policy, and is found again by the next learner of the run. Transition ``n`` of the run is record
    ``n`` of its log, so none can be lost or taken twice.

    Args:
        settings: Of the run.
        environment: Builds the environment; ``cloudpickle`` must be able to send it.
        exploration: Makes the exploration module; the same holds for it.
        run_dir: Where the run writes.

    Raises:
        BlockingIOError: If another trainer learns here.
        RuntimeError: If the process dies. What the environment raises is raised here.
        ValueError: By the first round, if the process's log lacks steps of the run.
    """

    def __init__(
        self,
        settings: TrainerSettings,
        environment: EnvironmentFactory,
        exploration: Exploration,
        run_dir: Path,
    ) -> None:
        self.settings = settings
        self.requests = Requests()  # of this process's environments: evaluations
        self._hand_over = HandOver(run_dir / FOLDER)
        self._hand_over.folder.mkdir(parents=True, exist_ok=True)
        self._recipe = settings, environment, exploration
        self._process = ActingProcess(self._hand_over)
        self._owns = self._stopped = False
        self._seed = first_seed(Stream.TRAINING, settings.seed)
        self._returns = EpisodeReturns(1)
        self._log = TransitionLog(self._hand_over.folder / TRANSITIONS)
        try:
            self._found = self._process.is_found()
            if not self._found:
                self._process.start(self._recipe)
            elif (weights := self._hand_over.new_weights()) is not None:
                self._seed = weights.seed  # its episodes go on as they are
            self.interface, self._authority, self._is_robot = self._process.wait_for("interface")
        except BaseException:
            self.close()
            raise
        self._hand_over.said()  # to whom was there before

    def pass_on(self, request: Request) -> None:
        """Tell the process."""
        self._hand_over.tell(request)

    def release(self) -> None:
        """End a pause here; the process, which is to end as well, leaves the robot where it is."""
        self.requests.take(Request.GO_ON)

    def set_policy(self, policy: TensorDictModuleBase) -> None:
        """Have the process act with ``policy``, from the first collection on."""
        self._policy = policy
        if not self._found:
            self._hand_over.write("policy", copy.deepcopy(policy).cpu())

    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """Give the process the newest weights, and wait for the round to be there."""
        self._require_steps(env_steps)
        if self._stopped:
            self._start_another()
        self._publish(env_steps)
        end = env_steps + self.settings.steps_per_round
        while self._log.refresh() < end:
            self._relay()
            self.requests.check()
            if self._has_made_its_steps():
                self._follow()
                self._publish(env_steps)
            # It may have ended well since.
            if not self._process.runs() and self._log.refresh() < end:
                self._process.require()
            time.sleep(POLL)
        self._relay()
        return self._read(env_steps)

    def recover(self, env_steps: int) -> Metrics:
        """Return metrics of a round that was stored before the run died, from the process's log."""
        self._require_steps(env_steps + self.settings.steps_per_round)
        return self._read(env_steps)[1]

    def _read(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        end = env_steps + self.settings.steps_per_round
        data = read_usable(self._log, env_steps, end, self.interface.kept)
        cut_episodes(data)
        if bool(data[TIMING, "first"][0]):
            self._returns.reset()
        rollout = data.unsqueeze(0)
        values = collection_metrics(rollout, self._authority) | self._returns.metrics(rollout)
        values |= timing_metrics(data, env_steps) | metrics.clock(seconds_of(data))
        return as_stored(rollout, self.interface.kept), values

    @property
    def can_continue(self) -> bool:
        """Return False: a robot is not put back to where it was."""
        return False

    @property
    def recoverable(self) -> int:
        """Up to which step the process's log reaches: a loss of power may leave less of it."""
        return self._log.refresh()

    def start_episode(self, seed: int) -> None:
        """Let a process that was started anew draw other episodes than those in its own log."""
        self._take_over()
        if not self._found:
            self._seed = self._seed_anew()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Have the robot here while the body runs, once the episode under way has ended."""
        priority = self.settings.realtime.priority if self._is_robot else 0
        with self._hand_over.having_robot(), prioritized(priority), super().paused():
            yield

    def forget(self, first: int) -> None:
        """Remove the acting process's records before ``first``, file by file."""
        self._log.forget(first)

    def state_dict(self) -> dict[str, Any]:
        """Return the running returns; all else is in the process's log, on disk from now on."""
        self._log.sync_all()
        return {"returns": self._returns.running}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self._returns.running = state["returns"]

    def stop(self) -> None:
        """Have the process stop the robot and end, unless it is another learner's."""
        if not (self._owns or self._process.is_started_here):
            return
        self._process.end()
        self._owns, self._found, self._stopped = False, False, True

    def close(self) -> None:
        """Stop, and let others learn here."""
        self.stop()
        self._process.release()

    def stop_at_once(self) -> None:
        """Have the process stop the robot and end; it would go on without a learner."""
        if self._owns or self._process.is_started_here:
            self._process.ask_to_end()

    def _require_steps(self, env_steps: int) -> None:
        """Refuse to have the robot make again what the run has made."""
        if (count := self._log.refresh()) < env_steps:
            raise ValueError(
                f"{self._log.folder}: expected the {env_steps} transitions that the run has "
                f"learned from, got {count}; put the folder back, or start a new run"
            )

    def _publish(self, env_steps: int) -> None:
        self._hand_over.publish(Weights(env_steps, self._seed, flatten(self._policy)))

    def _take_over(self) -> None:
        """Have the process go on that an earlier learner left paused; whoever resumes wants it."""
        is_left = self._found and not self._owns and not self.requests.paused
        self._owns = True
        if is_left and self._hand_over.is_paused():
            log.warning("the environment was paused when the learner before ended: it goes on")
            self._hand_over.tell(Request.GO_ON)

    def _has_made_its_steps(self) -> bool:
        """Return whether a process that was found has ended because it was to make no more."""
        if not self._found or self._hand_over.is_alive():
            return False
        settings: TrainerSettings = self._hand_over.read("recipe")[0]
        return self._log.refresh() >= settings.total_steps

    def _follow(self) -> None:
        """Start another process, for the steps by which the run is longer than it was."""
        log.info("the run is longer than the process knew that has driven the environment")
        self._found = False
        self._start_another()

    def _seed_anew(self) -> int:
        """Return a seed of episodes that are none of those in the log."""
        return first_seed(Stream.TRAINING, self.settings.seed, self._log.refresh())

    def _start_another(self) -> None:
        self._seed = self._seed_anew()
        self._process.start(self._recipe)
        self._process.wait_for("interface")
        self.set_policy(self._policy)
        self._stopped = False

    def _relay(self) -> None:
        for line in self._hand_over.said():
            log.warning("%s", line)
