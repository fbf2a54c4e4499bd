"""The command line: ``rrl COMMAND``, with Hydra's overrides."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from rrl.signals import raised_as_exits

from ..console import DurableStream, Output, durable_output, from_here
from ..errors import message
from ..storage.run_files import CONFIG_FILE, LOG, REPORT

if TYPE_CHECKING:
    from .compose import Composed

USAGE = """usage: rrl COMMAND [key=value ...]

  rrl train [key=value ...]             train on the configuration, end with table, curve and video
  rrl train trainer.num_seeds=5 ...     the same for five seeds, each a run of its own
  rrl train resume=RUN [key=value ...]  continue a run, or the seeds of one
  rrl evaluate run=RUN [key=value ...]  evaluate it again, into evaluation-TIME.json
  rrl render run=RUN [key=value ...]    write a video of controller and residual on one episode
  rrl export run=RUN [key=value ...]    write what a robot needs into RUN/export: graph and contract
  rrl report RUN... [out=FILE]          write one interactive page about runs, side by side
  rrl dashboard entity=USER [project=P] lay out the W&B workspace (extra: dashboard)
  rrl reproduce [NAME ...] [key=value]  make the paper's experiments again, all or those named;
                                        scale=quick|paper seeds=N launcher=local|ray workers=N
                                        out=FOLDER data=FOLDER
  rrl new NAME                          make a project with environment, controller, configuration

RUN is a run's directory. Keys and groups: rrl train --help; all of it: rrl train --cfg job.
Packages and a folder configs/ of the working directory are found: env=mine reads
configs/env/mine.yaml, and a file there comes before ours of the same name. Set RRL_TRACEBACK=1 to
see where an error comes from.

Ctrl-C, SIGTERM and SIGHUP finish a training's round, save and print how to go on; a second one ends
the process at once. A robot is told to stop, whatever the command.
Exit status: 0 done, 2 an error (one message on stderr), 128 + n stopped by signal n.
"""

COMMANDS = ("train", "evaluate", "render", "export", "report", "dashboard", "reproduce", "new")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the entry point of ``rrl``.

    Returns:
        The exit status.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    with durable_output(), raised_as_exits():
        if not arguments or arguments[0] in ("-h", "--help", "help"):
            print(USAGE)
            return 0
        command, rest = arguments[0], arguments[1:]
        try:
            if command not in COMMANDS:
                raise ValueError(f"command: expected one of {', '.join(COMMANDS)}, got {command!r}")
            if command in WITHOUT_CONFIGURATION and {"-h", "--help"} & set(rest):
                print(USAGE)
                return 0
            _configure_messages()
            WITHOUT_CONFIGURATION.get(command, lambda rest: _configured(command, rest))(rest)
        except KeyboardInterrupt:
            return 128 + signal.SIGINT
        except Exception as error:
            if stopped_by := getattr(error, "signal", None):
                return 128 + int(stopped_by)
            if os.environ.get("RRL_TRACEBACK"):
                raise
            Output(stderr=True).say(f"rrl {command}: {message(error)}", style="red")
            return 2
        return 0


def as_path(text: str) -> Path:
    """Return the absolute path of an argument; ``~`` is the home unless a file is called so."""
    path = Path(text)
    if not path.exists() and text.startswith("~"):
        path = Path(os.path.expanduser(text))  # noqa: PTH111 - Path's raises for unknown users
    return path.resolve()


def new_directory(path: Path) -> Path:
    """Make a directory that was not there: ``path``, or with -1, -2 ... at its end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for number in count():
        candidate = path.with_name(f"{path.name}-{number}") if number else path
        try:
            candidate.mkdir()
        except FileExistsError:
            continue
        return candidate
    raise AssertionError


def _configured(command: str, arguments: list[str]) -> None:
    """Run a command that reads a configuration: train, evaluate, render, export."""
    from .compose import compose_train, through_hydra

    run_dir, rest = _split_run(command, arguments)

    def perform(composed: Composed) -> None:
        _perform(command, composed, resume=run_dir is not None)

    if any(argument.startswith("-") for argument in rest):
        through_hydra(rest, run_dir, perform)
    else:
        perform(compose_train(rest, run_dir))


def _split_run(command: str, arguments: list[str]) -> tuple[Path | None, list[str]]:
    """Take ``resume=`` or ``run=`` out of the arguments."""
    key = "resume" if command == "train" else "run"
    named, rest = _split(arguments, (key,))
    if command != "train" and not named and not any(a.startswith("-") for a in rest):
        raise ValueError(f"run: expected run=DIRECTORY of a training run, got {rest}")
    if not named:
        return None, rest
    run_dir = as_path(named[key])
    if not (run_dir / CONFIG_FILE).is_file():
        raise FileNotFoundError(
            f"{key}={named[key]}: expected the directory of a training run, "
            f"got no {CONFIG_FILE} in {run_dir}"
        )
    return run_dir, rest


def _split(
    arguments: Sequence[str], known: Sequence[str] | None = None
) -> tuple[dict[str, str], list[str]]:
    """Take ``key=value`` out of the arguments: of the ``known`` keys, or of any."""
    named, rest = {}, []
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and (known is None or key in known):
            named[key] = value
        else:
            rest.append(argument)
    return named, rest


def _perform(command: str, composed: Composed, *, resume: bool) -> None:
    # Here, because they import torch: help and usage errors come at once.
    from .evaluate import evaluate, render
    from .export import export
    from .train import train

    console, config, run_dir = Output(), composed.config, composed.run_dir
    for path in composed.replaced:
        console.say(f"reading {path.relative_to(Path.cwd())} of this project instead of rrl's own")
    if command != "train":
        DurableStream.log = run_dir / LOG
        {"evaluate": evaluate, "render": render, "export": export}[command](
            config, run_dir, console
        )
        return
    run_dir = run_dir if composed.chosen else new_directory(run_dir)
    DurableStream.log = run_dir / LOG
    try:
        train(config, run_dir, console, resume=resume)
    except Exception:
        if run_dir.is_dir() and not any(run_dir.iterdir()):
            run_dir.rmdir()
        raise


def _new(arguments: list[str]) -> None:
    from .new import create

    if len(arguments) != 1:
        raise ValueError(f"name: expected one, rrl new NAME, got {arguments}")
    name, console = arguments[0], Output()
    for path in create(name, Path.cwd()):
        console.say(f"  {path.relative_to(Path.cwd())}")
    console.say(f"\ncd {name} && rrl train env={name} controller={name}")


def _report(arguments: list[str]) -> None:
    from ..report.report import write_report
    from ..report.runs import find_runs

    chosen, rest = _split(arguments, ("out",))
    named = [as_path(argument) for argument in rest]
    if not named or any("=" in given and not as_path(given).exists() for given in rest):
        raise ValueError(
            f"runs: expected their directories, rrl report RUN... [out=FILE], got {arguments}"
        )
    folder = named[0] if len(named) == 1 and (named[0] / CONFIG_FILE).is_file() else Path.cwd()
    out = as_path(chosen["out"]) if chosen else folder / REPORT
    Output().say(f"  {write_report(find_runs(named), out)}")


def _dashboard(arguments: list[str]) -> None:
    from ..report.dashboard import build

    named, rest = _split(arguments, ("entity", "project"))
    if "entity" not in named or rest:
        raise ValueError(
            "entity: expected your W&B user or team, rrl dashboard entity=USER [project=rrl], "
            f"got {arguments}"
        )
    Output().say(f"  {build(**named).save().url}")


def _reproduce(arguments: list[str]) -> None:
    from ..experiments.reproduce import reproduce
    from .compose import CONFIGS, OURS, compose

    given, names = _split(arguments)
    paths = ("out", "data")
    plain = {key for key in given if key in paths and given[key] != "null"}
    changes = {k: value if k in plain else yaml.safe_load(value) for k, value in given.items()}
    folders = [folder for folder in (Path.cwd() / CONFIGS, OURS) if folder.is_dir()]
    again = from_here("rrl", "reproduce", *arguments)
    reproduce(names, changes, compose, folders, Output(), again)


WITHOUT_CONFIGURATION: dict[str, Callable[[list[str]], None]] = {
    "new": _new,
    "report": _report,
    "dashboard": _dashboard,
    "reproduce": _reproduce,
}


class _Printed(logging.Handler):
    """Prints log messages, so that they pass through a progress bar and not across it."""

    def emit(self, record: logging.LogRecord) -> None:
        print(self.format(record))


def _configure_messages() -> None:
    """Show warnings of all libraries, and what takes long of ours."""
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
    logging.getLogger("rrl").setLevel(logging.INFO)
    root = logging.getLogger()
    if not root.handlers:
        root.addHandler(_Printed())
