"""Controllers: modules from observation keys to ``base_action``."""

from rrl.controllers.base import Controller, StatefulController
from rrl.controllers.function import FunctionController
from rrl.controllers.pid import PIDController
from rrl.controllers.policy import PolicyController
from rrl.controllers.proportional import ProportionalController
from rrl.controllers.replay import ReplayController
from rrl.controllers.sum import SumController
from rrl.controllers.zero import ZeroController

__all__ = [
    "Controller",
    "FunctionController",
    "PIDController",
    "PolicyController",
    "ProportionalController",
    "ReplayController",
    "StatefulController",
    "SumController",
    "ZeroController",
]
