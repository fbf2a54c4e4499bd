"""An environment's factory whose parts are something else: refused by name before anything is collected."""

from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded

from rrl.controllers import ZeroController
from rrl.envs import InsertionEnv, RobotEnv, gymnasium_env
from rrl.robot import Description, EntrySpec, Observation, Robot
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings
from rrl.transforms import StepLimit
from situation_envs import Machine


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"safety": StepLimit}, "safety: expected a list of what makes transforms, got"),
        (
            {"inputs": {"position"}},
            "inputs: expected names in their order, in a list, got {'position'}",
        ),
        ({"inputs": {"position": {}}}, r"inputs: expected 'position' to be a Input\(...\), got {}"),
        ({"metrics": {"force": {"unit": "N"}}}, "metrics: expected 'force' to be a Metric"),
        ({"batching": "natve"}, "batching: expected one of native, serial, parallel, got 'natve'"),
        ({"max_episode_steps": 0}, "max_episode_steps: expected a whole number above 0, got 0"),
        ({"max_episode_steps": 50.0}, "max_episode_steps: expected a whole number above 0, got 50"),
    ],
)
def test_a_field_that_is_something_else_is_named(changes, message):
    fields = {"base": Machine, "controller": ZeroController, "inputs": ["position"], **changes}
    with pytest.raises((TypeError, ValueError), match=message):
        EnvironmentFactory(**fields)


def nothing():
    Machine()


def of_gymnasium():
    gymnasium = pytest.importorskip("gymnasium")
    return gymnasium.make("Pendulum-v1")


@pytest.mark.parametrize(
    ("base", "message"),
    [
        (nothing, "base: expected what makes a torchrl.envs.EnvBase, got None$"),
        (of_gymnasium, "base: expected .*, got a TimeLimit; rrl.envs.gymnasium_env makes one"),
    ],
)
@pytest.mark.parametrize("slots", [1, 2])
def test_a_base_that_is_no_environment_is_refused(factory, base, message, slots):
    with pytest.raises(TypeError, match=message):
        factory(base).make(slots)


class Rewards(Machine):
    """Has the rewards that are given, by name, without batch dimensions."""

    def __init__(self, **rewards):
        super().__init__()
        self.full_reward_spec = Composite(
            {name: Unbounded(shape) for name, shape in rewards.items()}
        )


@pytest.mark.parametrize(
    "rewards", [{"reward": (2,)}, {"rewards": (1,)}, {"reward": (1,), "cost": (1,)}]
)
def test_a_reward_that_is_not_one_number_is_refused(factory, rewards):
    with pytest.raises(ValueError, match=r"reward: expected one entry 'reward' of the shape \[1\]"):
        factory(partial(Rewards, **rewards)).make()


class Arm(Robot):
    """Describes itself, and does nothing."""

    description = Description({"reward": EntrySpec((1,))}, (-1.0,), (1.0,), period=0.05)
    command = reset = stop = lambda *_: None
    clock = 0.0

    def observe(self):
        self.clock += 1.0
        return Observation({"reward": np.zeros(1)}, self.clock)


@pytest.mark.parametrize(("period", "fits"), [(None, True), (0.05, True), (0.1, False)])
def test_the_control_period_is_the_robot_s_own(factory, period, fits):
    made = factory(partial(RobotEnv, Arm), ["base_action"], control_period=period)
    if fits:
        assert made.make().base_env.control_period == 0.05
    else:
        with pytest.raises(ValueError, match=r"control_period: expected null or 0\.05.*, got 0.1"):
            made.make()


def test_gymnasium_s_environment_fits(factory):
    pytest.importorskip("gymnasium")
    env = factory(partial(gymnasium_env, "Pendulum-v1"), ["observation"]).make()
    assert torch.isfinite(env.reset()["observation"]).all()


def test_a_folder_in_the_learner_s_place_is_named(factory, tmp_path):
    with pytest.raises(TypeError, match="agent: expected what makes a learner, or None, got 'out'"):
        Trainer(factory(Machine), None, "out", run_dir=tmp_path)


def test_something_else_than_a_factory_and_settings_is_named(factory, tmp_path):
    with pytest.raises(
        TypeError, match=r"settings: expected TrainerSettings\(...\) or None, got {"
    ):
        Trainer(factory(Machine), {"seed": 1}, run_dir=tmp_path)
    with pytest.raises(TypeError, match=r"environment: expected EnvironmentFactory.*, got <class"):
        Trainer(Machine, run_dir=tmp_path)


@pytest.mark.parametrize(("settings", "got"), [(None, "None"), (TrainerSettings(), "TrainerS.*")])
def test_settings_before_the_environment_are_named(factory, tmp_path, settings, got):
    with pytest.raises(TypeError, match=rf"^environment: .*, got {got}; it comes before the sett"):
        Trainer(settings, factory(Machine), run_dir=tmp_path)


def test_a_trainer_refuses_the_seeds_of_several_runs(factory, tmp_path):
    expected = r"^num_seeds: expected 1, .* got 5; .*`rrl train trainer.num_seeds=5`"
    with pytest.raises(ValueError, match=expected):
        Trainer(factory(Machine), TrainerSettings(num_seeds=5), run_dir=tmp_path)


@pytest.mark.parametrize(("batching", "batch_size"), [("serial", [3]), ("native", [3])])
def test_another_number_of_slots_than_asked_for_is_refused(factory, batching, batch_size):
    base = partial(Slots, batch_size) if batching == "native" else partial(Machine, batch_size=[3])
    with pytest.raises(ValueError, match=r"base: expected an environment of 1 slots .*got .*\[3\]"):
        factory(base, batching=batching).make(1)


class Slots(Machine):
    """Has as many slots as it likes."""

    def __init__(self, batch_size, num_envs):
        super().__init__(batch_size=batch_size)


class InPlace(Machine):
    """Shows tensors of its own, which it goes on to use."""

    def __init__(self):
        super().__init__({"position": Unbounded((2,)), "goal": Unbounded((2,))})
        self.shown, self.goal = torch.zeros(2), torch.ones(2)

    def _observe(self):
        self.shown += 1.0
        return TensorDict({"position": self.shown, "goal": self.goal})


def test_what_an_environment_shows_is_copied(factory):
    env = factory(InPlace).make()
    first = env.reset()
    seen = first["position"].clone()
    second = env.step(first.set("action", torch.zeros(2)))["next"]
    assert torch.equal(first["position"], seen)
    assert not torch.equal(second["position"], seen)
    first.zero_()
    second.zero_()
    assert torch.equal(env.base_env.goal, torch.ones(2))


NEW = [partial(InsertionEnv, "sim", num_envs=2), partial(InsertionEnv, "real", num_envs=2)]


@pytest.mark.parametrize("make", [*NEW, partial(RobotEnv, Arm)], ids=["sim", "real", "robot"])
def test_who_says_so_makes_new_tensors(make):
    env = make()
    assert env.makes_new_tensors
    given = [env.reset()]
    for _ in range(2):
        given.append(env._step(given[-1].clone().set("action", env.action_spec.zero())))
    storages = [v.untyped_storage().data_ptr() for td in given for v in td.values(True, True)]
    assert len(set(storages)) == len(storages)
