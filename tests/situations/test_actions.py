"""Actions of every kind: trained, or refused before anything is stored."""

from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded, Categorical, OneHot, Unbounded
from torchrl.envs import RenameTransform, TransformedEnv

from rrl.controllers import ZeroController
from rrl.transforms import Intervention, StepLimit
from situation_envs import Machine, Simulator

TRAINED = {
    "one": Bounded(-1.0, 1.0, (1,)),
    "three": Bounded(torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([1.0, 3.0, 5.0]), (3,)),
    "float64": Bounded(-1.0, 1.0, (2,), dtype=torch.float64),
    "float16": Bounded(-1.0, 1.0, (2,), dtype=torch.float16),
    "bfloat16": Bounded(-1.0, 1.0, (2,), dtype=torch.bfloat16),
    "unbounded": Unbounded((2,)),
    "from zero on": Bounded(torch.zeros(2), torch.full((2,), torch.inf), (2,)),
    "one of two bounded": Bounded(
        torch.tensor([-1.0, -torch.inf]), torch.tensor([1.0, torch.inf]), (2,)
    ),
    "a dimension without range": Bounded(torch.tensor([-1.0, 0.5]), torch.tensor([1.0, 0.5]), (2,)),
}
REFUSED = {
    "scalar": Bounded(-1.0, 1.0, ()),
    "matrix": Bounded(-1.0, 1.0, (2, 2)),
    "discrete": Categorical(4),
    "one-hot": OneHot(4),
    "int64": Bounded(-3, 3, (2,), dtype=torch.int64),
    "empty": Unbounded((0,)),
    "bounds exchanged": Bounded(torch.tensor([-1.0, 1.0]), torch.tensor([1.0, -1.0]), (2,)),
}


@pytest.mark.parametrize("name", TRAINED)
def test_an_action_is_trained(check_run, factory, name):
    _, _, stored = check_run(factory(partial(Simulator, action=TRAINED[name])), True)
    assert stored["action"].shape[1:] == TRAINED[name].shape
    assert (stored["action"].abs() <= 1).all()


class AtTheBounds(ZeroController):
    """It commands more than there is."""

    def act(self, tensordict):
        return super().act(tensordict) + 1.0


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16])
def test_a_command_at_the_bounds_is_within_them(check_run, factory, dtype):
    machine = partial(Simulator, action=Bounded(-0.1, 0.1, (2,), dtype=dtype))  # it checks
    check_run(factory(machine, controller=AtTheBounds), True)


def test_a_policy_may_read_the_base_action_of_a_dimension_without_range(check_run, factory):
    action = TRAINED["a dimension without range"]
    inputs = ["position", "base_action"]
    _, _, stored = check_run(factory(partial(Simulator, action=action), inputs), True)
    assert stored["base_action"].isfinite().all()


def takes_over_in_the_third_step():
    steps = iter(range(100))

    def device(position):
        return torch.tensor([0.8, 0.5]), torch.tensor([next(steps) >= 2])

    return TensorDictModule(device, ["position"], ["operator_action", "taken_over"])


LIMITED = {
    "operator": (0.3, {"intervention": partial(Intervention, takes_over_in_the_third_step, 0.3)}),
    "limit": (0.1, {"safety": [partial(StepLimit, change=0.1)], "controller": AtTheBounds}),
}


@pytest.mark.parametrize("kind", LIMITED)
def test_a_dimension_without_range_holds_up_no_other(factory, kind):
    step, changes = LIMITED[kind]
    action = TRAINED["a dimension without range"]
    env = factory(partial(Simulator, action=action), **changes).make(1, operated=True)
    pushes, td = [], env.reset()
    for _ in range(6):
        td = env.step(td.set("action", torch.zeros(2)))["next"]
        pushes.append(float(env.base_env._push) * 2 - 0.5)  # what the dimension with one was given
    expected = (
        [0.0, 0.0, 0.3, 0.6, 0.8, 0.8] if kind == "operator" else [k * step for k in range(1, 7)]
    )
    assert pushes == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", REFUSED)
def test_an_action_is_refused_before_anything_is_stored(make_trainer, factory, tmp_path, name):
    with pytest.raises((TypeError, ValueError), match=r"^action: expected .*, got"):
        make_trainer(factory(partial(Machine, action=REFUSED[name])))
    assert not list((tmp_path / "run").rglob("*.*"))


def test_an_action_of_another_name_is_refused_by_name(make_trainer, factory):
    with pytest.raises(KeyError, match=r"action: expected .*'action', got \('arm', 'action'\)"):
        make_trainer(factory(partial(Machine, action_key=("arm", "action"))))


def test_a_second_action_is_refused_by_name(make_trainer, factory):
    class TwoHands(Machine):
        def __init__(self):
            super().__init__()
            spec = self.full_action_spec
            spec["gripper"] = Bounded(-1.0, 1.0, (1,))
            self.full_action_spec = spec

    with pytest.raises(ValueError, match=r"action: expected no other .*, got action, gripper"):
        make_trainer(factory(TwoHands))


def renamed():
    """What the message asks for: the nested action under the usual name."""
    env = Machine(action_key=("arm", "action"))
    rename = RenameTransform([], [], [("arm", "action")], ["action"])
    return TransformedEnv(env, rename)


def test_a_nested_action_is_trained_under_the_usual_name(check_run, factory):
    check_run(factory(renamed))
