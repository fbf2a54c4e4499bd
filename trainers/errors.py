"""An error in words: what it says, and where in the user's own code it comes from."""

from __future__ import annotations

import pickle
import sysconfig
import traceback
from pathlib import Path
from types import FrameType

import yaml

__all__ = ["message", "packed", "place", "unpacked"]

LIBRARIES = ("site-packages", "dist-packages")
STANDARD = Path(sysconfig.get_path("stdlib"))
HINT = "RRL_TRACEBACK=1 shows where it comes from"
ORIGIN = "_rrl_origin"
"""Attribute of an error from another process: its place, and whether it is explained."""


def message(error: BaseException) -> str:
    """Return an error as one paragraph; one that is not of our making tells how to see more."""
    text = f"{_text(error)}{place(error)}"
    return text if _is_explained(error) else f"{text}\n{HINT}"


def place(error: BaseException | None) -> str:
    """Return the innermost line of the user's own code that an error came through.

    Returns:
        `` (file:line, in function)``; empty where there is none.
    """
    if hasattr(error, ORIGIN):
        return str(getattr(error, ORIGIN)[0])
    for frame, line in reversed(_frames(error)):
        file = Path(frame.f_code.co_filename)
        if not _is_ours(frame) and not _is_of_a_library(file):
            here = Path.cwd()
            shown = file.relative_to(here) if file.is_relative_to(here) else file
            return f" ({shown}:{line}, in {frame.f_code.co_name})"
    return ""


def packed(error: Exception) -> bytes:
    """Return an error for another process, as another kind where it cannot be sent.

    Frames cannot be sent: what they tell goes with it, for :func:`message` and for a traceback.
    """
    told = place(error), _is_explained(error)
    text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    try:
        data = pickle.dumps((error, told, text))
        pickle.loads(data)
    except Exception:
        data = pickle.dumps((RuntimeError(f"{type(error).__name__}: {error}"), told, text))
    return data


def unpacked(data: bytes, process: str) -> Exception:
    """Return an error that another process has :func:`packed`, with its traceback as the cause."""
    error, told, text = pickle.loads(data)
    setattr(error, ORIGIN, told)
    error.__cause__ = RuntimeError(f"in {process}:\n{text}")
    return error


def _frames(error: BaseException | None) -> list[tuple[FrameType, int]]:
    return [] if error is None else list(traceback.walk_tb(error.__traceback__))


def _is_ours(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__")).partition(".")[0] == "rrl"


def _is_of_a_library(file: Path) -> bool:
    inside = file.is_relative_to(STANDARD) or bool(set(LIBRARIES) & set(file.parts))
    return inside or str(file).startswith("<")  # <frozen ...>, <string>


def _is_explained(error: BaseException) -> bool:
    """Return whether an error was raised by this package, or names a file and what is wrong."""
    if hasattr(error, ORIGIN):
        return bool(getattr(error, ORIGIN)[1])
    frames = _frames(error)
    return not frames or _is_ours(frames[-1][0]) or isinstance(error, OSError | yaml.YAMLError)


def _text(error: BaseException) -> str:
    """Return what an error says; a KeyError without its quotes."""
    if isinstance(error, KeyError) and error.args:
        return str(error.args[0])
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    text = str(error) or type(error).__name__
    if hasattr(error, ORIGIN):  # its cause is a traceback
        return text
    cause = str(error.__cause__ or "").partition("\n")[0]  # Hydra keeps the reason there
    return text if cause in text else f"{text}\n{cause}"
