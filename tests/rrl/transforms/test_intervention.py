"""An operator's command is executed without a jump, and recorded as the residual that gives it."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose
from torchrl.envs.utils import step_mdp

from rrl.controllers import ReplayController, ZeroController
from rrl.interventions import ScriptedOperator
from rrl.transforms import ActionHistory, ControlNoise, Intervention, ResidualAction
from toy_envs import PointMass, ResetsItself
from transform_cases import POSITION, drive, proportional, random_actions

FREE = 10.0  # a step limit that no command comes to


class Hand(nn.Module):
    """Whoever holds the device: what it commands, and when."""

    def __init__(self, command: list[float], engaged: list[bool]) -> None:
        super().__init__()
        self.command, self.engaged, self.step = torch.tensor(command), engaged, -1

    def forward(self, position: Tensor) -> tuple[Tensor, Tensor]:
        self.step += 1
        engaged = self.engaged[min(self.step, len(self.engaged) - 1)]
        batch = position.shape[:-1]
        return self.command.expand_as(position), torch.full((*batch, 1), engaged)


def by_hand(command: list[float], engaged: list[bool], step_limit: float = FREE) -> Intervention:
    hand = Hand(command, engaged)
    operator = TensorDictModule(hand, [POSITION], ["operator_action", "taken_over"])
    return Intervention(operator, step_limit)


def world(
    intervention: Intervention, scale: float | list[float] = 0.5, **arguments
) -> TransformedEnv:
    residual = ResidualAction(proportional(), scale=scale)
    chain = Compose(ControlNoise(), intervention, residual, ActionHistory(1))
    return TransformedEnv(PointMass((1,), **arguments), chain)


def test_the_command_is_executed_and_its_residual_recorded() -> None:
    env = world(by_hand([0.3, -0.2], [False, True, True, False]), scale=[0.5, 2.0])
    seen = drive(env, random_actions(4, 1, 2))
    span = torch.tensor([0.5, 2.0])
    for step, record in enumerate(seen[1:]):
        told, executed = record["next", "intervention"], record["next", "executed_action"]
        taken = step in (1, 2)
        assert bool(told["active"]) is taken
        if taken:
            assert torch.equal(executed, torch.tensor([[0.3, -0.2]]))
            asked = (executed - record["base_action"]) / span
            assert torch.allclose(told["action"], asked.clamp(-1, 1), atol=1e-6)
            assert bool(told["exceeds"]) == bool((asked.abs() > 1).any())
        said = told["action"] if taken else record["action"]
        assert torch.equal(record["next", "previous_action"], said)


def test_without_an_operator_at_work_it_is_the_plain_chain_bit_for_bit() -> None:
    plain = TransformedEnv(
        PointMass((3,)),
        Compose(ControlNoise(), ResidualAction(proportional(), scale=0.5), ActionHistory(1)),
    )
    idle = ScriptedOperator(ZeroController, share=0.0)
    operated = TransformedEnv(
        PointMass((3,)),
        Compose(
            ControlNoise(),
            Intervention(idle, FREE),
            ResidualAction(proportional(), scale=0.5),
            ActionHistory(1),
        ),
    )
    actions = random_actions(25, 3, 2)
    for one, other in zip(drive(plain, actions), drive(operated, actions), strict=True):
        for key in one.keys(True, True):
            assert torch.equal(one[key], other[key])


@pytest.mark.parametrize("limit", [0.05, 0.2])
def test_neither_handover_jumps(limit: float) -> None:
    engaged = [False] * 5 + [True] * 40 + [False] * 40
    env = world(by_hand([-0.9, 0.9], engaged, limit), drift=0.0, episode_steps=100)
    seen = drive(env, torch.zeros(80, 1, 2))
    executed = torch.stack([s["next", "executed_action"][0] for s in seen[1:]])
    active = torch.stack([s["next", "intervention", "active"][0, 0] for s in seen[1:]])
    change = executed.diff(dim=0).abs().amax(-1)
    assert change[4:].max() <= limit + 1e-6
    assert (executed[44] == torch.tensor([-0.9, 0.9])).all()  # it comes to what was commanded
    assert active[5:45].all()
    assert active[45] and not active[-1]  # on the way back it is not the policy's yet
    back = int(active.nonzero().max()) + 1
    controller = torch.stack([s["base_action"][0] for s in seen[1:]])
    assert torch.equal(executed[back:], controller[back:].clamp(-1, 1))


def test_an_episode_may_begin_with_the_operator_without_a_handover() -> None:
    env = world(by_hand([1.0, 1.0], [True], step_limit=0.01))
    assert torch.equal(
        drive(env, torch.zeros(1, 1, 2))[1]["next", "executed_action"], torch.ones(1, 2)
    )


def test_where_the_residual_has_no_authority_the_operator_has() -> None:
    env = world(by_hand([0.4, 0.4], [True]), scale=[0.0, 2.0])
    record = drive(env, torch.ones(1, 1, 2))[1]
    assert torch.equal(record["next", "executed_action"], torch.full((1, 2), 0.4))
    assert record["next", "intervention", "exceeds"].all()
    assert record["next", "intervention", "action"][0, 0] == 0.0


def test_a_command_outside_the_bounds_is_clipped_before_its_residual_is_taken() -> None:
    env = world(by_hand([5.0, 0.0], [True]), scale=2.0)
    record = drive(env, torch.zeros(1, 1, 2))[1]
    expected = (torch.tensor([[1.0, 0.0]]) - record["base_action"]) / 2.0
    assert torch.allclose(record["next", "intervention", "action"], expected)
    assert not record["next", "intervention", "exceeds"].any()


@pytest.mark.parametrize(
    ("said", "command", "exceeds"),
    [(1.5, 1.0, False), (1.5, 0.95, True), (1.1, 0.95, False), (1.1, 0.85, True)],
)
def test_a_controller_beyond_the_bounds_is_clipped_and_exceeds_nothing(
    said: float, command: float, exceeds: bool
) -> None:
    """A residual of at most 0.2 adds to what the controller says, and the sum is clipped to 1."""

    def record(action: Tensor, *operator: Intervention) -> TensorDict:
        residual = ResidualAction(ReplayController([[said, said]]), scale=0.2)
        chain = Compose(ControlNoise(), *operator, residual)
        return drive(TransformedEnv(PointMass((1,)), chain), action.unsqueeze(0))[1]["next"]

    told = record(torch.zeros(1, 2), by_hand([command] * 2, [True]))["intervention"]
    assert bool(told["exceeds"]) is exceeds
    executed = record(told["action"])["executed_action"]
    assert torch.allclose(executed, torch.full((1, 2), command)) is not exceeds


def test_a_device_among_the_observations_is_an_operator() -> None:
    device = TensorDictModule(
        lambda goal, success: (goal, ~success),
        ["goal", "success"],
        ["operator_action", "taken_over"],
    )
    env = TransformedEnv(
        PointMass((4,)), Compose(Intervention(device, FREE), ResidualAction(proportional(), 0.5))
    )
    first = env.reset()
    record = env.step(first.set("action", torch.zeros(4, 2)))
    assert torch.equal(record["next", "intervention", "active"], ~first["success"])


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_a_command_that_is_not_finite_counts_as_not_taken_over(bad: float, caplog) -> None:
    def device(position: Tensor) -> tuple[Tensor, Tensor]:
        command = torch.full_like(position, 0.3)
        command[0, 1] = bad
        return command, torch.ones_like(position[:, :1], dtype=torch.bool)

    operator = TensorDictModule(device, [POSITION], ["operator_action", "taken_over"])
    residual = ResidualAction(proportional(), 0.5)
    chain = Compose(ControlNoise(), Intervention(operator, FREE), residual)
    seen = drive(TransformedEnv(PointMass((2,)), chain), random_actions(3, 2, 2))
    for record in seen[1:]:
        told = record["next", "intervention"]
        assert told["active"].flatten().tolist() == [False, True]
        assert told["action"].isfinite().all()
        expected = (record["base_action"] + 0.5 * record["action"]).clamp(-1, 1)[0]
        assert torch.equal(record["next", "executed_action"][0], expected)
        assert torch.equal(record["next", "executed_action"][1], torch.full((2,), 0.3))
    assert caplog.text.count("such a command counts as not taken over") == 1


def test_beside_a_controller_that_is_lost_an_operator_is_executed_and_exceeds() -> None:
    class Lost(ZeroController):
        def act(self, tensordict):
            return super().act(tensordict) + torch.nan

    chain = Compose(by_hand([0.3, 0.3], [True]), ResidualAction(Lost(), 0.5))
    env = TransformedEnv(PointMass((1,)), Compose(ControlNoise(), *chain.transforms))
    record = drive(env, torch.zeros(1, 1, 2))[1]
    assert torch.equal(record["next", "executed_action"], torch.full((1, 2), 0.3))
    assert record["next", "intervention", "exceeds"].all()
    assert torch.equal(record["next", "intervention", "action"], torch.zeros(1, 2))


def test_an_operator_who_writes_too_little_is_told() -> None:
    mute = TensorDictModule(lambda x: x, [POSITION], ["operator_action"])
    with pytest.raises(KeyError, match="expected the entry 'taken_over'"):
        world(Intervention(mute, FREE)).reset()
    wide = TensorDictModule(lambda x: (x, x > 0), [POSITION], ["operator_action", "taken_over"])
    with pytest.raises(ValueError, match=r"taken_over: expected the shape \(1, 1\), got \(1, 2\)"):
        world(Intervention(wide, FREE)).reset()


def test_it_stands_in_front_of_a_residual_of_an_environment_that_is_reset_from_outside() -> None:
    chain = Compose(ResidualAction(proportional()), by_hand([0.0, 0.0], [False]))
    with pytest.raises(RuntimeError, match="expected a ResidualAction of 'action' behind it"):
        TransformedEnv(PointMass((1,)), chain).reset()
    chain = Compose(by_hand([0.0, 0.0], [False]), ResidualAction(proportional()))
    with pytest.raises(RuntimeError, match="reset from outside, got one that resets itself"):
        TransformedEnv(ResetsItself((1,)), chain).reset()


def test_of_two_arms_it_overrules_its_own() -> None:
    left, right = ("left", "action"), ("right", "action")
    arms = [ResidualAction(ZeroController(2), action_key=key) for key in (right, left)]
    intervention = Intervention(ScriptedOperator(ZeroController), FREE, action_key=left)
    env = TransformedEnv(PointMass(action_key=left), Compose(intervention, *arms))
    assert env.transform[0].residual_action() is env.transform[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step_limit": 0.0}, "step_limit: expected positive numbers"),
        ({"step_limit": [0.1, 0.1, 0.1]}, "step_limit: expected one number or 2"),
    ],
)
def test_a_step_limit_has_to_fit(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        drive(
            world(Intervention(ScriptedOperator(proportional()), **arguments)), torch.zeros(1, 1, 2)
        )


def test_nested_actions_have_their_entries_beside_them() -> None:
    env = TransformedEnv(
        PointMass((), action_key=("arm", "action")),
        Compose(
            Intervention(ScriptedOperator(proportional()), FREE, action_key=("arm", "action")),
            ResidualAction(ZeroController(), action_key=("arm", "action")),
        ),
    )
    td = env.reset()
    td["arm", "action"] = torch.zeros(2)
    out = step_mdp(env.step(td))
    assert isinstance(out, TensorDict) and out["arm", "intervention", "active"].all()
