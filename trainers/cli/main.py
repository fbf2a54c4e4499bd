"""The command line: ``rrl train``, ``rrl evaluate``, ``rrl render``, with Hydra's overrides."""

from __future__ import annotations

import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import hydra
import yaml
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from ..storage.run_files import CONFIG_FILE, REPORT

USAGE = """usage: rrl COMMAND [key=value ...]

  rrl train [key=value ...]             train on the configuration, end with table, curve and video
  rrl train resume=RUN [key=value ...]  continue a run from its newest checkpoint
  rrl evaluate run=RUN [key=value ...]  evaluate a run's newest checkpoint on frozen episodes
  rrl render run=RUN [key=value ...]    write a video of controller and residual on one episode
  rrl report RUN... [out=FILE]          write one interactive page about a run, or about several side by side
  rrl dashboard entity=USER [project=P] lay out the W&B workspace (extra rrl[dashboard], after wandb login)
  rrl reproduce [NAME ...] [key=value]  make the paper's experiments again, all or those named (configs/experiment/);
                                        scale=quick|paper launcher=local|ray workers=N out=FOLDER
  rrl new NAME                          make a folder with environment, controller and configuration of your own

RUN is a run's directory. Keys and groups: rrl train --help; the whole configuration: rrl train --cfg job.
Packages and a folder configs/ of the working directory are found: env=mine reads configs/env/mine.yaml.
Set RRL_TRACEBACK=1 to see where an error comes from.

SIGTERM and Ctrl-C finish the round, save and print how to go on; the second one ends the process at once.
Exit status: 0 done, 2 an error (one message on stderr), 130 or 143 stopped by Ctrl-C or SIGTERM.
"""

COMMANDS = ("train", "evaluate", "render", "report", "dashboard", "reproduce", "new")
USER_CONFIGS = "configs"
"""Folder in the working directory whose groups are added to ours."""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``rrl``; returns the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(USAGE)
        return 0
    command, rest = arguments[0], arguments[1:]
    try:
        if command not in COMMANDS:
            raise ValueError(f"unknown command {command!r}; choose one of {', '.join(COMMANDS)}")
        if command in WITHOUT_CONFIGURATION:
            WITHOUT_CONFIGURATION[command](rest)
            return 0
        run_dir, overrides = _split_run(command, rest)
        _hydra(command, run_dir, overrides)
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except Exception as error:
        if stopped_by := getattr(error, "signal", None):
            return 128 + int(stopped_by)
        if os.environ.get("RRL_TRACEBACK"):
            raise
        Console(stderr=True).print(
            f"rrl {command}: {_message(error)}", style="red", highlight=False, markup=False
        )
        return 2
    return 0


def _new(arguments: list[str]) -> None:
    from .new import create

    if len(arguments) != 1:
        raise ValueError(f"expected one name, rrl new NAME, got {arguments}")
    name = arguments[0]
    for path in create(name, Path.cwd()):
        print(f"  {path.relative_to(Path.cwd())}")
    print(f"\ncd {name} && rrl train env={name} controller={name}")


def _report(arguments: list[str]) -> None:
    from ..report.report import write_report
    from ..report.runs import find_runs

    chosen = [a.removeprefix("out=") for a in arguments if a.startswith("out=")]
    named = [Path(a).expanduser() for a in arguments if not a.startswith("out=")]
    if not named or any("=" in path.name and not path.exists() for path in named):
        raise ValueError(
            f"expected directories of runs, rrl report RUN... [out=FILE], got {arguments}"
        )
    runs = find_runs(named)
    out = (
        Path(chosen[-1]).expanduser()
        if chosen
        else (runs[0].path if len(runs) == 1 else Path.cwd()) / REPORT
    )
    print(f"  {write_report(runs, out)}")


def _dashboard(arguments: list[str]) -> None:
    from ..report.dashboard import build

    named = dict(a.split("=", 1) for a in arguments if "=" in a)
    if (
        "entity" not in named
        or not named.keys() <= {"entity", "project"}
        or len(named) != len(arguments)
    ):
        raise ValueError(
            f"expected your W&B user or team, rrl dashboard entity=USER [project=rrl], got {arguments}"
        )
    print(f"  {build(**named).save().url}")


def _reproduce(arguments: list[str]) -> None:
    _quieten()
    from ..experiments.reproduce import reproduce

    names = [a for a in arguments if "=" not in a]
    changes = {
        key: yaml.safe_load(value)
        for key, _, value in (a.partition("=") for a in arguments if "=" in a)
    }
    ours, theirs = Path(__file__).parents[2] / USER_CONFIGS, Path.cwd() / USER_CONFIGS
    folders = [folder for folder in (theirs, ours) if folder.is_dir()]
    sys.path.append(str(Path.cwd()))
    reproduce(names, changes, partial(_compose, folders), folders, Console())


def _compose(folders: Sequence[Path], overrides: Sequence[str]) -> dict[str, Any]:
    """The configuration that ``rrl train`` would have with these overrides."""
    found = [f"hydra.searchpath=[{','.join(f'file://{folder}' for folder in folders[:-1])}]"]
    OmegaConf.register_new_resolver("plain", plain_name, replace=True)
    with hydra.initialize_config_module("rrl.configs", version_base="1.3"):
        config = hydra.compose("train", overrides=[*found, *overrides])
    return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True, throw_on_missing=True))


WITHOUT_CONFIGURATION: dict[str, Callable[[list[str]], None]] = {
    "new": _new,
    "report": _report,
    "dashboard": _dashboard,
    "reproduce": _reproduce,
}


def _split_run(command: str, arguments: list[str]) -> tuple[Path | None, list[str]]:
    """Take ``resume=`` or ``run=`` out of the arguments."""
    key = "resume=" if command == "train" else "run="
    named = [a.removeprefix(key) for a in arguments if a.startswith(key)]
    rest = [a for a in arguments if not a.startswith(key)]
    if command != "train" and not named and not any(a.startswith("-") for a in rest):
        raise ValueError(f"expected run=DIRECTORY, the directory of a training run, got {rest}")
    if not named:
        return None, rest
    run_dir = Path(named[-1]).expanduser().resolve()
    if not (run_dir / CONFIG_FILE).is_file():
        raise FileNotFoundError(
            f"{key}{named[-1]}: no {CONFIG_FILE} in {run_dir}; expected the directory of a training run"
        )
    return run_dir, rest


def _hydra(command: str, run_dir: Path | None, overrides: list[str]) -> None:
    """Let Hydra compose the configuration (a run's own one, if named) and call the command."""
    source = ["--config-path", "pkg://rrl.configs", "--config-name", "train"]
    if run_dir is not None:
        source = ["--config-path", str(run_dir), "--config-name", CONFIG_FILE]
        quiet = "hydra.job_logging.root.level=WARNING"
        overrides = [quiet, *overrides, f"hydra.run.dir={run_dir}", "hydra.output_subdir=null"]
    OmegaConf.register_new_resolver("plain", plain_name, replace=True)
    sys.argv = ["rrl", *source, *_user_configs(overrides), *overrides]
    failures: list[Exception] = []

    def job(config: DictConfig) -> None:
        try:
            _run(command, config, resume=run_dir is not None)
        except Exception as error:
            failures.append(error)  # past Hydra, which would print a line of its own about it

    run: Callable[[], None] = hydra.main(version_base="1.3", config_path=None)(job)
    os.environ.setdefault(
        "HYDRA_FULL_ERROR", "1"
    )  # what Hydra itself raises comes through; main() shows it
    run()
    for failure in failures:
        raise failure


def _user_configs(arguments: list[str]) -> list[str]:
    """Let ``_target_`` name packages of the working directory, and groups hold the YAML of its folder ``configs``."""
    here = Path.cwd()
    if str(here) not in sys.path:
        sys.path.append(str(here))  # last: nothing there hides an installed package
    chosen = any(a.startswith(("--config-dir", "-cd")) for a in arguments)
    return (
        ["--config-dir", str(here / USER_CONFIGS)]
        if (here / USER_CONFIGS).is_dir() and not chosen
        else []
    )


def plain_name(name: str) -> str:
    """``name`` itself, if it stays inside the folder that it is put in; resolver ``plain`` of the configuration.

    Raises:
        ValueError: anything but letters, digits and ``. _ + = -``, or a dot at the front.
    """
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._+=-]*", str(name)):
        raise ValueError(
            f"name: expected letters, digits and . _ + = - for a directory of that name, got {name!r}"
        )
    return name


def _run(command: str, hydra_config: DictConfig, *, resume: bool) -> None:
    _quieten()
    from . import (
        commands,  # here, because it imports torch and torchrl: help and usage errors come at once
    )

    container = OmegaConf.to_container(hydra_config, resolve=True, throw_on_missing=True)
    config = cast(dict[str, Any], container)
    run_dir = Path(HydraConfig.get().runtime.output_dir)
    console = Console()
    if command == "train":
        commands.train(config, run_dir, console, resume=resume)
    elif command == "evaluate":
        commands.evaluate(config, run_dir, console)
    else:
        commands.render(config, run_dir, console)


def _quieten() -> None:
    """Keep to itself what TorchRL says when it is imported: that it is there, and that some of it is deprecated."""
    warnings.filterwarnings("ignore", message="Creating .* inherits from WeightUpdaterBase")
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")


def _message(error: BaseException) -> str:
    """An error in one paragraph; a KeyError without its quotes."""
    if isinstance(error, KeyError) and error.args:
        return str(error.args[0])
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    text = str(error) or type(error).__name__
    cause = str(error.__cause__ or "").partition("\n")[0]  # Hydra keeps the reason there
    return text if cause in text else f"{text}\n{cause}"
