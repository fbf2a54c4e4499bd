"""Environments that bring transforms of TorchRL's along, trained and resumed."""

from functools import partial

import pytest
from torchrl.data import Bounded, Unbounded
from torchrl.envs import (
    ActionScaling,
    CatFrames,
    CatTensors,
    Compose,
    FrameSkipTransform,
    InitTracker,
    ObservationNorm,
    RenameTransform,
    RewardClipping,
    RewardScaling,
    RewardSum,
    StepCounter,
    TimeMaxPool,
    TransformedEnv,
    UnsqueezeTransform,
)

from situation_envs import Simulator

ENTRIES = {"position": Unbounded((2,)), "goal": Unbounded((2,)), "force": Unbounded((3,))}
ACTION = Bounded(-2.0, 3.0, (2,))


def eleven():
    """As people stack them."""
    return Compose(
        StepCounter(max_steps=7),
        InitTracker(),
        RewardSum(),
        ObservationNorm(loc=0.5, scale=2.0, in_keys=["position"]),
        RewardScaling(loc=0.1, scale=0.5),
        RewardClipping(-2.0, 2.0),
        CatFrames(N=3, dim=-1, in_keys=["goal"], out_keys=["goals"]),
        TimeMaxPool(in_keys=["force"], out_keys=["peak"], T=2),
        CatTensors(in_keys=["position", "peak"], out_key="state", del_keys=False),
        RenameTransform(in_keys=["goals"], out_keys=["last goals"]),
        UnsqueezeTransform(dim=-2, in_keys=["state"], out_keys=["row"]),
    )


KEPT = ["position", "last goals", "state"]


def transformed(transforms=eleven, batch_size=()):
    return TransformedEnv(Simulator(ENTRIES, ACTION, batch_size=batch_size), transforms())


def native(num_envs=1, **arguments):
    return transformed(batch_size=[num_envs], **arguments)


def check(check_run, environment):
    """TorchRL does not tell the state below such transforms: a resumed run begins an episode."""
    _, resumed, stored = check_run(environment, num_envs=2, steps_per_collection=10)
    assert not resumed.collection.can_continue
    return stored


@pytest.mark.parametrize(
    "batching", ["serial", "native", pytest.param("parallel", marks=pytest.mark.slow)]
)
def test_all_eleven_are_trained_and_resumed(check_run, factory, caplog, batching):
    base = native if batching == "native" else transformed
    stored = check(check_run, factory(base, KEPT, batching=batching))
    assert "cannot be restored" not in caplog.text
    assert stored["last goals"].shape[1:] == (6,)
    assert stored["state"].shape[1:] == (5,)
    assert stored["next", "reward"].max() <= 2
    ends = stored["next", "done"][:60].reshape(-1, 2).all(-1).nonzero().flatten()
    assert ends.tolist() == [6, 13, 20, 27]


ACTIONS = {
    "scaled": lambda: Compose(ActionScaling()),
    "skipped": lambda: Compose(FrameSkipTransform(2), StepCounter(max_steps=4)),
}


@pytest.mark.parametrize("kind", ACTIONS)
def test_actions_are_changed_below_the_controllers(check_run, factory, kind):
    base = partial(transformed, ACTIONS[kind])
    stored = check(check_run, factory(base))
    assert (stored["action"].abs() <= 1).all()
