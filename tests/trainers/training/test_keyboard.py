"""Keys in a real terminal, of a real process: what they do, and that the terminal is put back."""

from __future__ import annotations

import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from rrl.trainers.loggers import read_metrics

TESTS = Path(__file__).parents[2]
IN_A_TERMINAL = "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
PROGRAM = """
import logging, sys, time
from functools import partial
import torch
from rrl.algorithms import TD3, mlp, no_exploration
from rrl.controllers import ProportionalController
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings
from rrl.trainers.training.interruption import Interrupted
from toy_envs import RememberingPointMass

class Slow(RememberingPointMass):
    steps = 0
    def _step(self, tensordict):
        time.sleep(0.5 if sys.argv[2] == "takes its time" else 0.02)
        Slow.steps += 1
        if sys.argv[2] == "breaks" and Slow.steps == 60:
            raise RuntimeError("the arm has come off")
        return super()._step(tensordict)

torch.set_num_threads(1)
logging.basicConfig(level=logging.INFO, stream=sys.stdout, format="%(message)s")
settings = {"total_steps": 2000, "warmup_steps": 1000, "steps_per_collection": 20, "batch_size": 32,
            "evaluation": {"every": 0}, "acceptance": {"enabled": False}}
make = lambda num_envs=1: Slow([num_envs])
controller = partial(ProportionalController, gain=10.0, clip=0.5)
factory = EnvironmentFactory(make, controller, ["end_effector_position", "goal"], max_episode_steps=20)
agent = partial(TD3, network=partial(mlp, hidden=[16]), gamma=0.9)
try:
    with Trainer(factory, TrainerSettings(**settings), agent, no_exploration, sys.argv[1]) as trainer:
        trainer.run()
except Interrupted as error:
    sys.exit(128 + error.signal)
"""


class Terminal:
    """A process with a terminal of its own."""

    def __init__(self, folder: Path, how: str = "works") -> None:
        (folder / "program.py").write_text(PROGRAM)
        shutil.copy(TESTS / "toy_envs.py", folder)
        self.run, self.said = folder / "run", ""
        self.end, theirs = pty.openpty()
        command = [
            sys.executable,
            "-c",
            IN_A_TERMINAL,
            str(folder / "program.py"),
            str(self.run),
            how,
        ]
        self.process = subprocess.Popen(
            command,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        self.before = termios.tcgetattr(theirs)
        self.theirs = theirs  # or the terminal would be gone with the process

    def wait_for(self, text: str, seconds: float = 120.0) -> None:
        """Read until it says so."""
        end = time.monotonic() + seconds
        while text not in self.said:
            assert time.monotonic() < end, self.said
            if select.select([self.end], [], [], 0.2)[0]:
                self.said += os.read(self.end, 65536).decode(errors="replace")
            elif self.process.poll() is not None:
                raise AssertionError(self.said)

    def press(self, key: str) -> None:
        os.write(self.end, key.encode())

    def ended(self) -> int:
        """Wait for the end, and return the exit status."""
        end = time.monotonic() + 60
        while self.process.poll() is None:
            assert time.monotonic() < end, self.said
            if select.select([self.end], [], [], 0.1)[0]:
                self.said += os.read(self.end, 65536).decode(errors="replace")
        return self.process.returncode

    @property
    def steps(self) -> int:
        rows = read_metrics(self.run).get("train/reward", [(0, 0.0)])
        return int(rows[-1][0])


@pytest.fixture
def terminal(tmp_path):
    opened = []

    def make(how: str = "works") -> Terminal:
        opened.append(Terminal(tmp_path, how))
        opened[-1].wait_for("keys: space pause, go on; y this one succeeded")
        wait_until(lambda: not line_by_line(opened[-1]))
        return opened[-1]

    yield make
    for each in opened:
        each.process.kill()
        each.process.wait()
        os.close(each.end)
        os.close(each.theirs)


def line_by_line(terminal: Terminal) -> bool:
    """Whether the terminal is as a shell wants it."""
    return bool(termios.tcgetattr(terminal.theirs)[3] & termios.ICANON)


def wait_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_keys_pause_judge_and_stop(terminal):
    opened = terminal()
    opened.press(" ")
    opened.wait_for("a person: pause")
    time.sleep(1.0)  # the round under way does not end
    here = opened.steps
    time.sleep(1.5)  # more than a round of 20 steps of 20 ms
    assert opened.steps == here
    opened.press("x")  # means nothing
    opened.press("y")
    opened.wait_for("a person: this one succeeded")
    opened.press("r")
    opened.wait_for("a person: repeat the same start")
    opened.press(" ")
    opened.wait_for("a person: go on")
    wait_until(lambda: opened.steps > here)
    opened.press("n")
    opened.wait_for("a person: this one failed")
    wait_until(lambda: "train/success" in read_metrics(opened.run))
    opened.press("q")
    assert opened.ended() == 128 + signal.SIGINT
    assert termios.tcgetattr(opened.theirs) == opened.before
    assert list((opened.run / "checkpoints").iterdir())


@pytest.mark.parametrize(
    ("how", "signals", "status"),
    [
        ("works", [signal.SIGTERM], 128 + signal.SIGTERM),
        pytest.param(
            *("takes its time", [signal.SIGTERM, signal.SIGTERM], -signal.SIGTERM),
            marks=pytest.mark.slow,
        ),
        pytest.param(*("works", [signal.SIGINT], 128 + signal.SIGINT), marks=pytest.mark.slow),
        ("breaks", [], 1),
    ],
)
def test_whatever_ends_it_the_terminal_is_put_back(terminal, how, signals, status):
    opened = terminal(how)
    for n, number in enumerate(signals):
        if n:
            opened.wait_for("finishing this round")  # it has heard the one before
        opened.process.send_signal(number)
    assert opened.ended() == status
    assert termios.tcgetattr(opened.theirs) == opened.before


def test_ctrl_c_stays_what_it_is(terminal):
    opened = terminal()
    opened.press("\x03")
    assert opened.ended() == 128 + signal.SIGINT
    assert termios.tcgetattr(opened.theirs) == opened.before


@pytest.mark.slow
def test_without_a_terminal_there_are_no_keys(tmp_path):
    shutil.copy(TESTS / "toy_envs.py", tmp_path)
    (tmp_path / "program.py").write_text(PROGRAM.replace('"total_steps": 2000', '"total_steps": 0'))
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py", tmp_path / "run", "works"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert "episodes on the environment" in done.stdout
    assert "keys:" not in done.stdout
