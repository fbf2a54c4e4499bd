"""Threads and precision are what the settings say."""

import os
import subprocess
import sys

import pytest
import torch

from rrl.trainers.training.torch_setup import configure_torch


@pytest.fixture(autouse=True)
def _restore():
    before = torch.get_float32_matmul_precision()
    yield
    torch.set_float32_matmul_precision(before)


def test_torchs_precision_is_what_was_asked_for(settings):
    configure_torch(settings(matmul_precision="high"))
    assert torch.get_float32_matmul_precision() == "high"


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_are_one_unless_told(monkeypatch, settings, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    configure_torch(settings(**({} if threads == 1 else {"threads": threads})))
    assert torch.get_num_threads() == threads


@pytest.mark.slow
def test_a_run_with_two_threads_can_be_made_again(tmp_path):
    """The same configuration twice, each in a process of its own: the same transitions to the last bit."""
    logs = []
    for name in ("first", "second"):
        arguments = [
            "trainer.total_steps=450",
            "trainer.threads=2",
            "logger=[csv]",
        ]
        small = [
            "trainer.evaluation.every=0",
            "trainer.evaluation.final_episodes=2",
            "trainer.acceptance.enabled=false",
            "render.enabled=false",
        ]
        command = [
            sys.executable,
            "-m",
            "rrl.trainers",
            "train",
            *arguments,
            *small,
            f"hydra.run.dir={tmp_path / name}",
        ]
        subprocess.run(
            command, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "2"}
        )
        logs.append(
            b"".join(
                path.read_bytes()
                for path in sorted((tmp_path / name / "transitions").glob("*.bin"))
            )
        )
    assert logs[0]
    assert logs[0] == logs[1]
