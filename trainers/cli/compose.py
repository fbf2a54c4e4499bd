"""From a command's arguments to a resolved configuration; the only place that knows Hydra."""

from __future__ import annotations

import os
import re
import sys
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, cast

import hydra
import yaml
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from ..errors import message
from ..storage.run_files import CONFIG_FILE, PLAIN_NAME

CONFIGS = "configs"
"""The folder in the working directory whose files come before ours."""
OURS = Path(__file__).parents[2] / CONFIGS
PACKAGE, PRIMARY = "rrl.configs", "train"
SAVED = "saved_run"
_PART = re.compile(r"\{|null$")
"""What stands for a part of a saved configuration; any other value is a choice of ours."""


@dataclass(frozen=True)
class Composed:
    """A command's configuration.

    Attributes:
        config: Resolved.
        run_dir: Where a new run goes; the run's own directory if it was named.
        chosen: Whether the user named that directory.
        replaced: Files of the project that were read instead of ours of the same name.
    """

    config: dict[str, Any]
    run_dir: Path
    chosen: bool = True
    replaced: tuple[Path, ...] = ()


class ProjectConfigs(SearchPathPlugin):
    """Has Hydra look for a group's file in the project's folder first."""

    folder: ClassVar[Path | None] = None

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Put the project's folder before ours."""
        ours = any(entry.path == f"pkg://{PACKAGE}" for entry in search_path.get_path())
        if ours and self.folder is not None and self.folder.is_dir():
            search_path.prepend("project", f"file://{self.folder}")


@contextmanager
def _in_our_words() -> Iterator[None]:
    """Raise what Hydra finds as a ValueError, with the key at its beginning where that is known."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        if text := _missing(error) or _misspelt(error):
            raise ValueError(text) from None
        raise ValueError(str(error)) from error.__cause__


def _missing(error: Exception) -> str | None:
    """Return which key others are made of and nobody has given."""
    found = re.match("Interpolation key '(.+)' not found", str(error))
    return f"{found[1]}: expected a value, got none" if found else None


def _misspelt(error: Exception) -> str | None:
    """Return which known key was meant; Hydra tells how to add another one."""
    reason = error.__cause__
    if not isinstance(reason, ConfigAttributeError | ConfigKeyError):
        return None
    known = [str(key) for key in cast(DictConfig, reason.parent_node)]
    near = get_close_matches(str(reason.key), known, 1)
    if not near:
        return None
    where, given = str(reason.full_key), str(error).rpartition(" use ")[2]
    meant = where.removesuffix(str(reason.key)) + near[0]
    return f"{where}: unknown key; did you mean {meant}? (to add a key: {given})"


@_in_our_words()
def compose(overrides: Sequence[str], folder: Path | None = None) -> dict[str, Any]:
    """Return the resolved configuration that ``rrl train`` has with these overrides.

    Args:
        overrides: In Hydra's grammar.
        folder: The project's configurations; None: ``configs`` of the working directory.
    """
    _prepare(folder)
    _require_choices(overrides)
    with hydra.initialize_config_module(PACKAGE, version_base="1.3"):
        return _resolved(hydra.compose(PRIMARY, overrides=list(overrides)))


@_in_our_words()
def compose_train(overrides: Sequence[str], run_dir: Path | None) -> Composed:
    """Compose a new run's configuration, or one from a run's own with changes.

    Args:
        overrides: In Hydra's grammar.
        run_dir: Directory of an earlier run.
    """
    _prepare()
    if run_dir is not None:
        _store(run_dir, overrides)
        with hydra.initialize(version_base="1.3", config_path=None):
            return Composed(_resolved(hydra.compose(SAVED, list(overrides))), run_dir)
    _require_choices(overrides)
    with hydra.initialize_config_module(PACKAGE, version_base="1.3"):
        config = hydra.compose(PRIMARY, list(overrides), return_hydra_config=True)
    chosen = any(override.startswith("hydra.run.dir=") for override in overrides)
    replaced = _replaced(config.hydra.runtime.choices)
    out = Path(config.hydra.run.dir).expanduser().absolute()
    return Composed(_resolved(config), out, chosen, replaced)


@_in_our_words()
def through_hydra(
    arguments: Sequence[str], run_dir: Path | None, job: Callable[[Composed], None]
) -> None:
    """Let Hydra's own command line do what has flags, such as --help, --cfg job and --multirun.

    Args:
        arguments: Flags and overrides.
        run_dir: Directory of an earlier run.
        job: What to do with every configuration.

    Raises:
        RuntimeError: If runs of a sweep failed; a single one's error is raised as it is.
    """
    _prepare()
    failures: dict[str, Exception] = {}

    def task(config: DictConfig) -> None:
        if _signals(failures):
            return  # Ctrl-C ends a sweep, not one of its runs
        runtime = HydraConfig.get().runtime
        out = run_dir or Path(runtime.output_dir)
        replaced = () if run_dir else _replaced(runtime.choices)
        try:
            job(Composed(_resolved(config), out, True, replaced))
        except Exception as error:
            failures[_named_job()] = error  # past Hydra, which would print a line of its own

    path, name = (f"pkg://{PACKAGE}", PRIMARY)
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # main() shows what Hydra raises
    with TemporaryDirectory() as folder:
        if run_dir is not None:
            _store(run_dir, arguments, {"run": {"dir": folder}, "sweep": {"dir": folder}})
            path, name = (None, SAVED)  # type: ignore[assignment]
        else:
            _require_choices(arguments)
        sys.argv = ["rrl", *arguments]
        hydra.main(version_base="1.3", config_path=path, config_name=name)(task)()
    for failure in _signals(failures) or [failures[job] for job in failures if not job]:
        raise failure
    if failures:
        text = "\n".join(f"{job}: {message(error)}" for job, error in failures.items())
        raise RuntimeError(text) from next(iter(failures.values()))


def _signals(failures: Mapping[str, Exception]) -> list[Exception]:
    """Return what was not an error, but asked for from outside."""
    return [failure for failure in failures.values() if hasattr(failure, "signal")]


def _named_job() -> str:
    """Return number and overrides of a sweep's job; empty without a sweep."""
    current = HydraConfig.get()
    if current.mode != RunMode.MULTIRUN:
        return ""
    return f"job {current.job.num} ({' '.join(current.overrides.task)})"


def plain_name(name: str) -> str:
    """Return ``name``, which stays inside the folder that it is put in; resolver ``plain``.

    Raises:
        ValueError: If there is anything but letters, digits and ``. _ + = -``, or a dot in front.
    """
    if not re.fullmatch(PLAIN_NAME, str(name)):
        raise ValueError(
            "name: expected letters, digits and . _ + = - for a directory of that name, "
            f"got {name!r}"
        )
    return name


def _prepare(folder: Path | None = None) -> None:
    """Let ``_target_`` name modules of the working directory, and groups the project's files."""
    here = Path.cwd()
    if str(here) not in sys.path:
        sys.path.append(str(here))  # last: nothing there hides an installed package
    ProjectConfigs.folder = folder or here / CONFIGS
    if ProjectConfigs not in Plugins.instance().discover(SearchPathPlugin):
        Plugins.instance().register(ProjectConfigs)
    OmegaConf.register_new_resolver("plain", plain_name, replace=True)


def _require_choices(overrides: Sequence[str]) -> None:
    """Refuse null in the place of a group's file, and a second one, in better words than Hydra."""
    defaults = yaml.safe_load((OURS / f"{PRIMARY}.yaml").read_text(encoding="utf-8"))["defaults"]
    chosen = ChainMap(*(entry for entry in defaults if isinstance(entry, dict)))
    for override in overrides:
        key, _, choice = override.partition("=")
        group = key.lstrip("+")
        if choice == "null" and key in chosen:
            raise ValueError(f"{key}: expected one of its files, or ~{key} for none, got null")
        is_second = group != key and group in chosen and f"~{group}" not in overrides
        if is_second and not choice.startswith("{"):
            raise ValueError(f"{group}: expected {group}={choice} to exchange it, got {override}")


@_in_our_words()
def _resolved(config: DictConfig) -> dict[str, Any]:
    container = OmegaConf.to_container(
        OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"]),
        resolve=True,
        throw_on_missing=True,
    )
    return cast(dict[str, Any], container)


def _store(run_dir: Path, overrides: Sequence[str], own: Mapping[str, Any] | None = None) -> None:
    """Make a run's configuration known to Hydra; it is resolved, so ``${`` in it is text.

    Args:
        run_dir: The run's directory.
        overrides: Changes of it.
        own: Where Hydra puts what it writes for itself: a saved run has its directory.
    """
    path = run_dir / CONFIG_FILE
    with path.open(encoding="utf-8") as file:  # an error of YAML names it
        config = yaml.safe_load(file)
    if not isinstance(config, dict):
        raise ValueError(f"{path}: expected a run's configuration, got {config!r}")
    for override in overrides:
        key, _, value = override.partition("=")
        if key.lstrip("+") in ("hydra.run.dir", "hydra.sweep.dir"):
            raise ValueError(
                f"{key}: expected none beside a run's own directory, which gets everything, got "
                f"{value}; to keep {run_dir} as it is, copy it and name the copy"
            )
        if isinstance(section := config.get(key), dict) and not _PART.match(value):
            raise ValueError(
                f"{key}: expected a change of what this run has, such as {key}."
                f"{next(iter(section), 'KEY')}=..., or without it ~{key}."
                f"{next(iter(section), 'KEY')}, got {override}; a saved run has no other choices"
            )
    # Hydra's own logging would stay behind, with the output that it found.
    silent = [{f"override hydra/{which}_logging": "none"} for which in ("job", "hydra")]
    node = {"defaults": ["_self_", *silent], **_escaped(config), "hydra": own or {}}
    ConfigStore.instance().store(SAVED, node)


def _escaped(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {key: _escaped(child) for key, child in node.items()}
    if isinstance(node, list):
        return [_escaped(child) for child in node]
    if isinstance(node, str):
        return re.sub(r"(\\*)\$\{", lambda found: f"{found[1] * 2}\\${{", node)
    return node


def _replaced(choices: Mapping[str, Any]) -> tuple[Path, ...]:
    """Return the project's files that were read in the place of ours."""
    folder = ProjectConfigs.folder
    if folder is None or folder.resolve() == OURS.resolve():  # in a clone they are ours
        return ()
    names = [PRIMARY]
    for group, choice in choices.items():
        several = (
            choice if isinstance(choice, Sequence) and not isinstance(choice, str) else [choice]
        )
        names += [f"{group}/{name}" for name in several]
    files = [Path(f"{name}.yaml") for name in names]
    return tuple(folder / f for f in files if (folder / f).is_file() and (OURS / f).is_file())
