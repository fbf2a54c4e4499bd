"""The command line as a user has it: a subprocess, its exit status, what it prints and leaves behind."""

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import wandb_file
from rrl.deploy import Policy

SMALL = [
    "trainer.total_steps=100",
    "trainer.warmup_steps=50",
    "algorithm=td3",
    "algorithm.agent.network.hidden=[16,16]",
    "trainer.batch_size=16",
    "trainer.evaluation.every=50",
    "trainer.evaluation.episodes=2",
    "trainer.evaluation.final_episodes=3",
    "trainer.evaluation.slots=3",
    "trainer.acceptance.episodes=3",
    "trainer.checkpoint.every=50",
]


def rrl(*arguments, cwd, **variables):
    return subprocess.run(
        [sys.executable, "-m", "rrl.trainers", *arguments],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1", **variables},
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A short run: the directory it was started in, and what the command printed."""
    cwd = tmp_path_factory.mktemp("user")
    result = rrl("train", *SMALL, cwd=cwd)
    assert result.returncode == 0, result.stderr
    return next(cwd.glob("outputs/*/*")), result


def test_training_leaves_table_curve_metrics_and_checkpoints(trained):
    run_dir, result = trained
    assert "misaligned" in result.stdout
    assert "aligned" in result.stdout
    assert "acceptance: at most 12 episodes in 2 evaluations" in result.stdout
    assert "Handed over: the controller alone. No policy passed the test" in result.stdout
    for name in (
        "config.yaml",
        "metrics.csv",
        "results.json",
        "results.md",
        "learning_curve.png",
        "learning_curve.svg",
        "report.html",
        "versions.json",
    ):
        assert (run_dir / name).stat().st_size > 0, name
    assert len(list((run_dir / "checkpoints").iterdir())) == 2
    assert list((run_dir / "tensorboard").iterdir())
    assert list((run_dir / "wandb").glob("offline-run-*/*.wandb"))
    results = json.loads((run_dir / "results.json").read_text())
    assert set(results) == {"misaligned", "aligned"}
    assert set(results["aligned"]) == {"summary", "episodes"}
    assert not result.stderr.strip(), result.stderr


def test_weights_and_biases_hold_the_whole_run(trained):
    """Read from the offline run's own files: what the server would be sent."""
    run_dir, _ = trained
    run = wandb_file.read(next(run_dir.glob("wandb/offline-run-*")))
    assert (run.run.project, run.run.job_type) == ("rrl", "residual")
    assert run.run.run_group == run_dir.name
    assert list(run.run.tags) == ["insertion-gentle", "residual"]
    assert run.run.display_name == "insertion-gentle-residual"
    assert run.config["versions"]["torchrl"] == version("torchrl")
    assert [(m.glob_name, m.step_metric) for m in run.metrics if m.step_metric] == [
        ("*", "env_steps")
    ]
    assert all("env_steps" in row for row in run.history)
    for name in (
        "action/residual_share",
        "action/clip_fraction",
        "eval/misaligned/metrics/contact_force",
        "eval/misaligned/rescues",
        "eval/misaligned/regressions",
        "loss/loss_critic",
    ):
        steps = [row["env_steps"] for row in run.rows(name)]
        assert steps == sorted(steps), name
        assert steps[-1] == 100, name
    sections = {
        name.split("/")[0] for row in run.history for name in row if not name.startswith("_")
    }
    assert sections == {
        "env_steps", "train", "action", "loss", "eval", "final", "safety", "time", "media", "results",
        "acceptance", "clock", "constraint",
    }  # fmt: skip


def test_weights_and_biases_hold_videos_and_tables(trained):
    run_dir, _ = trained
    run = wandb_file.read(next(run_dir.glob("wandb/offline-run-*")))
    for name, kind in (
        ("media/video", "video-file"),
        ("media/learning_curve", "image-file"),
        ("results/success", "table-file"),
        ("results/episodes", "table-file"),
    ):
        (row,) = run.rows(f"{name}/_type")
        assert row[f"{name}/_type"] == kind
        assert (run.folder / "files" / row[f"{name}/path"]).stat().st_size > 0
    (row,) = run.rows("results/episodes/path")
    table = json.loads((run.folder / "files" / row["results/episodes/path"]).read_text())
    episodes = [dict(zip(table["columns"], row, strict=True)) for row in table["data"]]
    results = json.loads((run_dir / "results.json").read_text())
    for scenario, record in results.items():
        returns = [e for e in episodes if (e["scenario"], e["entry"]) == (scenario, "return")]
        assert [e["residual"] for e in returns] == pytest.approx(record["episodes"]["return"])
        rescued = sum(e["outcome"] == "rescued" for e in returns)
        assert rescued == record["summary"]["rescues"]


def test_evaluate_repeats_the_final_evaluation(trained):
    run_dir, _ = trained
    before = (run_dir / "results.json").read_text()
    result = rrl("evaluate", f"run={run_dir}", cwd=run_dir.parent)
    assert result.returncode == 0, result.stderr
    assert (run_dir / "results.json").read_text() == before


def test_export_leaves_what_a_robot_needs(trained):
    run_dir, _ = trained
    result = rrl("export", f"run={run_dir}", cwd=run_dir.parent)
    assert result.returncode == 0, result.stderr
    assert "at 20 Hz" in result.stdout
    assert "left out, because a robot has its own: " in result.stdout
    policy = Policy(run_dir / "export", rate=20.0)
    entries = {e.name: np.zeros(e.shape) for e in policy.contract.entries}
    assert policy.act(entries).shape == (3,)
    content = policy.contract.content
    assert content["trained"]["checkpoint"] == "checkpoint-000000000100"
    assert content["trained"]["seed"] == 0
    assert content["trained"]["versions"]["rrl"] == version("rrl")
    results = json.loads((run_dir / "results.json").read_text())
    assert content["results"].keys() == results.keys() == {"misaligned", "aligned"}
    for scenario, summary in content["results"].items():
        assert summary["success"] == results[scenario]["summary"]["success"]


def test_resume_continues_to_the_new_end(trained):
    run_dir, _ = trained
    result = rrl(
        "train",
        f"resume={run_dir}",
        "trainer.total_steps=150",
        "render.enabled=false",
        cwd=run_dir.parent,
    )
    assert result.returncode == 0, result.stderr
    assert "checkpoint-000000000100" in result.stdout.replace("\n", "")
    steps = {
        int(line.split(",")[0]) for line in (run_dir / "metrics.csv").read_text().splitlines()[1:]
    }
    assert steps == {0, 50, 100, 150}
    ids = {path.name.rsplit("-", 1)[1] for path in run_dir.glob("wandb/offline-run-*")}
    assert ids == {(run_dir / "wandb_id").read_text()}
    events = EventAccumulator(str(run_dir / "tensorboard")).Reload()
    assert [event.step for event in events.Scalars("train/reward")] == [50, 100, 150]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trian"], "got 'trian'"),
        (["train", "trainer.sede=3"], "sede"),
        pytest.param(
            ["train", "trainer.num_seeds=-1"], "trainer.num_seeds", marks=pytest.mark.slow
        ),
        (["train", "trainer.total_steps=300", "trainer.warmup_steps=300"], "nothing is learned"),
        (["train", "env=insertion-mars"], "insertion-mars"),
        (["train", "+algorithm.agent.learning_rate=0.1"], "does not take 'learning_rate'"),
        pytest.param(["train", "+env.base.clearence=0.1"], "clearance", marks=pytest.mark.slow),
        pytest.param(
            ["train", "env.base._target_=nowhere.Env"], "nowhere.Env", marks=pytest.mark.slow
        ),
        (["evaluate"], "expected run=DIRECTORY"),
        (["evaluate", "run=missing"], "no config.yaml"),
    ],
)
def test_a_bad_call_ends_with_one_clear_message(arguments, message, tmp_path):
    result = rrl(*arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert message in result.stderr.replace("\n", " ")
    assert "Traceback" not in result.stderr
    assert not Path(tmp_path, "wandb").exists()


def test_help_comes_without_a_configuration(tmp_path):
    result = rrl("--help", cwd=tmp_path)
    assert result.returncode == 0
    assert "rrl train" in result.stdout
