"""The output goes away or cannot show what is written: training goes on and saves."""

import io
import os
import pty
import signal
import subprocess
import time

import pytest

from rrl.trainers.console import Output
from situation_commands import LONG, RRL, SMALL, checkpoints, environment, shell, wait_for_training

ASCII = {
    "LC_ALL": "C",
    "PYTHONUTF8": "0",
    "PYTHONCOERCECLOCALE": "0",
    "PYTHONIOENCODING": "",
}
REDIRECTED = {
    "a reader that leaves": "{ rrl train $SMALL hydra.run.dir=run; echo $? > rc; } | head -n 1",
    "a full device": "rrl train $SMALL hydra.run.dir=run > /dev/full; echo $? > rc",
    "all closed": "rrl train $SMALL hydra.run.dir=run <&- >&- 2>&-; echo $? > rc",
}


def finished(run):
    assert checkpoints(run) == [50, 100]
    for name in ("results.json", "report.html"):
        assert (run / name).stat().st_size > 0


def test_nothing_is_wrapped_where_there_is_no_terminal():
    """A file, or a pipe to grep: a line stays a line, whatever it is printed with."""
    file, text = io.StringIO(), "word " * 50
    output = Output(file=file)
    output.print(text)
    output.say(text)
    assert [line.rstrip() for line in file.getvalue().splitlines()] == [text.rstrip()] * 2


def test_no_file_gets_the_number_of_a_closed_stream(tmp_path):
    """A library that writes to standard output by its number does not write into a run's file."""
    code = """
import os
from rrl.trainers.console import durable_output
with durable_output(), open("file", "w"):
    os.write(1, b"to standard output")
    os.write(2, b"to standard error")
    print("printed")
"""
    result = shell('python -c "$CODE" <&- >&- 2>&-', tmp_path, CODE=code)
    assert result.returncode == 0
    assert (tmp_path / "file").read_text() == ""


@pytest.mark.slow
@pytest.mark.parametrize("how", REDIRECTED)
def test_training_goes_on_without_its_output(tmp_path, how):
    result = shell(REDIRECTED[how], tmp_path, SMALL=" ".join(SMALL))
    assert (tmp_path / "rc").read_text() == "0\n", result.stderr
    finished(tmp_path / "run")
    log = tmp_path / "run/log.txt"
    if how != "all closed":
        text = log.read_text()
        assert text.count("the output cannot be written") == 1
        assert f"  {tmp_path / 'run/report.html'}\n" in text
    assert result.stderr == b""


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["plain", "ünï→", os.fsdecode(b"caf\xe9")])
def test_a_terminal_without_unicode(tmp_path, folder):
    home = tmp_path / folder
    home.mkdir()
    script = "rrl train $SMALL && for run in outputs/*/*; do rrl evaluate run=$run; done"
    result = shell(script, home, SMALL=" ".join(SMALL), **ASCII)
    assert result.returncode == 0, result.stderr
    (run,) = home.glob("outputs/*/*")
    finished(run)
    assert b"\n  " + os.fsencode(run / "report.html") + b"\n" in result.stdout
    assert b"residual" in result.stdout
    assert b"| misaligned " in result.stdout  # tables have frames of ASCII
    assert result.stderr == b""


def on_a_terminal(arguments, cwd, columns=40):
    """Start a command whose output is a terminal of its own; returns process and terminal."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*RRL, *arguments],
        cwd=cwd,
        env=environment(COLUMNS=str(columns), TERM="xterm"),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    return process, ours


def read_all(terminal):
    """What was printed, until the terminal's last process ends."""
    parts = []
    while True:
        try:
            part = os.read(terminal, 65536)
        except OSError:
            break
        if not part:
            break
        parts.append(part)
    return b"".join(parts)


@pytest.mark.slow
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_the_terminal_goes_away(tmp_path, monkeypatch, unbuffered):
    """As when ssh loses its connection: the terminal is gone, and SIGHUP comes."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    process, terminal = on_a_terminal(["train", *LONG, "hydra.run.dir=run"], tmp_path)
    try:
        run = tmp_path / "run"
        metrics = run / "metrics.csv"
        while not metrics.exists() or "train/reward" not in metrics.read_text():
            os.read(terminal, 65536)
    finally:
        os.close(terminal)
        process.send_signal(signal.SIGHUP)
    assert process.wait(100) == 128 + signal.SIGHUP
    assert checkpoints(run)[-1] > 0
    text = (run / "log.txt").read_text()
    assert "SIGHUP: finishing this round and saving" in text
    assert f"cd {tmp_path} && rrl train resume={run}" in text


@pytest.mark.slow
def test_nothing_to_copy_is_broken_on_a_narrow_terminal(tmp_path):
    home = tmp_path / "a folder with a name that is longer than the terminal is wide"
    home.mkdir()
    process, terminal = on_a_terminal(["train", *SMALL], home, columns=30)
    text = read_all(terminal)
    assert process.wait(10) == 0, text
    (run,) = home.glob("outputs/*/*")
    for name in ("report.html", "config.yaml"):
        assert os.fsencode(run / name) in text


@pytest.mark.slow
def test_below_nohup_it_stays(tmp_path):
    command = ["nohup", *RRL, "train", *LONG, "hydra.run.dir=run"]
    with subprocess.Popen(
        command,
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        run = wait_for_training(tmp_path, process)
        process.send_signal(signal.SIGHUP)
        time.sleep(1)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.wait(100) == 128 + signal.SIGTERM
    assert checkpoints(run)[-1] > 0
