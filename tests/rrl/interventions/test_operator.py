"""A scripted operator takes over as often as it should, and is as clumsy as it should be."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import step_mdp

from rrl.controllers import FunctionController, ZeroController
from rrl.interventions import ScriptedOperator
from toy_envs import EPISODE_STEPS, PointMass
from transform_cases import POSITION, proportional


def ones() -> FunctionController:
    return FunctionController(torch.ones_like, [POSITION], batched=True, numpy=False)


def watch(operator: ScriptedOperator, slots: int, steps: int) -> TensorDict:
    """What it says in ``steps`` steps of one episode."""
    seen = [operator(TensorDict({POSITION: torch.zeros(slots, 2)}, [slots])) for _ in range(steps)]
    return torch.stack(seen, -1)


def test_it_takes_over_a_share_of_the_episodes_for_some_steps() -> None:
    taken = watch(ScriptedOperator(ones, share=0.2, steps=3, seed=0), 2000, 5)["taken_over"][..., 0]
    assert taken[:, 0].float().mean() == pytest.approx(0.2, abs=0.03)
    assert torch.equal(taken[:, 0], taken[:, 2]) and not taken[:, 3:].any()


def test_commands_of_whole_numbers_are_noisy_as_others() -> None:
    def make() -> FunctionController:
        return FunctionController(lambda position: [1, 0], [POSITION])

    said = watch(ScriptedOperator(make, noise=0.3, seed=0), 500, 1)["operator_action"]
    assert said.std(0).flatten().tolist() == pytest.approx([0.3, 0.3], abs=0.03)


def test_every_episode_is_drawn_anew() -> None:
    operator, env = ScriptedOperator(proportional(), share=0.5, seed=3), PointMass((1,))
    taken = []
    td = env.reset()
    for step in range(40 * EPISODE_STEPS):
        if step % EPISODE_STEPS == 0:
            operator.reset()
            td = env.reset()
            taken.append(bool(operator(td.copy())["taken_over"]))
        td = step_mdp(env.step(td.set("action", torch.zeros(1, 2))))
    assert 10 < sum(taken) < 30


def test_a_competent_one_commands_what_its_controller_does() -> None:
    td = PointMass((5,)).reset()
    expected = proportional().act(td)
    assert torch.equal(ScriptedOperator(proportional())(td)["operator_action"], expected)


def test_a_clumsy_one_is_noisy_and_pushes_the_wrong_way() -> None:
    clumsy = ScriptedOperator(ones, noise=0.1, reversed_share=0.25, seed=0)
    command = watch(clumsy, 500, 8)["operator_action"]
    wrong = command.mean(-1) < 0
    assert wrong.float().mean() == pytest.approx(0.25, abs=0.03)
    assert (command.abs() - 1).std() == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"share": 1.5}, "share: expected a number in"),
        ({"reversed_share": -0.1}, "reversed_share: expected a number in"),
        ({"noise": float("inf")}, "noise: expected a number of at least 0"),
        ({"steps": 0}, "steps: expected a whole number"),
    ],
)
def test_numbers_out_of_range_are_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ScriptedOperator(ZeroController, **arguments)
