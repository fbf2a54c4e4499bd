"""Imports dm_control without noise on machines that have no display.

dm_control tries OpenGL backends when it is imported, first GLFW. Without a display GLFW only warns, so
dm_control would keep a backend that cannot work. As an error the warning makes it try the next.
"""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    try:
        from glfw import GLFWError
    except ImportError:  # no GLFW on this machine: nothing to keep quiet
        pass
    else:
        warnings.simplefilter("error", category=GLFWError)
    import dm_control.mujoco  # noqa: F401
