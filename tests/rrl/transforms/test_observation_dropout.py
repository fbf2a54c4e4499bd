"""Outages: the last observation stays for as long as they last, images included."""

import pytest
import torch
from torchrl.envs import TransformedEnv

from pixel_envs import PixelPoint
from rrl.transforms import ObservationDropout, ObservationLatency
from toy_envs import PointMass
from transform_cases import POSITION, drive, random_actions


def seen(env, actions, key=POSITION, resets=None):
    records = drive(env, actions, resets)
    return torch.stack([records[0][key]] + [r["next", key] for r in records[1:] if "next" in r])


@pytest.mark.parametrize("steps", [1, 3])
def test_the_last_one_stays_as_long_as_an_outage_lasts(steps):
    actions = random_actions(400, 4, 2)
    truth = seen(PointMass([4], episode_steps=1000), actions)
    dropout = ObservationDropout([POSITION], 0.1, steps, seed=0)
    held = seen(TransformedEnv(PointMass([4], episode_steps=1000), dropout), actions)
    assert torch.equal(held[0], truth[0])
    lost = (held != truth).any(-1)  # (401, 4)
    runs = []
    for slot in range(4):
        length = 0
        for time in range(1, 401):
            if lost[time, slot]:
                assert torch.equal(held[time, slot], held[time - 1, slot])
                length += 1
            elif length:
                runs.append(length)
                length = 0
    assert all(length % steps == 0 for length in runs)  # one may follow another at once
    share = 0.1 * steps / (1 + 0.1 * (steps - 1))
    assert lost.float().mean() == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize("channels", ["first", "last"])
def test_images_are_lost_and_late_as_everything_else(channels):
    actions = random_actions(30, 2, 2)
    truth = seen(PixelPoint([2], channels=channels), actions, "pixels")
    late = TransformedEnv(PixelPoint([2], channels=channels), ObservationLatency(["pixels"], 2))
    late = seen(late, actions, "pixels")
    dropout = ObservationDropout(["pixels", POSITION], 0.5, seed=0)
    held = TransformedEnv(PixelPoint([2], channels=channels), dropout)
    held = seen(held, actions, "pixels")
    assert late.dtype == held.dtype == torch.uint8
    assert late.shape == held.shape == truth.shape
    for time in range(2, 31):
        assert torch.equal(late[time], truth[time - 2])
        for slot in range(2):
            fresh = torch.equal(held[time, slot], truth[time, slot])
            assert fresh or torch.equal(held[time, slot], held[time - 1, slot])
    assert not torch.equal(held, truth)


def test_an_episode_starts_with_a_fresh_one():
    dropout = ObservationDropout([POSITION], 0.9, 5, seed=0)
    env = TransformedEnv(PointMass([3], episode_steps=4), dropout)
    starts = 0
    data = env.rollout(40, break_when_any_done=False, auto_reset=True)
    over = data["next", "done"].squeeze(-1)[:, :-1]
    for slot, time in over.nonzero().tolist():
        starts += 1
        assert not torch.equal(data[POSITION][slot, time + 1], data["next", POSITION][slot, time])
    assert starts == 3 * 9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"probability": 1.0}, r"probability: expected a number in \[0, 1\), got 1.0"),
        ({"probability": "0.5"}, "probability: expected a number in .* got '0.5'"),
        ({"probability": 0.1, "steps": 0}, "steps"),
    ],
)
def test_numbers_out_of_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ObservationDropout([POSITION], **arguments)


class ChangesInPlace(PointMass):
    """Shows one and the same tensor for a whole episode."""

    def _observe(self):
        out = super()._observe()
        if (self._steps == 0).all():
            self.__dict__["shown"] = out[POSITION].clone()
        self.shown.copy_(out[POSITION])
        return {**out, POSITION: self.shown}


def test_an_environment_that_changes_its_tensors_in_place_is_held_all_the_same():
    env = TransformedEnv(ChangesInPlace([1]), ObservationDropout([POSITION], 0.999, 3, seed=0))
    held = seen(env, random_actions(3, 1, 2))
    assert torch.equal(held[1], held[0])
