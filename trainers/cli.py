"""The command line: ``rrl train``, ``rrl evaluate``, ``rrl render``, with Hydra's overrides."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from .layout import CONFIG_FILE

USAGE = """usage: rrl COMMAND [key=value ...]

  rrl train [key=value ...]             train on the configuration, end with table, curve and video
  rrl train resume=RUN [key=value ...]  continue a run from its newest checkpoint
  rrl evaluate run=RUN [key=value ...]  evaluate a run's newest checkpoint on frozen episodes
  rrl render run=RUN [key=value ...]    write a video of controller and residual on one episode

RUN is a run's directory. Keys and groups: rrl train --help; the whole configuration: rrl train --cfg job.
Set RRL_TRACEBACK=1 to see where an error comes from.
"""

COMMANDS = ("train", "evaluate", "render")


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
        run_dir, overrides = _split_run(command, rest)
        _hydra(command, run_dir, overrides)
    except Exception as error:
        if os.environ.get("RRL_TRACEBACK"):
            raise
        Console(stderr=True).print(f"rrl {command}: {_message(error)}", style="red", highlight=False, markup=False)
        return 2
    return 0


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
        overrides = [*overrides, f"hydra.run.dir={run_dir}", "hydra.output_subdir=null"]
    sys.argv = ["rrl", *source, *overrides]
    run: Callable[[], None] = hydra.main(version_base="1.3", config_path=None)(
        lambda config: _run(command, config, resume=run_dir is not None)
    )
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # exceptions come through; main() shows them
    run()


def _run(command: str, hydra_config: DictConfig, *, resume: bool) -> None:
    # importing TorchRL warns of its own deprecated classes
    warnings.filterwarnings("ignore", message="Creating .* inherits from WeightUpdaterBase")
    from . import (
        commands,  # here, because it imports torch and torchrl: help and usage errors come at once
    )

    logging.getLogger("torchrl").setLevel(logging.WARNING)
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


def _message(error: BaseException) -> str:
    """An error in one paragraph; a KeyError without its quotes, pydantic's list without its links."""
    from pydantic import ValidationError

    if isinstance(error, ValidationError):
        lines = [
            f"trainer.{'.'.join(map(str, e['loc']))}: {e['msg']}, got {e['input']!r}"
            if e["loc"]
            else e["msg"].removeprefix("Value error, ")
            for e in error.errors()
        ]
        return "\n".join(lines)
    if isinstance(error, KeyError) and error.args:
        return str(error.args[0])
    return str(error) or type(error).__name__
