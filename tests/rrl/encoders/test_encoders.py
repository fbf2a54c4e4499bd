"""Encoders: what they read as images, what they make of them, and what they refuse."""

import numpy as np
import pytest
import torch
from torch import nn

from rrl.encoders import Concatenate, FrozenEncoder, PixelEncoder, automatic, random_shift
from rrl.inputs import Input, channels_of

VECTOR = Input(loc=0.0, scale=2.0, shape=(2,))
LAST, FIRST = Input(shape=(16, 12, 3), channels="last"), Input(shape=(3, 16, 12), channels="first")


@pytest.mark.parametrize(
    ("shape", "dtype", "channels"),
    [
        ((64, 64, 3), torch.uint8, "last"),
        ((3, 64, 64), torch.uint8, "first"),
        ((9, 64, 64), torch.uint8, "first"),
        ((64, 48, 1), torch.uint8, "last"),
        ((4, 4, 4), torch.uint8, "last"),
        ((4, 64, 64, 3), torch.uint8, "last"),
        ((64, 64), torch.uint8, "none"),
        ((64, 64, 3), torch.float32, "none"),
        ((3,), torch.uint8, "none"),
    ],
)
def test_what_looks_like_an_image(shape, dtype, channels):
    assert channels_of(shape, dtype) == channels


def pictures(*batch, seed=0):
    draw = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (*batch, 16, 12, 3), generator=draw, dtype=torch.uint8)


@pytest.mark.parametrize("batch", [(), (5,), (2, 5), (0,), (2, 0)])
def test_where_the_channels_stand_makes_no_difference(batch):
    torch.manual_seed(0)
    last = PixelEncoder({"camera": LAST, "vector": VECTOR})
    torch.manual_seed(0)
    first = PixelEncoder({"camera": FIRST, "vector": VECTOR})
    image, vector = pictures(*batch), torch.ones(*batch, 2)
    features = last(image, vector)
    assert features.shape == (*batch, 52)
    assert torch.equal(features, first(image.movedim(-1, -3), vector))
    assert torch.equal(features[..., 50:], torch.full((*batch, 2), 2.0))
    assert (features[..., :50].abs() <= 1).all()


def test_center_and_scale_may_be_numbers_and_arrays_of_numpy():
    entry = Input(loc=np.array([1.0, 2.0]), scale=np.float64(0.5), shape=(2,))
    features = Concatenate({"vector": entry})(torch.tensor([2.0, 6.0]))
    assert features.tolist() == [0.5, 2.0]
    with pytest.raises(ValueError, match=r"inputs\.vector\.loc: expected 1 or 2 numbers, got 3"):
        Concatenate({"vector": Input(loc=np.zeros(3), shape=(2,))})


def test_numbers_beside_images_are_standardized():
    encoder = PixelEncoder({"vector": Input(shape=(2,)), "camera": LAST})
    vectors = torch.randn(100, 2) * 5 + 3
    found = encoder.calibrate(vectors)
    assert found.keys() == {"vector"}
    features = encoder(vectors, pictures(100))[:, 50:].detach()
    assert features.mean() == pytest.approx(0, abs=0.01)
    assert features.std() == pytest.approx(1, abs=0.01)


def test_cameras_have_networks_of_their_own():
    encoder = PixelEncoder({"left": LAST, "right": LAST}, features=8)
    image = pictures(1)
    features = encoder(image, image)
    assert features.shape == (1, 16)
    assert not torch.equal(features[:, :8], features[:, 8:])


def test_stacked_frames_are_channels():
    stacked = Input(shape=(4, 16, 12, 3), channels="last")
    encoder = PixelEncoder({"camera": stacked})
    assert encoder.cameras[0][0][0].in_channels == 12
    image = torch.zeros(2, 4, 16, 12, 3, dtype=torch.uint8)
    assert encoder(image).shape == (2, 50)
    assert encoder.augment(image)[0].shape == image.shape
    assert encoder(image[:0]).shape == (0, 50)
    assert encoder.augment(image[:0])[0].shape == image[:0].shape


def test_a_floating_point_image_is_taken_as_it_is():
    encoder = PixelEncoder({"camera": LAST})
    image = pictures(3)
    assert torch.allclose(encoder(image), encoder(image / 255.0), atol=1e-6)


@pytest.mark.parametrize("entry", [LAST, FIRST])
def test_training_images_are_shifted_and_numbers_are_not(entry):
    encoder = PixelEncoder({"vector": VECTOR, "camera": entry}, shift=3)
    image = pictures(50) if entry is LAST else pictures(50).movedim(-1, -3)
    vector = torch.randn(50, 2)
    torch.manual_seed(0)
    same, moved = encoder.augment(vector, image)
    assert torch.equal(same, vector)
    assert (moved.shape, moved.dtype) == (image.shape, torch.uint8)
    assert not torch.equal(moved, image)
    torch.manual_seed(0)
    assert torch.equal(encoder.augment(vector, image)[1], moved)
    assert not torch.equal(encoder.augment(vector, image)[1], moved)


def test_a_shift_is_by_whole_pixels_the_border_fills_the_gap_and_all_are_equally_likely():
    images = pictures(2000).movedim(-1, -3).contiguous()[:1].expand(2000, 3, 16, 12)
    torch.manual_seed(0)
    moved = random_shift(images, 1)
    padded = nn.functional.pad(images[:1].float(), [1] * 4, mode="replicate").to(torch.uint8)
    crops = [padded[0, :, y : y + 16, x : x + 12] for y in range(3) for x in range(3)]
    counts = [int((moved == crop).flatten(1).all(1).sum()) for crop in crops]
    assert sum(counts) == 2000
    assert min(counts) > 2000 / 9 * 0.7
    assert random_shift(images, 0) is images


class Means(nn.Module):
    def __init__(self, power=1):
        super().__init__()
        self.power = power
        self.norm = nn.BatchNorm2d(3)

    def forward(self, images):
        return self.norm(images).mean(-1) ** self.power


def test_a_frozen_network_learns_nothing_and_keeps_its_statistics():
    encoder = FrozenEncoder({"camera": LAST, "vector": VECTOR}, network=Means)
    assert encoder.out_features == 3 * 16 + 2
    assert not [p for p in encoder.parameters() if p.requires_grad]
    encoder.train()
    before = encoder.network.norm.running_mean.clone()
    features = encoder(pictures(4), torch.zeros(4, 2))
    assert torch.equal(encoder.network.norm.running_mean, before)
    assert features[:, :48].mean(1).abs().max() < 1e-5
    assert not hasattr(encoder, "augment")


def test_the_encoder_follows_from_the_inputs():
    assert isinstance(automatic({"vector": VECTOR}), Concatenate)
    assert isinstance(automatic({"vector": VECTOR, "camera": LAST}), PixelEncoder)
    as_numbers = Input(shape=(4, 4, 3), channels="none")
    assert automatic({"camera": as_numbers}).out_features == 48


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PixelEncoder({"v": VECTOR}), "expected an image among the inputs.*got v"),
        (
            lambda: PixelEncoder({"c": Input(scale=2.0, shape=(8, 8, 3), channels="last")}),
            r"inputs\.c: expected neither loc nor scale.*channels: none",
        ),
        (lambda: PixelEncoder({"c": LAST}, strides=[2]), "expected lists of the same length"),
        (lambda: PixelEncoder({"c": LAST}, channels=[0, 1, 2]), "channels: expected a list"),
        (lambda: PixelEncoder({"c": LAST}, features=0), "features: expected a whole number"),
        (lambda: automatic({"v": VECTOR}, shift=-1), "shift: expected a whole number"),
        (
            lambda: FrozenEncoder({"c": LAST, "d": Input(shape=(8, 8, 3), channels="last")}, Means),
            "as many features of every camera, got 24, 48",
        ),
        (lambda: FrozenEncoder({"c": LAST}, lambda: nn.Flatten(0)), "expected features"),
        (lambda: Input(channels="middle"), "channels: expected one of first, last, none"),
    ],
)
def test_what_does_not_fit_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
