"""What the policy's cameras see, as pictures beside a video's scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from tensordict import TensorDictBase

from rrl.encoders.images import as_channels_first
from rrl.inputs import Input

Picture = NDArray[np.uint8]
BACKGROUND = 90


def camera_views(td: TensorDictBase, inputs: Mapping[str, Input]) -> list[Picture]:
    """Return a picture ``[H, W, 3]`` of every image among the inputs of one slot ``[1]``.

    Of stacked frames the last is shown, of an image whose channels are no colors the first one.
    """
    return [_picture(td[name], entry) for name, entry in inputs.items() if entry.is_image]


def _picture(value: torch.Tensor, entry: Input) -> Picture:
    image = as_channels_first(value, entry)[0]  # (C, H, W)
    colors = image[-3:] if len(image) % 3 == 0 else image[:1].expand(3, -1, -1)
    bytes_ = colors if colors.dtype == torch.uint8 else (255 * colors.clamp(0, 1)).byte()
    return bytes_.movedim(0, -1).cpu().numpy()


def beside(frames: Picture, views: Sequence[Sequence[Picture]]) -> Picture:
    """Return a video's frames ``[T, h, w, 3]`` with a column of enlarged pictures to the right.

    Args:
        frames: The scene.
        views: Of every frame the same number of pictures; none: the scene alone is returned.
    """
    if not views or not views[0]:
        return frames
    height = frames.shape[1]
    side = height // max(2, len(views[0])) // 2 * 2  # video codecs want even numbers
    column = np.full((len(frames), height, side, 3), BACKGROUND, dtype=np.uint8)
    for time, pictures in enumerate(views):
        for place, picture in enumerate(reversed(pictures)):
            bottom = height - place * side
            column[time, bottom - side : bottom] = _fitted(picture, side)
    return np.concatenate((frames, column), axis=2)


def _fitted(picture: Picture, side: int) -> Picture:
    """Enlarge a picture into a square, each pixel a block of pixels."""
    scale = side / max(picture.shape[:2])
    size = [max(1, round(scale * length)) for length in picture.shape[1::-1]]
    image = Image.new("RGB", (side, side), (BACKGROUND,) * 3)
    resized = Image.fromarray(picture).resize((size[0], size[1]), Image.Resampling.NEAREST)
    image.paste(resized, ((side - size[0]) // 2, (side - size[1]) // 2))
    return np.asarray(image)
