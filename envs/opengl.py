"""Import MuJoCo and dm_control without OpenGL; choose a backend when something is rendered.

Both packages load what ``MUJOCO_GL`` names, or whatever they find, when they are imported, and fail
where it is missing. Training needs none of it, so here they are imported with rendering disabled.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

__all__ = ["RenderingUnavailable", "find_backend", "make_context"]

BACKENDS = ("egl", "osmesa", "glfw")
_RENDERERS = {
    "mujoco.rendering.classic.gl_context": "GLContext",
    "dm_control._render": "Renderer",
}
"""What makes OpenGL contexts, for ``mujoco.Renderer`` and for dm_control's pixel observables."""
_PROBE = """
import sys, importlib
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16)
context.make_current()
import mujoco
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 150)
print("works", flush=True)
import os
os._exit(0)
"""


class RenderingUnavailable(RuntimeError):
    """No OpenGL backend works on this machine, or not the one that the environment names."""


@functools.cache
def find_backend() -> str:
    """Return the first backend that can make a context: ``egl``, ``osmesa`` or ``glfw``.

    Tried in a process of its own, because a broken driver may end the process. The environment
    variable ``MUJOCO_GL`` restricts the choice where it names one of the three.

    Raises:
        RenderingUnavailable: If none works; the message says why and what to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    reasons = []
    for backend in (wanted,) if wanted in BACKENDS else BACKENDS:
        environment = {**os.environ, "PYOPENGL_PLATFORM": backend, "MUJOCO_GL": backend}
        try:
            probe = subprocess.run(
                [sys.executable, "-c", _PROBE, backend],
                env=environment, capture_output=True, text=True, timeout=60, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            reasons.append(f"{backend}: no answer within 60 s")
            continue
        if "works" in probe.stdout:
            return backend
        lines = probe.stderr.strip().splitlines() or ["no message"]
        reasons.append(f"{backend}: {lines[-1]}")
    raise RenderingUnavailable(
        "rendering: expected an OpenGL backend that works (training and evaluation need none), got "
        + "; ".join(reasons)
        + (f" with MUJOCO_GL={wanted}" if wanted in BACKENDS else "")
        + ". Install one, on Debian or Ubuntu for instance `apt-get install libegl1 "
        "libgl1-mesa-dri` for EGL or `apt-get install libosmesa6` for OSMesa."
    )


def make_context(width: int, height: int) -> Any:
    """Return a current off-screen OpenGL context.

    Raises:
        RenderingUnavailable: If no backend works, or PyOpenGL uses another one in this process.
    """
    backend = find_backend()
    platform = os.environ.get("PYOPENGL_PLATFORM") or backend
    if backend != "glfw":
        os.environ["PYOPENGL_PLATFORM"] = platform
        if platform != backend:
            raise RenderingUnavailable(
                f"PYOPENGL_PLATFORM: expected {backend!r}, which works here, got {platform!r}; "
                f"start again with PYOPENGL_PLATFORM={backend}"
            )
    context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
    context.make_current()
    return context


@contextlib.contextmanager
def _mujoco_gl(backend: str) -> Iterator[None]:
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = backend
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before


def _choose_at_first_use(module_name: str, name: str) -> None:
    """Make ``module.name`` load a backend when it is first called."""
    module = importlib.import_module(module_name)

    def construct(*args: Any, **kwargs: Any) -> Any:
        with _mujoco_gl(find_backend()):
            importlib.reload(module)
        return getattr(module, name)(*args, **kwargs)

    setattr(module, name, construct)


def _import_without_opengl() -> None:
    fresh = [module for module in _RENDERERS if module.split(".")[0] not in sys.modules]
    with _mujoco_gl("disable"):
        importlib.import_module("dm_control.mujoco")
    for module in fresh:
        # The modules are private: where a later version has moved them, training goes on.
        with contextlib.suppress(ImportError):
            _choose_at_first_use(module, _RENDERERS[module])


_import_without_opengl()
