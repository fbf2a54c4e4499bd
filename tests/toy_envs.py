"""A small real environment for tests: a point that drifts on its way to a goal."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from rrl.slot_random import SlotGenerators

EPISODE_STEPS = 20
STEP_SIZE = 0.1  # metres that one unit of action moves the point
DRIFT = 0.06  # metres a step, along x
TOLERANCE = 0.03  # metres from the goal that count as success


class PointMass(EnvBase):
    """A point moves by ``STEP_SIZE * action`` and drifts along x; the goal is drawn at every reset.

    A proportional controller is left with a steady error, because it does not know the drift; a
    residual of DRIFT / STEP_SIZE against the drift removes it. Slots are independent: slot i is
    seeded seed + i.

    Args:
        batch_size: [] or [num_envs].
        dim: Number of coordinates n.
        action_key, nested: Where the action is read; nested actions live at ("arm", "action").
        bound: The action's bounds are [-bound, bound]; one metre is always STEP_SIZE actions.
        blind_reset: Zeros, not the current state, in the slots that a partial reset leaves alone.
    """

    def __init__(
        self,
        batch_size: tuple[int, ...] | list[int] = (),
        *,
        dim: int = 2,
        seed: int | None = 0,
        bound: float = 1.0,
        drift: float = DRIFT,
        episode_steps: int = EPISODE_STEPS,
        action_key: str | tuple[str, ...] = "action",
        blind_reset: bool = False,
    ) -> None:
        super().__init__(batch_size=torch.Size(batch_size), device="cpu")
        self.dim = dim
        self.episode_steps = episode_steps
        self._key = action_key
        self._bound = bound
        self._blind_reset = blind_reset
        self._drift = torch.zeros(dim)
        self._drift[0] = drift
        self._generators = SlotGenerators(seed, "point-mass")
        batch = self.batch_size
        self._position = torch.zeros(*batch, dim)
        self._goal = torch.zeros(*batch, dim)
        self._steps = torch.zeros(*batch, 1, dtype=torch.int64)
        self.observation_spec = Composite(
            end_effector_position=Unbounded((*batch, dim)),
            goal=Bounded(-1.0, 1.0, (*batch, dim)),
            success=Binary(1, (*batch, 1), dtype=torch.bool),
            shape=batch,
        )
        action = Bounded(-bound, bound, (*batch, dim))
        self.full_action_spec = Composite({action_key: action}, shape=batch)
        self.reward_spec = Unbounded((*batch, 1))
        done = Binary(1, (*batch, 1), dtype=torch.bool)
        self.full_done_spec = Composite(
            done=done, terminated=done.clone(), truncated=done.clone(), shape=batch
        )

    def _observe(self) -> dict[str, Tensor]:
        distance = (self._goal - self._position).norm(dim=-1, keepdim=True)
        return {
            "end_effector_position": self._position,
            "goal": self._goal,
            "success": distance < TOLERANCE,
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            mask = torch.ones(*self.batch_size, 1, dtype=torch.bool)
        mask = mask.reshape(*self.batch_size, 1)
        draw = self._generators.uniform(self.batch_size, (2, self.dim), mask)
        position, goal = (draw - 0.5).unbind(-2)
        self._position = torch.where(mask, position, self._position)
        self._goal = torch.where(mask, goal, self._goal)
        self._steps = torch.where(mask, 0, self._steps)
        out = self._observe()
        if self._blind_reset:
            out = {key: value * mask for key, value in out.items()}
        return TensorDict(out, batch_size=self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get(self._key)
        stepped = tensordict.get("_step", None)
        moved = self._position + action * (STEP_SIZE / self._bound) + self._drift
        steps = self._steps + 1
        if stepped is not None:
            stepped = stepped.reshape(*self.batch_size, 1)
            moved = torch.where(stepped, moved, self._position)
            steps = torch.where(stepped, steps, self._steps)
        self._position, self._steps = moved, steps
        reward = -(self._goal - moved).norm(dim=-1, keepdim=True)
        truncated = steps >= self.episode_steps
        out = self._observe() | {
            "reward": reward,
            "done": truncated,
            "terminated": torch.zeros_like(truncated),
            "truncated": truncated.clone(),
        }
        return TensorDict(out, batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._generators.seed(seed)


class OneSided(PointMass):
    """A point whose action has bounds that are not symmetric about 0; notes what it executed."""

    LOW, HIGH = (0.0, 2.0, -torch.inf, 5.0), (1.0, 4.0, torch.inf, torch.inf)

    def __init__(self, batch_size: tuple[int, ...] = ()) -> None:
        super().__init__(batch_size, dim=4)
        low, high = (torch.tensor(b).expand(*batch_size, 4) for b in (self.LOW, self.HIGH))
        self.full_action_spec = Composite(
            {"action": Bounded(low, high, (*batch_size, 4))}, shape=batch_size
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.executed = tensordict["action"].clone()
        return super()._step(tensordict)


class RememberingPointMass(PointMass):
    """A point whose state can be saved, as a simulator's can."""

    def get_extra_state(self):
        state = {"position": self._position, "goal": self._goal, "steps": self._steps}
        return {**state, "generators": self._generators.state_dict()}

    def set_extra_state(self, state):
        self._position, self._goal, self._steps = state["position"], state["goal"], state["steps"]
        self._generators.load_state_dict(state["generators"])


class ResetsItself(PointMass):
    """Starts the next episode within the step that ends one, as vectorized simulators do."""

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, **kwargs)
        self.__dict__["_torchrl_native_autoreset"] = True

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        out = super()._step(tensordict)
        if out["done"].any():
            again = self._reset(TensorDict({"_reset": out["done"]}, batch_size=self.batch_size))
            out.update(again)
        return out


class RemembersAndResetsItself(ResetsItself, RememberingPointMass):
    """Both."""
