"""From observation entries to the features that actor and critics read."""

from rrl.encoders.automatic import automatic
from rrl.encoders.concatenate import Concatenate
from rrl.encoders.frozen import FrozenEncoder
from rrl.encoders.pixels import PixelEncoder
from rrl.encoders.shift import random_shift

__all__ = ["Concatenate", "FrozenEncoder", "PixelEncoder", "automatic", "random_shift"]
