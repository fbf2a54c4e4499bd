"""What an encoder is."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tensordict import NestedKey
from torch import nn

from rrl.inputs import Input

Inputs = Mapping[NestedKey, Input]

EncoderFactory = Callable[[Inputs], nn.Module]
"""From the policy's inputs to a module: values of all entries ``[*batch, *shape]``, in their order,
to features ``[*batch, out_features]``; the module has the attribute ``out_features``.

Two methods are optional. ``calibrate``, called once with the first values of every entry
``[n, *shape]``, or of those in the attribute ``calibrated_by``, returns what it derived for each;
images of all transitions take much memory. ``augment``, called with the values of a training batch
``[B, *shape]``, returns what is learned from in their place."""
