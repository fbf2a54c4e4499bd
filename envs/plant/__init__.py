"""A machine to practise on: the insertion task in a process of its own, in wall-clock time.

``python -m rrl.envs.plant`` starts it; :class:`RemoteRobot` drives it; :func:`serve` puts any other
:class:`~rrl.robot.Robot` behind a socket too. Needs the extra ``realtime``.
"""

try:
    from .client import RemoteRobot
    from .faults import inject
    from .server import serve
    from .simulated import SimulatedPlant
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"rrl.envs.plant: expected the packages of real time ({error}): "
        "pip install -e '.[realtime]' in the clone"
    ) from error

__all__ = ["RemoteRobot", "SimulatedPlant", "inject", "serve"]
