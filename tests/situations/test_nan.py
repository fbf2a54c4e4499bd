"""A controller or a sensor gives NaN, with nothing said about safety."""

from functools import partial

import pytest
import torch
from torchrl.data import NonTensor, Unbounded

from rrl.controllers import ProportionalController
from situation_envs import Machine

ENTRIES = {"position": Unbounded((2,)), "target": Unbounded((2,))}


class Robot(Machine):
    """Its target is NaN from the fifth step on; a command that is none would break it."""

    def _observe(self):
        out = super()._observe()
        return out.set("target", torch.where(self._count >= 5, torch.nan, out["target"]))

    def _step(self, tensordict):
        assert tensordict["action"].isfinite().all(), "the robot got NaN"
        return super()._step(tensordict)


def test_the_robot_never_gets_it_and_it_is_counted(make_trainer, factory):
    controller = partial(ProportionalController, "position", "target")
    with make_trainer(factory(partial(Robot, ENTRIES), controller=controller)) as trainer:
        found = trainer.run()["training"].residual
    assert found.limited["finite"].tolist() == [1, 1]
    assert found.lengths.tolist() == [6, 6]  # the episode ends with that step


@pytest.mark.parametrize("key", ["success", ("metrics", "state")])
def test_text_that_would_be_reported_is_refused_by_name(make_trainer, factory, key):
    environment = factory(partial(Machine, {**ENTRIES, key: NonTensor(())}))
    name = key if isinstance(key, str) else "/".join(key)
    with pytest.raises(ValueError, match=rf"environment: {name}: expected one number .*, got text"):
        make_trainer(environment)
