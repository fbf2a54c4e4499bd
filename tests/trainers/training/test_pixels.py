"""Runs that learn from images."""

from functools import partial

import pytest
import torch
from torch import nn
from torchrl.envs.transforms import CatFrames, PermuteTransform
from torchrl.modules import AdditiveGaussianModule

from pixel_envs import SIDE, PixelPoint, RememberingPixelPoint
from rrl.algorithms import SAC, TD3, mlp, no_exploration
from rrl.controllers import ProportionalController, ZeroController
from rrl.encoders import FrozenEncoder, automatic
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings
from rrl.trainers.storage.frame_memory import FrameMemory
from rrl.transforms import ObservationDropout, ObservationLatency
from runs import assert_same_run, run, run_until
from toy_envs import EPISODE_STEPS

POSITION = "end_effector_position"
SEEN = ("pixels", POSITION)
SMALL = {
    "network": partial(mlp, hidden=[64, 64], layer_norm=True),
    "encoder": partial(automatic, channels=[8, 16], kernels=[3, 3], strides=[2, 2], shift=1),
    "gamma": 0.9,
    "reward_scale": None,
}
LEARNERS = {
    "TD3": (TD3, {}),
    "ensemble": (TD3, {"num_critics": 3}),
    "SAC": (SAC, {}),
    "SAC ensemble": (SAC, {"num_critics": 3}),
}
LEARNING = {"total_steps": 1200, "warmup_steps": 200, "updates_per_step": 1.0, "batch_size": 64}


def point(num_envs=1, kind=PixelPoint, **arguments):
    return kind([num_envs], **{"drift": 0.0, **arguments})


class Average(nn.Module):
    """A network that somebody else has trained."""

    def __init__(self, side=4):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(()))
        self.pool = nn.AdaptiveAvgPool2d(side)

    def forward(self, images):
        return self.pool(images) * self.weight


@pytest.fixture
def seeing():
    """Builds a factory: the controller stands still, and only the picture shows the goal."""

    def make(inputs=SEEN, base=point, **changes):
        values = {"controller": ZeroController, "max_episode_steps": EPISODE_STEPS}
        values |= {"residual_scale": 1.0, **changes}
        return EnvironmentFactory(base=base, inputs=list(inputs), **values)

    return make


@pytest.fixture
def make(tmp_path):
    """Builds a trainer; by default one of a run that is over soon."""

    def make(environment, run_dir="run", learner="TD3", arguments=None, **changes):
        settings = {
            "total_steps": 120,
            "warmup_steps": 40,
            "controller_steps": 0,
            "steps_per_collection": 20 // changes.get("num_envs", 1),
            "batch_size": 16,
            "updates_per_step": 0.4,
            "n_step": 1,
            "buffer_capacity": 10_000,
            "evaluation": {"every": 0, "episodes": 5, "final_episodes": 20, "slots": 20},
            "acceptance": {"enabled": False},
            "checkpoint": {"every": 0},
        }
        algorithm, given = LEARNERS[learner]
        explore = partial(AdditiveGaussianModule, sigma_init=0.3, sigma_end=0.3)
        return Trainer(
            environment,
            TrainerSettings(**{**settings, **changes}),
            partial(algorithm, **{**SMALL, **given, **(arguments or {})}),
            no_exploration if algorithm is SAC else explore,
            tmp_path / run_dir,
        )

    return make


def gain(trainer):
    """How much better than the controller the policy is, in the sum of distances [m]."""
    with trainer:
        summary = trainer.run()["training"].summary()
    return summary["return"] - summary["controller_return"]


@pytest.mark.slow
@pytest.mark.parametrize("learner", ["TD3", "ensemble", "SAC"])
def test_a_policy_that_sees_the_goal_goes_there_and_a_blind_one_does_not(make, seeing, learner):
    """The controller ends 0.5 m away on average: 10 m over the 20 steps of an episode."""
    sees = gain(make(seeing(), "sees", learner, **LEARNING))
    blind = gain(make(seeing([POSITION]), "blind", learner, **LEARNING))
    assert sees > 6.0
    assert sees > blind + 3.0


@pytest.mark.slow
def test_critics_that_know_the_goal_teach_a_policy_to_see_it(make, seeing):
    environment = seeing(critic_inputs=[POSITION, "goal"])
    trainer = make(environment, **LEARNING)
    assert gain(trainer) > 6.0
    assert trainer.agent.policy.in_keys == list(SEEN)


@pytest.mark.parametrize("learner", LEARNERS)
def test_images_change_what_is_learned(make, seeing, learner):
    """Whatever else is equal: a run that sees is another than a blind one, and its encoder moves."""
    trainer = make(seeing(), learner=learner)
    before = {k: v.clone() for k, v in trainer.agent.encoder.named_parameters()}
    assert before
    run(trainer)
    for name, value in trainer.agent.encoder.named_parameters():
        assert not torch.equal(value, before[name]), name
    assert trainer.store.newest()["pixels"].unique().numel() > 10


BASES = {
    "one": (partial(RememberingPixelPoint, []), "serial", 1, {}),
    "native": (partial(point, kind=RememberingPixelPoint), "native", 2, {}),
    "serial": (partial(RememberingPixelPoint, []), "serial", 2, {"n_step": 3}),
    "parallel": (partial(RememberingPixelPoint, [], channels="first"), "parallel", 2, {}),
    "two cameras": (partial(RememberingPixelPoint, [], cameras=2), "serial", 1, {"n_step": 2}),
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(k, marks=() if k in ("native", "two cameras") else pytest.mark.slow)
        for k in BASES
    ],
)
def test_a_run_that_dies_is_the_run_that_never_died(make, seeing, kind):
    base, batching, num_envs, changes = BASES[kind]
    inputs = [*SEEN, "pixels_1"] if kind == "two cameras" else SEEN
    environment = seeing(inputs, base=base, batching=batching)
    changes = {"num_envs": num_envs, "checkpoint": {"every": 40}, **changes}
    whole = run(make(environment, "whole", **changes))
    run_until(make(environment, "broken", **changes), "agent.update", 60)
    resumed = make(environment, "broken", **changes)
    resumed.resume()
    assert resumed.collection.can_continue
    assert resumed.env_steps == 40
    assert_same_run(whole, run(resumed))
    for key in ("pixels", ("next", "pixels")):
        assert torch.equal(whole.store.newest()[key], resumed.store.newest()[key])


def test_a_machine_that_cannot_go_on_learns_again_from_stored_images(make, seeing):
    environment = seeing(base=partial(PixelPoint, []), batching="serial")
    changes = {"checkpoint": {"every": 40}}
    broken = make(environment, **changes)
    run_until(broken, "store.extend", 60)
    resumed = make(environment, **changes)
    resumed.resume()
    assert (resumed.env_steps, resumed.store.pending) == (40, 40)
    run(resumed)
    expected = broken.store.newest()["pixels"]
    assert torch.equal(resumed.store.newest()["pixels"][: len(expected)], expected)


def test_stacked_late_and_lost_frames_are_learned_from(make, seeing):
    sensing = [
        partial(ObservationLatency, ["pixels"], 1),
        partial(ObservationDropout, ["pixels"], 0.2, 2),
        partial(PermuteTransform, dims=[-1, -3, -2], in_keys=["pixels"]),
        partial(CatFrames, N=3, dim=-3, in_keys=["pixels"]),
    ]
    environment = seeing(base=partial(PixelPoint, []), batching="serial", sensing=sensing)
    trainer = run(make(environment))
    stored = trainer.store.newest()["pixels"]
    assert stored.shape == (120, 9, SIDE, SIDE)
    (log,) = (entry.log for entry in trainer.store.images._entries.values())
    assert log.count <= 120 + 120 / EPISODE_STEPS


def test_a_frozen_network_is_run_and_never_changed(make, seeing):
    trainer = make(seeing(), arguments={"encoder": partial(FrozenEncoder, network=Average)})
    run(trainer)
    assert trainer.agent.encoder.network.weight == 1
    assert trainer.agent.encoder.out_features == 3 * 16 + 2
    assert not trainer.agent.readings.learn


def test_a_controller_that_knows_only_the_robot_is_left_as_it_is(make, seeing):
    """Scale 0: what is executed is the controller's action, whatever the camera sees."""
    controller = partial(ProportionalController, gain=5.0, clip=0.5)
    with_camera = seeing(controller=controller, residual_scale=0.0)
    without = seeing([POSITION], controller=controller, residual_scale=0.0)
    rewards = []
    for i, environment in enumerate((with_camera, without)):
        trainer = make(environment, f"run {i}")
        rewards.append(run(trainer).store.newest()["next", "reward"])
    assert torch.equal(*rewards)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("learner", LEARNERS)
def test_so_it_is_on_a_gpu(make, seeing, learner):
    trainer = run(make(seeing(), learner=learner, device="cuda"))
    assert trainer.store.sample(1)["pixels"].device.type == "cuda"
    assert next(trainer.agent.encoder.parameters()).device.type == "cuda"


class LooksAtFirst(nn.Module):
    """Derives something from the images of all transitions, in the order of its inputs."""

    def __init__(self, inputs):
        super().__init__()
        self.scale, self.out_features = nn.Parameter(torch.ones(2)), 2

    def calibrate(self, pixels, position):
        return {"pixels": {"mean": float(pixels.float().mean())}}

    def forward(self, pixels, position):
        return position * self.scale


@pytest.mark.parametrize("encoder", [SMALL["encoder"], LooksAtFirst], ids=["numbers", "images"])
def test_only_images_that_something_is_derived_from_are_unpacked(
    make, seeing, monkeypatch, encoder
):
    unpacked, get = [], FrameMemory.get

    def watched(memory, numbers):
        unpacked.append(len(numbers))
        return get(memory, numbers)

    monkeypatch.setattr(FrameMemory, "get", watched)
    trainer = run(make(seeing(), total_steps=100, warmup_steps=80, arguments={"encoder": encoder}))
    assert trainer.agent.is_calibrated
    assert (max(unpacked) >= 80) is (encoder is LooksAtFirst)  # else four batches of 16 at most
