"""The acting process, which the learner starts: ``python -m rrl.trainers.training.realtime``."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

from rrl.pace import Pace, prioritize

from ...entry_checks import check_period
from ...environment import EnvironmentFactory
from ...errors import packed
from ...requests import stand_still, stop_of
from ...resumable_env import ResumableEnv
from ...settings import TrainerSettings
from ...storage.files import lock
from ...storage.transition_log import FOLDER as TRANSITIONS
from ...storage.transition_log import TransitionLog
from ..collection_metrics import Authority
from ..interface import prepare
from ..torch_setup import configure_torch
from .acting import Acting
from .ending import Ending
from .hand_over import HandOver
from .records import record_bytes

log = logging.getLogger("rrl.trainers.training.realtime")  # __name__ is __main__

CLAIM_SECONDS = 2.0


def _act(hand_over: HandOver, learner: int) -> None:
    """Build what acts, and let it act until the end."""
    ending = Ending()
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, ending.ask)
    settings, environment, exploration = hand_over.read("recipe")
    before = TransitionLog(hand_over.folder / TRANSITIONS).count
    configure_torch(settings, collects_only=True, env_steps=before)
    env, interface, explore = prepare(settings, environment, exploration)
    try:
        in_memory, stored = interface.room
        interface = replace(interface, room=(in_memory, stored + record_bytes(env)))
        pace = _pace(settings, environment, env)
        is_robot = stop_of(env) is not None
        hand_over.write("interface", (interface, Authority.of(env), is_robot))
        while not hand_over.has_weights():
            if ending.is_asked or os.getppid() != learner:
                return  # there is nobody any more who would send some
            time.sleep(0.01)
        policy = hand_over.read("policy")
        acting = Acting(settings, env, policy, explore, pace, hand_over, ending)
        prioritize(settings.realtime.priority)
        gc.collect()
        gc.freeze()
        try:
            acting.run()
        finally:
            stand_still(env)
            acting.thread.close()
    finally:
        env.close()


def _pace(settings: TrainerSettings, environment: EnvironmentFactory, env: ResumableEnv) -> Pace:
    """Return the environment's own pace, or one to keep for it."""
    wanted = settings.realtime.period
    own: Pace | None = getattr(env.base_env, "pace", None)
    known = environment.control_period or getattr(env.base_env, "control_period", None)
    if own is None:
        if (period := wanted or known) is None:
            raise ValueError(
                "trainer.realtime.period: expected a number of seconds, because the environment "
                "does not say its control period, got null"
            )
        if stop_of(env) is not None:
            log.warning(
                "the robot keeps no pace of its own: in evaluations nothing but its own step makes "
                "it wait; let its step wait by an attribute pace (rrl.pace.Pace), as RobotEnv does"
            )
        return Pace(period)
    check_period(env.base_env, wanted, "trainer.realtime.period")
    return own


def _claim(folder: Path) -> int:
    """Claim the folder; a learner that looks whether somebody has may hold it for a moment."""
    ends = time.monotonic() + CLAIM_SECONDS
    while True:
        try:
            return lock(folder)
        except BlockingIOError:
            if time.monotonic() > ends:
                raise
        time.sleep(0.01)


def main(folder: str, learner: int) -> int:
    """Act for the learner of that process id; return the exit status."""
    logging.basicConfig(format="%(message)s")
    logging.getLogger("rrl").setLevel(logging.INFO)
    warnings.simplefilter("ignore")  # the run itself has said them
    hand_over = HandOver(Path(folder))
    claimed = _claim(hand_over.folder)
    (hand_over.folder / "pid").write_text(str(os.getpid()))
    try:
        _act(hand_over, learner)
    except Exception as error:
        hand_over.write("failure", packed(error))
        log.exception("the acting process ends")
        return 1
    finally:
        os.close(claimed)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
