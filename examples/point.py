"""An environment of the user's own for the other examples: a point in a plane that drifts on its way to a goal."""

import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

STEP = 0.1  # metres that the point can move in one step
DRIFT = torch.tensor([0.06, 0.0])  # metres a step
EPISODE = 20  # steps


class Point(EnvBase):
    """Reads ``action`` [2]; writes ``position`` [2] m, ``goal`` [2] m, ``reward`` and ``success``.

    It reports ``("metrics", "effort")`` [1], how hard it was pushed: the length of the last action.

    Args:
        absolute: The action is the position to go to, in metres within [-1, 1]^2; else it is the displacement, in
            units of ``STEP`` within [-1, 1]^2.
    """

    def __init__(self, absolute=False):
        super().__init__(batch_size=[])
        self.absolute = absolute
        self.generator = torch.Generator()
        self.observation_spec = Composite(
            position=Unbounded([2]),
            goal=Bounded(-1.0, 1.0, [2]),
            success=Binary(1, [1], dtype=torch.bool),
            metrics=Composite(effort=Unbounded([1])),
        )
        self.action_spec = Bounded(-1.0, 1.0, [2])
        self.reward_spec = Unbounded([1])
        flag = Binary(1, [1], dtype=torch.bool)
        self.full_done_spec = Composite(done=flag, truncated=flag.clone(), terminated=flag.clone())

    def _reset(self, tensordict=None, **kwargs):
        self.position, self.goal = (torch.rand(2, 2, generator=self.generator) - 0.5).unbind(0)
        self.steps, self.effort = 0, torch.zeros(1)
        return TensorDict(self.observe(), [])

    def _step(self, tensordict):
        action = tensordict["action"]
        self.effort = action.norm().reshape(1)
        delta = (action - self.position).clamp(-STEP, STEP) if self.absolute else action * STEP
        self.position, self.steps = self.position + delta + DRIFT, self.steps + 1
        truncated = torch.tensor([self.steps >= EPISODE])
        ends = {
            "done": truncated,
            "truncated": truncated.clone(),
            "terminated": torch.zeros(1, dtype=torch.bool),
        }
        return TensorDict({**self.observe(), **ends, "reward": -self.distance()}, [])

    def observe(self):
        """Return all observations."""
        near, metrics = self.distance() < 0.03, {"effort": self.effort}
        return {"position": self.position, "goal": self.goal, "success": near, "metrics": metrics}

    def distance(self):
        """Return the distance to the goal, [1] m."""
        return (self.goal - self.position).norm().reshape(1)

    def _set_seed(self, seed):
        self.generator.manual_seed(seed or 0)
