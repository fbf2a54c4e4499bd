"""Several agents share a slot: actions ``[*batch, n, n_act]``, masks ``[*batch]``."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv, check_env_specs
from torchrl.envs.transforms import Compose

from rrl.controllers import (
    Controller,
    FunctionController,
    PIDController,
    ReplayController,
    SumController,
    ZeroController,
)
from rrl.interventions import ScriptedOperator
from rrl.transforms import FiniteAction, Intervention, ResidualAction

AGENTS = 2
FLAGS = ("done", "terminated", "truncated")
ACTION, POSITION = ("agents", "action"), ("agents", "position")


class Team(EnvBase):
    """Agents on a plane, who move by a tenth of their actions."""

    def __init__(self, batch: tuple[int, ...]) -> None:
        super().__init__(batch_size=torch.Size(batch))
        shape = (*batch, AGENTS, 2)
        position, action = Unbounded(shape), Bounded(-1.0, 1.0, shape)
        self.observation_spec = self._of_agents(position=position)
        self.full_action_spec = self._of_agents(action=action)
        self.reward_spec = Unbounded((*batch, 1))
        flags = {key: Binary(1, (*batch, 1), dtype=torch.bool) for key in FLAGS}
        self.full_done_spec = Composite(flags, shape=batch)
        self._position = torch.zeros(shape)

    def _of_agents(self, **specs) -> Composite:
        shape = self.batch_size
        return Composite(agents=Composite(specs, shape=(*shape, AGENTS)), shape=shape)

    def _seen(self, **entries) -> TensorDict:
        agents = TensorDict({"position": self._position}, (*self.batch_size, AGENTS))
        return TensorDict({"agents": agents, **entries}, self.batch_size)

    def _reset(self, tensordict=None, **kwargs) -> TensorDict:
        return self._seen()

    def _step(self, tensordict) -> TensorDict:
        self._position = self._position + 0.1 * tensordict[ACTION]
        nothing = torch.zeros(*self.batch_size, 1)
        return self._seen(reward=nothing, **{key: nothing.bool() for key in FLAGS})

    def _set_seed(self, seed) -> None:
        pass


def back() -> Controller:
    return FunctionController(lambda position: -position, [POSITION])


CONTROLLERS = {
    "zero": ZeroController,
    "replay": lambda: ReplayController(torch.full((3, AGENTS, 2), 0.5)),
    "function": back,
    "pid": lambda: PIDController(POSITION, POSITION, integral_gain=0.1),
    "sum": lambda: SumController([ZeroController(), back()]),
}


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_and_an_operator_of_it(name: str, batch: tuple[int, ...]) -> None:
    operator = ScriptedOperator(CONTROLLERS[name], steps=2, noise=0.1, reversed_share=0.5)
    chain = Compose(
        Intervention(operator, 10.0, action_key=ACTION),
        ResidualAction(CONTROLLERS[name](), action_key=ACTION),
    )
    env = TransformedEnv(Team(batch), chain)
    check_env_specs(env)
    active = env.rollout(3)["next", "agents", "intervention", "active"]
    assert active.shape == (*batch, 3, AGENTS, 1)
    assert active.unbind(-3)[0].all() and not active.unbind(-3)[2].any()


@pytest.mark.parametrize("slots", [AGENTS, 3])
def test_steps_and_resets_of_one_slot_leave_the_others_alone(slots: int) -> None:
    chain = Compose(
        FiniteAction(action_key=ACTION),
        Intervention(ScriptedOperator(back), 10.0, action_key=ACTION),
        ResidualAction(back(), action_key=ACTION),
    )
    env = TransformedEnv(Team((slots,)), chain)
    env.reset(TensorDict({"_reset": torch.arange(slots) == 0}, [slots]))
    alone = TransformedEnv(Team((slots,)), FiniteAction(action_key=ACTION))
    broken = alone.rand_action(alone.reset())
    broken[ACTION][1, 0] = torch.nan
    for stepped in (0, 1):
        step = alone.step(broken.clone().set("_step", torch.arange(slots) == stepped))
        truncated = step["next", "truncated"].flatten()
        assert truncated.tolist() == [slot == stepped == 1 for slot in range(slots)]
