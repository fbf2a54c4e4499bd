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

BACKENDS = ("egl", "osmesa", "glfw")
_PROBE = """
import importlib, os, sys
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16)
context.make_current()
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
        f"({'; '.join(reasons)}). Only videos and environments with a camera need "
        "one. Install one, on Debian or Ubuntu for instance "
        "`apt-get install libegl1 libgl1-mesa-dri` for EGL or "
        "`apt-get install libosmesa6` for OSMesa."
    )


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
        backend = find_backend()
        try:
            with _mujoco_gl(backend):
                importlib.reload(module)
        except Exception as error:  # of many kinds, from drivers and their bindings
            raise RenderingUnavailable(
                f"PYOPENGL_PLATFORM: expected {backend!r}, which works here, or no value in this "
                f"process, got {os.environ.get('PYOPENGL_PLATFORM')!r}: {error}"
            ) from error
        return getattr(module, name)(*args, **kwargs)

    setattr(module, name, construct)


with _mujoco_gl("disable"):
    import dm_control.mujoco  # noqa: F401
# Private modules: where a later version has moved them, rendering fails, and nothing else.
with contextlib.suppress(ImportError):
    _choose_at_first_use("mujoco.rendering.classic.gl_context", "GLContext")  # mujoco.Renderer
    _choose_at_first_use("dm_control._render", "Renderer")  # pixel observables
