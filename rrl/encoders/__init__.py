"""From observation entries to the features that actor and critics read."""

from rrl.encoders.concatenate import Concatenate
from rrl.encoders.frozen import FrozenEncoder
from rrl.encoders.pixels import PixelEncoder, automatic, random_shift

__all__ = ["Concatenate", "FrozenEncoder", "PixelEncoder", "automatic", "random_shift"]
