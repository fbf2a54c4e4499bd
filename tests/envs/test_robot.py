"""A robot's description is an environment's specs, whatever NumPy calls its types."""

import numpy as np
import pytest
from torchrl.envs.utils import check_env_specs

from rrl.envs import RobotEnv
from rrl.robot import Description, EntrySpec, Observation, Robot


class Described(Robot):
    """Measures ones, of whatever shape and type it says; its first step is the last."""

    def __init__(self, **entries):
        entries = {"reward": EntrySpec((1,)), **entries}
        self.description = Description(entries, (-1.0,), (1.0,), period=0.001)
        self._clock = 0.0

    def observe(self):
        self._clock += 1.0
        described = self.description.entries.items()
        entries = {name: np.ones(shape, dtype) for name, (shape, dtype) in described}
        if "terminated" in entries:
            entries["terminated"][...] = self._moves
        return Observation(entries, self._clock)

    def command(self, action):
        self._moves = True

    def reset(self, seed=None):
        self._moves = False

    def stop(self):
        pass


@pytest.mark.parametrize(
    "entries",
    [
        {"success": EntrySpec((), "bool"), "terminated": EntrySpec((), "bool")},
        {"terminated": EntrySpec((1, 1), "bool")},
        {"reward": EntrySpec((), "float64")},
        {"reward": EntrySpec((1, 1), "int32")},
        {"position": EntrySpec((2,), "<f4"), "height": EntrySpec((), ">f8")},
        {"position": EntrySpec([2, 3])},
    ],
)
def test_one_number_may_have_no_shape_and_types_go_by_any_name(entries):
    env = RobotEnv(Described(**entries))
    check_env_specs(env)
    following = env.rollout(1)["next"]
    assert following["reward"].tolist() == [[1.0]]
    assert following["terminated"].item() == ("terminated" in entries)
    for name, (shape, dtype) in entries.items():
        if name not in ("reward", "terminated"):
            assert following[name].shape == (1, *(shape or (1,)))
            assert following[name].numpy().dtype == np.dtype(dtype).newbyteorder("=")
    env.close()


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"reward": EntrySpec((3,))}, r"expected 'reward' to be one number, got \(3,\)"),
        ({"truncated": EntrySpec((2,), "bool")}, "expected 'truncated' to be one number"),
        ({"name": EntrySpec((1,), "U8")}, "expected 'name' of a type that .* got 'U8'"),
        ({"name": EntrySpec((1,), "number")}, "expected 'name' of a type that .* got 'number'"),
    ],
)
def test_an_entry_that_cannot_be_is_named(entries, message):
    with pytest.raises(ValueError, match=rf"description\.entries: {message}"):
        RobotEnv(Described(**entries))
