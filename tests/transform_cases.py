"""What the tests of the transforms share: one case for each transform, and a driver."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import CatTensors, Compose, ObservationNorm, Transform
from torchrl.envs.utils import step_mdp

from rrl.controllers import (
    PIDController,
    ProportionalController,
    ReplayController,
    StatefulController,
    SumController,
)
from rrl.interventions import ScriptedOperator
from rrl.transforms import (
    ActionHistory,
    ControlNoise,
    EpisodeValue,
    FiniteAction,
    FiniteObservation,
    ForceLimit,
    Intervention,
    JudgedSuccess,
    ObservationDropout,
    ObservationLatency,
    ObservationNoise,
    ResidualAction,
    StepLimit,
    WorkspaceLimit,
)
from toy_envs import PointMass

POSITION = "end_effector_position"
Factory = Callable[[int | None], Transform]


def proportional() -> ProportionalController:
    return ProportionalController(gain=0.5, clip=0.8, unit=0.1)


def with_memory() -> SumController:
    pid = PIDController(gain=0.3, integral_gain=0.5, derivative_gain=0.01, unit=0.1)
    replay = ReplayController([[0.1, 0.0], [0.0, -0.2], [0.3, 0.3]], after_end="zero")
    return SumController([pid, replay], weights=[1.0, [0.5, 1.5]], clip=0.9)


class Plan(StatefulController):
    """Plans five actions, all of them the goal, plays them, and plans again.

    Its memory nests, holds integers, and does not start at zero: a new slot has to plan first.
    """

    LENGTH = 5

    def __init__(self) -> None:
        super().__init__([POSITION, "goal"])

    def initial_state(self, tensordict: TensorDictBase) -> dict:
        goal = self.read(tensordict, "goal")
        plan = torch.full((*goal.shape[:-1], self.LENGTH, goal.shape[-1]), 0.9)
        played = torch.full(goal.shape[:-1], self.LENGTH)
        return {"plan": {"actions": plan, "played": played}, "episode_steps": played - self.LENGTH}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        state, goal = self.state_for(tensordict), self.read(tensordict, "goal")
        actions, played = state["plan"]["actions"], state["plan"]["played"]
        over = played >= self.LENGTH
        actions = torch.where(over[..., None, None], goal.unsqueeze(-2), actions)
        played = torch.where(over, 0, played)
        self.state = {
            "plan": {"actions": actions, "played": played + 1},
            "episode_steps": state["episode_steps"] + 1,
        }
        index = played[..., None, None].expand(*played.shape, 1, actions.shape[-1])
        return actions.gather(-2, index).squeeze(-2)


def residual(seed: int | None) -> Transform:
    return ResidualAction(proportional(), scale=0.5)


def residual_with_memory(seed: int | None) -> Transform:
    return ResidualAction(with_memory(), scale=[0.5, 1.0])


def residual_with_plan(seed: int | None) -> Transform:
    return ResidualAction(Plan(), scale=0.3)


def residual_on_policy(seed: int | None) -> Transform:
    layer = nn.Linear(2, 2)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor([[0.5, 0.1], [-0.2, 0.3]]))
        layer.bias.zero_()
    return ResidualAction(TensorDictModule(layer, in_keys=[POSITION], out_keys=["action"]))


def control_noise(seed: int | None) -> Transform:
    return ControlNoise(mu=[0.2, -0.1], sigma=0.3, seed=seed)


def observation_noise(seed: int | None) -> Transform:
    return ObservationNoise([POSITION], sigma=[0.1, 0.2], bias=0.05, seed=seed)


def observation_noise_beside(seed: int | None) -> Transform:
    keys = [POSITION, "goal"]
    return ObservationNoise(keys, sigma=0.1, seed=seed, out_keys=["seen", ("camera", "goal")])


def latency(seed: int | None) -> Transform:
    return ObservationLatency([POSITION], steps=2, seed=seed)


def tracker(seed: int | None) -> Transform:
    keys = [POSITION, "goal"]
    out = [POSITION, ("camera", "goal")]
    return ObservationLatency(keys, 1, update_interval=2, dropout=0.4, seed=seed, out_keys=out)


def outages(seed: int | None) -> Transform:
    keys = [POSITION, "goal"]
    return ObservationDropout(
        keys, 0.4, steps=2, seed=seed, out_keys=[POSITION, ("camera", "goal")]
    )


def workspace_limit(seed: int | None) -> Transform:
    return WorkspaceLimit(low=-0.3, high=[0.3, 0.4], unit=0.1, delay=1)


def step_limit(seed: int | None) -> Transform:
    return StepLimit(size=[0.5, 0.8], change=0.4)


def force_limit(seed: int | None) -> Transform:
    """The position stands in for a force: it is measured, two-dimensional and changes slowly."""
    return ForceLimit(
        limit=0.3, stiffness=0.5, force_key=POSITION, axes=[0, 1], onset=0.1, retract=0.2
    )


def finite_action(seed: int | None) -> Transform:
    return FiniteAction()


def finite_observation(seed: int | None) -> Transform:
    return FiniteObservation([POSITION, "goal"])


def action_history(seed: int | None) -> Transform:
    return ActionHistory(3, out_key=("memory", "action"))


def episode_value(seed: int | None) -> Transform:
    """The point writes whether it has arrived."""
    return EpisodeValue({"success": "sum"})


def judged_success(seed: int | None) -> Transform:
    return JudgedSuccess(("judged", "success"))


def residual_history(seed: int | None) -> Transform:
    return Compose(residual(seed), ActionHistory(2))


def operated(seed: int | None) -> Transform:
    """Somebody with a plan of their own takes over the first steps of half of the episodes."""
    operator = ScriptedOperator(
        with_memory(), 0.5, steps=4, noise=0.2, reversed_share=0.2, seed=seed
    )
    intervention = Intervention(operator, step_limit=[0.2, 0.3])
    return Compose(intervention, residual_with_plan(seed), ActionHistory(2))


def safe_residual(seed: int | None) -> Transform:
    limits = workspace_limit(seed), force_limit(seed), step_limit(seed), finite_action(seed)
    return Compose(*limits, control_noise(seed), residual_with_memory(seed))


def chain(seed: int | None) -> Transform:
    """Everything at once, in the order of a training run."""
    return Compose(
        control_noise(seed),
        ObservationNoise([POSITION], sigma=0.01, seed=seed),
        ObservationLatency([POSITION], steps=1, dropout=0.2, seed=seed),
        residual_with_memory(seed),
        ObservationNorm(loc=0.5, scale=2.0, in_keys=[POSITION]),
        CatTensors([POSITION, "goal", "base_action"], "observation", del_keys=False),
    )


CASES: dict[str, Factory] = {
    factory.__name__: factory
    for factory in (
        residual,
        residual_with_memory,
        residual_with_plan,
        residual_on_policy,
        control_noise,
        observation_noise,
        observation_noise_beside,
        latency,
        tracker,
        outages,
        workspace_limit,
        step_limit,
        force_limit,
        finite_action,
        finite_observation,
        action_history,
        episode_value,
        judged_success,
        residual_history,
        operated,
        safe_residual,
        chain,
    )
}


def make_env(factory: Factory, batch: tuple[int, ...] = (), seed: int | None = 0) -> TransformedEnv:
    return TransformedEnv(PointMass(batch, seed=seed), factory(seed))


def drive(
    env: EnvBase, actions: Tensor, resets: Tensor | None = None, start: TensorDictBase | None = None
) -> list[TensorDictBase]:
    """Step through ``actions`` [T, *batch, n] and record it all.

    After step t the slots of ``resets[t]`` [*batch, 1] are reset.
    """
    tensordict = env.reset() if start is None else start
    seen = [tensordict.clone()]
    for step, action in enumerate(actions):
        tensordict.set("action", action.clone())
        tensordict = env.step(tensordict)
        seen.append(tensordict.clone())
        tensordict = step_mdp(tensordict)
        if resets is not None and resets[step].any():
            tensordict.set("_reset", resets[step].clone())
            tensordict = env.reset(tensordict)
            seen.append(tensordict.clone())
    return seen


def assert_same(one: list[TensorDictBase], other: list[TensorDictBase]) -> None:
    """Hold two recordings to each other, bit for bit, key for key."""
    assert len(one) == len(other)
    for step, (a, b) in enumerate(zip(one, other, strict=True)):
        assert set(a.keys(True, True)) == set(b.keys(True, True))
        for key in a.keys(True, True):
            assert torch.equal(a.get(key), b.get(key)), f"{key} differs at record {step}"


def staggered(steps: int, slots: int) -> Tensor:
    """Resets that come at another time in every slot, bool [T, slots, 1]."""
    time = torch.arange(steps).reshape(-1, 1, 1)
    return (time + 1) % (3 + torch.arange(slots).reshape(1, -1, 1)) == 0


def random_actions(*shape: int, seed: int = 7) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) * 2 - 1
