"""Safety limits hold whatever is asked for, and count what they changed."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import (
    ActionScaling,
    Compose,
    DTypeCastTransform,
    ObservationNorm,
    RenameTransform,
)
from torchrl.envs.utils import step_mdp

from rrl.controllers import ZeroController
from rrl.transforms import (
    ControlNoise,
    FiniteAction,
    ForceLimit,
    ObservationLatency,
    ResidualAction,
    StepLimit,
    WorkspaceLimit,
)
from toy_envs import STEP_SIZE, PointMass, ResetsItself
from transform_cases import POSITION, drive, proportional, random_actions

BOX = {"low": -0.5, "high": [0.5, 0.55]}  # PointMass starts in it


def wild(*limits, drift=0.0):
    """A point under controller, full residual and strong noise, which could break a limit."""
    chain = Compose(
        *limits, ControlNoise(mu=0.3, sigma=0.8, seed=0), ResidualAction(proportional())
    )
    return TransformedEnv(PointMass((4,), seed=0, drift=drift, episode_steps=1000), chain)


def test_the_box_is_never_left() -> None:
    env = wild(WorkspaceLimit(**BOX, unit=STEP_SIZE))
    positions = torch.stack([td[POSITION] for td in drive(env, random_actions(300, 4, 2))])
    low, high = torch.tensor([-0.5, -0.5]), torch.tensor([0.5, 0.55])
    assert (positions >= low - 1e-6).all()
    assert (positions <= high + 1e-6).all()
    assert (positions > high - 1e-3).any()  # it was tried


def test_a_margin_keeps_commands_off_the_faces() -> None:
    env = wild(WorkspaceLimit(**BOX, unit=STEP_SIZE, margin=[0.1, 0.2]), drift=0.0)
    positions = torch.stack([td[POSITION] for td in drive(env, random_actions(300, 4, 2))])[20:]
    torch.testing.assert_close(
        positions.amax((0, 1)), torch.tensor([0.4, 0.35]), atol=1e-3, rtol=0.0
    )
    torch.testing.assert_close(
        positions.amin((0, 1)), torch.tensor([-0.4, -0.3]), atol=1e-3, rtol=0.0
    )


def test_from_outside_the_box_only_the_way_back_is_left() -> None:
    env = TransformedEnv(
        PointMass((), drift=0.0), WorkspaceLimit(low=2.0, high=3.0, unit=STEP_SIZE)
    )
    step = env.step(env.reset().set("action", torch.tensor([-1.0, 0.5])))
    moved = step["next", POSITION] - step[POSITION]
    torch.testing.assert_close(moved, torch.tensor([STEP_SIZE, STEP_SIZE]))
    assert step["next", "safety", "workspace"].all()


class Single(PointMass):
    """Takes actions in single precision alone."""

    def _step(self, tensordict):
        assert tensordict["action"].dtype == torch.float32
        return super()._step(tensordict)


def test_a_measurement_of_another_precision_leaves_the_actions_as_it_is() -> None:
    cast = DTypeCastTransform(torch.float32, torch.float64, in_keys=[POSITION])
    limit = WorkspaceLimit(**BOX, unit=STEP_SIZE)
    records = drive(TransformedEnv(Single((4,)), Compose(cast, limit)), random_actions(8, 4, 2))
    assert records[-1][POSITION].dtype == torch.float64


@pytest.mark.parametrize(
    "limit",
    [
        WorkspaceLimit(low=-10.5, high=10.5, unit=100 * STEP_SIZE),
        WorkspaceLimit(low=-10.0, high=10.0, unit=0.5),
        ForceLimit(limit=10.0, stiffness=0.5, force_key=POSITION, axes=[0, 1], onset=0.5),
    ],
)
def test_a_measurement_of_whole_numbers_counts_as_others(limit) -> None:
    def records(*casts):
        ticks = ObservationNorm(loc=0.0, scale=100.0, in_keys=[POSITION])
        whole = DTypeCastTransform(torch.float32, torch.int64, in_keys=[POSITION])
        chain = Compose(ticks, whole, *casts, limit.clone())
        env = TransformedEnv(PointMass((4,), drift=0.0), chain)
        return torch.stack([td[POSITION] for td in drive(env, random_actions(30, 4, 2))])

    back = DTypeCastTransform(torch.int64, torch.float32, in_keys=[POSITION])
    assert torch.equal(records().float(), records(back))


def test_size_and_change_of_what_is_executed() -> None:
    records = drive(wild(StepLimit(size=0.5, change=0.2)), random_actions(100, 4, 2))
    executed = torch.stack([td["next", "executed_action"] for td in records[1:]])
    changes = torch.cat([executed[:1], executed.diff(dim=0)])
    assert executed.abs().max() == pytest.approx(0.5)
    assert changes.abs().max() == pytest.approx(0.2)
    assert records[0]["safety", "step"].any().item() is False


@pytest.mark.parametrize(
    ("nearer", "point"),
    [
        (partial(ActionScaling, loc=0.0, scale=10.0), {"bound": 10.0}),
        (lambda: ResidualAction(ZeroController(), scale=0.5), {}),
        (lambda: RenameTransform([], [], ["joint"], ["action"]), {"action_key": "joint"}),
    ],
    ids=["scaled", "residual", "renamed"],
)
def test_the_last_action_has_the_units_of_its_place(nearer, point) -> None:
    """The last command is not a number, and what was given before is held."""
    limits = WorkspaceLimit(-9.0, 9.0, delay=1), StepLimit(change=0.1), FiniteAction()
    chain = Compose(nearer(), *limits, ControlNoise(executed_action_key="sent"))
    env = TransformedEnv(PointMass((1,), drift=0.0, **point), chain)
    actions = torch.ones(5, 1, 2)
    actions[-1] = torch.nan
    moved = torch.stack([td["next", POSITION] - td[POSITION] for td in drive(env, actions)[1:]])
    moved = moved[:, 0, 0]
    torch.testing.assert_close(moved / moved[0], torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0]))


def test_an_absolute_target_starts_from_what_the_robot_holds() -> None:
    limits = StepLimit(change=0.05, start_key=POSITION), FiniteAction(start_key=POSITION)
    env = TransformedEnv(PointMass((3,), seed=0), Compose(*limits, ControlNoise()))
    actions = torch.ones(1, 3, 2)
    actions[0, 2, 0] = torch.nan
    start, step = drive(env, actions)
    change = (step["next", "executed_action"] - start[POSITION]).abs().amax(-1)
    torch.testing.assert_close(change, torch.tensor([0.05, 0.05, 0.0]))


def test_workspace_first_keeps_the_box_under_the_other_limits() -> None:
    limits = (
        WorkspaceLimit(**BOX, unit=STEP_SIZE),
        ForceLimit(0.2, 0.2, force_key=POSITION, axes=[0, 1], retract=1.0),
        StepLimit(change=0.1),
    )
    records = drive(wild(*limits), random_actions(300, 4, 2))
    positions = torch.stack([td[POSITION] for td in records])
    assert positions.min() >= -0.5 - 1e-6
    assert positions.max() <= 0.55 + 1e-6


def test_a_violation_is_counted_where_and_only_where_the_action_was_changed() -> None:
    env = TransformedEnv(PointMass((4,), seed=0), StepLimit(size=0.5))
    actions = random_actions(20, 4, 2)
    flags = torch.stack([td["next", "safety", "step"] for td in drive(env, actions)[1:]])
    assert torch.equal(flags, (actions.abs() > 0.5).any(-1, keepdim=True))
    free = TransformedEnv(PointMass((4,), seed=0), StepLimit(size=1.0))
    bare = PointMass((4,), seed=0)
    for mine, other in zip(drive(free, actions), drive(bare, actions), strict=True):
        assert torch.equal(mine[POSITION], other[POSITION])
        assert not mine["safety", "step"].any()


@pytest.mark.parametrize("kind", [PointMass, ResetsItself])
def test_the_step_that_ends_an_episode_counts(kind) -> None:
    env = TransformedEnv(kind((3,), episode_steps=4), StepLimit(size=0.5))
    td = env.reset()
    for step in range(1, 9):
        ends = step % 4 == 0
        pushed = torch.tensor([[0.1], [1.0], [float(ends)]]).expand(3, 2)
        out = env.step(env.maybe_reset(td).set("action", pushed))
        assert out["next", "safety", "step"].flatten().tolist() == [False, True, ends]
        assert out["next", "done"].all() == ends
        td = step_mdp(out)


def test_a_change_keeps_to_the_line_and_so_to_a_force_limit_behind_it() -> None:
    """Executed by dimension, the same change would leave the ball that the force limit allows."""
    limits = StepLimit(change=0.3), ForceLimit(1.0, 1.0)
    records = drive(wild(*limits), random_actions(300, 4, 2))
    executed = torch.stack([td["next", "executed_action"] for td in records[1:]])
    assert executed.norm(dim=-1).max() <= 1.0 + 1e-6
    assert executed.norm(dim=-1).max() > 0.99
    assert executed.diff(dim=0).abs().max() == pytest.approx(0.3)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_late_position_keeps_the_box_if_the_limit_knows_how_late(delay) -> None:
    def positions(known: int) -> torch.Tensor:
        chain = Compose(
            ObservationLatency([POSITION], steps=delay, out_keys=["late"]),
            WorkspaceLimit(**BOX, unit=STEP_SIZE, delay=known, position_key="late"),
        )
        env = TransformedEnv(PointMass((4,), seed=0, drift=0.0, episode_steps=1000), chain)
        return torch.stack([td[POSITION] for td in drive(env, random_actions(300, 4, 2).sign())])

    low, high = torch.tensor([-0.5, -0.5]) - 1e-6, torch.tensor([0.5, 0.55]) + 1e-6
    inside = positions(delay)
    assert ((inside >= low) & (inside <= high)).all()
    assert (inside > high - 0.02).any()  # it was tried
    if delay:
        outside = positions(0)
        assert ((outside < low) | (outside > high)).any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: WorkspaceLimit(0.1, 0.1), "high: expected numbers above low"),
        (lambda: WorkspaceLimit(0.1, 0.3, margin=0.15), "high: expected numbers above low"),
        (lambda: WorkspaceLimit(0.1, 0.3, margin=-0.1), "margin: expected numbers of at least 0"),
        (lambda: WorkspaceLimit([0.0] * 3, [1.0] * 2), "high: expected one number or 3"),
        (lambda: WorkspaceLimit(0.0, [1.0] * 2, margin=[0.1] * 3), "margin: expected one .* or 2"),
        (lambda: WorkspaceLimit(0.0, 1.0, unit=0.0), "unit: expected positive"),
        (lambda: StepLimit(), "got neither"),
        (lambda: StepLimit(size=-1.0), "size: expected positive"),
        (lambda: WorkspaceLimit(0.0, 1.0, delay=-1), "delay: expected a whole number"),
        (lambda: ForceLimit(0.0, 1.0), "limit: expected positive"),
        (lambda: ForceLimit([10.0, 20.0], 1.0), "limit: expected one number"),
        (lambda: ForceLimit(1.0, 1.0, retract=[0.1, 0.1]), "retract: expected one number"),
        (lambda: ForceLimit(1.0, 0.0), "stiffness: expected positive"),
        (lambda: ForceLimit(1.0, 1.0, unit=-1.0), "unit: expected positive"),
        (lambda: ForceLimit(1.0, 1.0, onset=1.0), "onset: expected a force in"),
        (lambda: ForceLimit(1.0, 1.0, retract=-0.1), "retract: expected numbers of at least 0"),
        (lambda: ForceLimit(1.0, 1.0, axes=[0, 0]), "different dimensions"),
    ],
)
def test_bad_parameters_are_named(make, message) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        (WorkspaceLimit([0.0] * 3, 1.0), "low: expected one number or 2"),
        (StepLimit(size=[1.0] * 3), "size: expected one number or 2"),
        (StepLimit(1.0, start_key="success"), "'success': expected 2 numbers, .* action, got 1"),
        (ForceLimit(1.0, [1.0] * 3), "stiffness: expected one number or 2"),
        (ForceLimit(1.0, 1.0, force_key=POSITION), "axes: expected dimensions of a force of 2"),
    ],
)
def test_sizes_that_do_not_fit_the_environment(limit, message) -> None:
    with pytest.raises(ValueError, match=message):
        TransformedEnv(PointMass(), limit).observation_spec  # noqa: B018 - computing it is the test


def test_a_missing_measurement_and_a_missing_reset_are_named() -> None:
    with pytest.raises(KeyError, match="'wrench'"):
        TransformedEnv(PointMass(), ForceLimit(1.0, 1.0, force_key="wrench")).observation_spec  # noqa: B018 - computing it is the test
    env = TransformedEnv(PointMass(), StepLimit(size=0.5))
    with pytest.raises(RuntimeError, match="expected a reset before the first step"):
        env.step(TensorDict({"action": torch.zeros(2)}))
