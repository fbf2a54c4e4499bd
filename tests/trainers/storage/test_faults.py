"""What goes wrong on a real machine: killed, stopped, full, read-only, broken loggers, numbers that are none."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from rrl.algorithms import TD3, mlp
from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.loggers import read_metrics
from rrl.trainers.training.interruption import Interrupted
from toy_envs import PointMass

ROOT = Path(__file__).parents[3]
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small file system needs root")


def at_step(trainer, env_steps, action):
    """Call ``action`` right before the round that starts at ``env_steps``."""
    original = trainer._round

    def hooked():
        if trainer.env_steps == env_steps:
            action()
        original()

    trainer._round = hooked


def agents_equal(one, other):
    expected, actual = one.agent.state_dict(), other.agent.state_dict()
    return all(
        torch.equal(v, actual[k]) for k, v in expected.items() if isinstance(v, torch.Tensor)
    )


def test_sigkill_at_random_moments_loses_nothing(tmp_path):
    """The quick form of ``make faults``: the real command, killed five times."""
    script = [
        sys.executable,
        "-W",
        "ignore",
        ROOT / "benchmarks/faults.py",
        "--kills",
        "5",
        "--steps",
        "160",
        "--out",
        tmp_path,
    ]
    result = subprocess.run(script, capture_output=True, text=True, cwd=tmp_path, timeout=280)
    assert result.returncode == 0, result.stdout + result.stderr
    assert json.loads(result.stdout.splitlines()[-3]) == {"kills": 5, "lost": 0, "same": True}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_finishes_the_round_and_saves(make_trainer, number, caplog):
    whole = make_trainer("whole")
    whole.run()
    trainer = make_trainer()
    before = signal.getsignal(number)
    at_step(trainer, 120, lambda: os.kill(os.getpid(), number))
    with pytest.raises(Interrupted) as stopped:
        trainer.run()
    trainer.close()
    assert stopped.value.signal == number
    assert signal.getsignal(number) == before
    assert f"{signal.Signals(number).name}: finishing this round and saving" in caplog.text
    resumed = make_trainer()
    assert resumed.resume().name == "checkpoint-000000000140"
    resumed.close()
    whole.close()


def test_the_second_signal_ends_the_process_at_once():
    script = (
        "import os, signal\nfrom rrl.trainers.training.interruption import Interruption\n"
        "with Interruption().listening():\n"
        "    for _ in range(2):\n        os.kill(os.getpid(), signal.SIGINT)\n"
        "    print('still there')"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60
    )
    assert result.returncode == -signal.SIGINT
    assert "still there" not in result.stdout


def start(*arguments):
    """``rrl train`` in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "rrl.trainers", "train", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


@pytest.mark.slow
def test_the_command_prints_how_to_go_on(tmp_path):
    run = tmp_path / "the run"
    quick = [
        "logger=csv",
        "env=insertion-sim",
        "algorithm=td3",
        "algorithm.agent.network.hidden=[8]",
        "trainer.evaluation.every=0",
    ]
    with start(f"hydra.run.dir='{run}'", *quick, "trainer.evaluation.episodes=1") as process:
        metrics = run / "metrics.csv"
        while process.poll() is None and not (
            metrics.exists() and "train/reward" in metrics.read_text()
        ):
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM, errors
    assert f"rrl train 'resume={run}'" in output
    assert "SIGTERM: finishing this round and saving" in output + errors
    assert "Traceback" not in output + errors
    assert len(list(run.glob("checkpoints/checkpoint-*"))) == 2


@needs_root
def test_a_full_disk_stops_the_run_and_costs_nothing(make_trainer, simulated, small_disk):
    make = partial(make_trainer, environment=simulated, total_steps=300)
    whole = make("whole")
    whole.run()
    trainer = make(small_disk / "run")
    ballast = small_disk / "ballast"

    def fill():
        free = os.statvfs(small_disk)
        ballast.write_bytes(bytes(free.f_bavail * free.f_frsize))

    at_step(trainer, 140, fill)
    with pytest.raises(OSError, match=r"(?i)no space left|cannot write checkpoint"):
        trainer.run()
    trainer.close()
    ballast.unlink()
    resumed = make(small_disk / "run")
    resumed.resume()
    resumed.run()
    assert agents_equal(whole, resumed)
    assert (whole.replay.storage[:] == resumed.replay.storage[:]).all()
    whole.close()
    resumed.close()


def test_physics_that_diverges_ends_the_episode_and_is_counted(make_trainer):
    environment = EnvironmentFactory(
        base=partial(InsertionEnv, variant="sim"),
        controller=partial(ProportionalController, gain=0.5, clip=0.5, unit=0.02),
        inputs={"blocks": Input(scale=5.0), "goal": Input()},
        max_episode_steps=50,
    )
    trainer = make_trainer(environment=environment, num_envs=2, total_steps=100, warmup_steps=40)

    def poison():
        trainer.collection.env.base_env._simulation.state[1, 3] = float("nan")

    at_step(trainer, 60, poison)
    trainer.run()
    trainer.close()
    diverged = read_metrics(trainer.run_dir)["train/diverged"]
    assert [count for _, count in diverged] == [0, 0, 0, 1, 0]
    stored = trainer.replay.storage[:]
    assert all(value.isfinite().all() for value in stored.values(True, True))


class BadSensor(PointMass):
    """Gives a number that is none, once."""

    broken = False

    def _observe(self):
        out = super()._observe()
        return {**out, "goal": out["goal"] * float("nan")} if self.broken else out


def test_what_is_not_finite_is_not_stored(make_trainer, factory):
    trainer = make_trainer(
        environment=replace(factory, base=lambda num_envs=1: BadSensor([num_envs]))
    )
    at_step(trainer, 60, lambda: setattr(trainer.collection.env.base_env, "broken", True))
    with pytest.raises(
        FloatingPointError,
        match=r"goal: expected finite numbers, got NaN or infinity in 11 steps",
    ):
        trainer.run()
    stored = trainer.store.newest()
    assert trainer.store.log.count == 60
    assert all(value.isfinite().all() for value in stored.values(True, True))
    trainer.close()


class Exploding(TD3):
    """Its losses are not finite from the 50th update on."""

    def update(self, batches):
        losses = super().update(batches)
        return {name: value / (self.num_updates < 50) for name, value in losses.items()}


def test_a_diverged_learner_stops_with_its_last_good_checkpoint(make_trainer, settings):
    agent = partial(Exploding, network=partial(mlp, hidden=[8]))
    trainer = make_trainer(agent=agent, total_steps=300)
    with pytest.raises(
        FloatingPointError, match="the update gave numbers that are not finite in loss_critic"
    ):
        trainer.run()
    trainer.close()
    resumed = make_trainer(total_steps=300, agent=agent)
    assert resumed.resume().name == "checkpoint-000000000100"
    assert all(p.isfinite().all() for p in resumed.agent.parameters())
    resumed.close()


@pytest.mark.slow  # starting worker processes takes its time
def test_a_dead_collection_worker_ends_the_run_and_it_is_resumed(make_trainer, factory):
    environment = replace(factory, base=partial(PointMass, []), batching="parallel")
    before = set(multiprocessing.active_children())  # of other tests
    trainer = make_trainer(environment=environment, num_envs=2)

    def kill_workers():
        for worker in set(multiprocessing.active_children()) - before:
            worker.kill()
            worker.join()  # before the next step, not in it

    at_step(trainer, 120, kill_workers)
    expected = r"^environment: it left no word, .*worker \d \(exit code -9\).*the newest checkpoint"
    with pytest.raises(RuntimeError, match=expected):
        trainer.run()
    trainer.close()
    resumed = make_trainer(environment=environment, num_envs=2)
    resumed.resume()
    assert (resumed.env_steps, resumed.store.pending) == (100, 20)
    resumed.run()
    assert resumed.env_steps == 200
    resumed.close()
