"""What a limit on the force leaves of a command, and how hard an arm presses under it."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from torchrl.data import Bounded
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose
from torchrl.envs.utils import step_mdp

from rrl.envs import InsertionEnv
from rrl.transforms import ForceLimit
from rrl.transforms.base import limits_of
from transform_cases import random_actions

SOFT = 1e-3  # N/m: no command is long enough for the bound


def force_of(limit: ForceLimit, action: list[float], force: list[float]) -> list[float]:
    bounds = limits_of(Bounded(-1.0, 1.0, [len(action)]))
    safe = limit.limit(torch.tensor(action), torch.tensor(force), bounds)
    return [round(x, 5) for x in safe.tolist()]


@pytest.mark.parametrize(
    ("force", "action", "expected"),
    [
        ([0.0, 0.0, 0.0], [0.3, 0.0, -1.0], [0.3, 0.0, -1.0]),  # free
        ([0.0, 0.0, 10.0], [0.3, 0.0, -1.0], [0.3, 0.0, -1.0]),  # below the onset
        ([0.0, 0.0, 30.0], [0.3, 0.0, -1.0], [0.3, 0.0, -0.5]),  # half-way to the limit
        ([0.0, 0.0, 50.0], [0.3, 0.0, -1.0], [0.3, 0.0, 0.0]),  # beyond: along the surface only
        ([0.0, 0.0, 50.0], [0.3, 0.0, 0.7], [0.3, 0.0, 0.7]),  # away from it
        ([30.0, 0.0, 40.0], [-1.0, 0.5, 0.75], [-1.0, 0.5, 0.75]),  # along an oblique surface
    ],
)
def test_motion_against_the_force(force, action, expected) -> None:
    limit = ForceLimit(40.0, SOFT, force_key="wrench", onset=20.0)
    assert force_of(limit, action, force) == expected


def test_retreat_and_hard_stop() -> None:
    limit, action = partial(ForceLimit, 40.0, SOFT, force_key="wrench"), [0.3, 0.0, -1.0]
    assert force_of(limit(retract=0.25), action, [0.0, 0.0, 41.0]) == [0.3, 0.0, 0.25]
    assert force_of(limit(), action, [0.0, 0.0, 39.0]) == action
    assert force_of(limit(axes=[2]), action, [41.0]) == [0.3, 0.0, 0.0]


@pytest.mark.parametrize("unit", [1.0, 0.02, [0.05, 0.01, 0.2]])
@pytest.mark.parametrize("retract", [0.0, 0.1])
def test_above_the_limit_no_command_presses_on(unit, retract) -> None:
    """Whatever an action unit stands for in each dimension, and also at the action's bounds."""
    limit = ForceLimit(1.0, SOFT, unit=unit, force_key="force", retract=retract)
    force, action = random_actions(500, 3, seed=1), random_actions(500, 3, seed=2)
    normal = force / force.norm(dim=-1, keepdim=True)
    bounds = limits_of(Bounded(-1.0, 1.0, [500, 3]))
    safe = limit.limit(action, 2.0 * normal, bounds)
    along = (safe * torch.tensor(unit) * normal).sum(-1)
    assert along.min() >= -1e-6 * torch.tensor(unit).max()
    assert safe.abs().max() <= 1.0 + 1e-6
    free = (action * torch.tensor(unit) * normal).sum(-1) > retract * torch.tensor(unit).max()
    assert free.any() and torch.equal(safe[free], action[free])


@pytest.mark.parametrize(
    ("stiffness", "action", "expected"),
    [
        (100.0, [0.3, 0.0, -0.4], [0.3, 0.0, -0.4]),  # 10 N
        (100.0, [0.6, 0.0, -0.8], [0.3, 0.0, -0.4]),  # 20 N: half as long, in the same direction
        ([50.0, 100.0, 100.0], [0.6, 0.0, 0.8], [0.35112, 0.0, 0.46816]),  # 17.1 N
    ],
)
def test_a_displacement_is_shortened_to_what_the_stiffness_allows(stiffness, action, expected):
    assert force_of(ForceLimit(10.0, stiffness, unit=0.2), action, []) == expected


def pressing(*limits) -> torch.Tensor:
    """Vertical force [T, 3] in N, while three arms push down on whatever is there."""
    env = TransformedEnv(InsertionEnv("real", num_envs=3, seed=0), Compose(*limits))
    td, forces = env.reset(), []
    for _ in range(50):
        td = env.step(td.set("action", torch.tensor([[0.0, 0.0, -1.0]] * 3)))
        forces.append(td["next", "force_z"].squeeze(-1).abs())
        td = step_mdp(td)
    return torch.stack(forces)


def test_an_arm_does_not_keep_pressing_where_the_force_is_measured() -> None:
    limit = ForceLimit(13.0, SOFT, force_key="force_z", axes=[2], onset=3.0, retract=0.2)
    sustained = slice(30, None)
    assert pressing(limit)[sustained].mean() < pressing()[sustained].mean() / 2


def test_an_arm_never_presses_harder_than_the_limit() -> None:
    assert pressing(ForceLimit(15.0, 3000.0, unit=0.02)).max() < 15.0 < pressing().max()
