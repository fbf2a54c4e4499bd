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
_PROBE = """
import importlib, os, sys
importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16).make_current()
import mujoco
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 150)
print("works", flush=True)
os._exit(0)
"""


class RenderingUnavailable(RuntimeError):
    """No OpenGL backend works on this machine, or not the one that the environment names."""


@functools.cache
def find_backend() -> str:
    """Return the first backend that can make a context: ``egl``, ``osmesa`` or ``glfw``.

    Each is tried in its own process, because a broken driver may end it. The environment variable
    ``MUJOCO_GL`` restricts the choice where it names one of the three.

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
            reasons.append(f"{backend} does not answer within 60 s")
            continue
        if "works" in probe.stdout:
            return backend
        reasons.append(f"{backend}: {(probe.stderr.strip().splitlines() or ['no message'])[-1]}")
    raise RenderingUnavailable(
        f"MUJOCO_GL: expected a backend that renders on this machine, got {wanted!r} "
        f"({'; '.join(reasons)}). Training and evaluation need none. To render, install one, on "
        "Debian or Ubuntu for instance `apt-get install libegl1 libgl1-mesa-dri` for EGL or "
        "`apt-get install libosmesa6` for OSMesa."
    )


def make_context(width: int, height: int) -> Any:
    """Return a current off-screen OpenGL context.

    Raises:
        RenderingUnavailable: If no backend works, or PyOpenGL uses another one in this process.
    """
    backend = find_backend()
    platform = backend if backend == "glfw" else os.environ.get("PYOPENGL_PLATFORM") or backend
    if platform != backend:
        raise RenderingUnavailable(
            f"PYOPENGL_PLATFORM: expected {backend!r}, which works here, got {platform!r}; start "
            f"again with PYOPENGL_PLATFORM={backend}"
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
        del os.environ["MUJOCO_GL"]
        if before is not None:
            os.environ["MUJOCO_GL"] = before


def _choose_at_first_use(module_name: str, name: str) -> None:
    """Make ``module.name`` load a backend when it is first called."""
    module = importlib.import_module(module_name)

    def construct(*args: Any, **kwargs: Any) -> Any:
        with _mujoco_gl(find_backend()):
            importlib.reload(module)
        return getattr(module, name)(*args, **kwargs)

    setattr(module, name, construct)


if "mujoco" not in sys.modules:  # else it is too late, and no harm was done
    with _mujoco_gl("disable"):
        import dm_control.mujoco  # noqa: F401
    # Private modules: where a later version has moved them, only these renderers are missing.
    with contextlib.suppress(ImportError):
        _choose_at_first_use("dm_control._render", "Renderer")  # pixel observables
        _choose_at_first_use("mujoco.rendering.classic.gl_context", "GLContext")  # mujoco.Renderer
