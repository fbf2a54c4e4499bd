"""A controller or a sensor gives NaN, with nothing said about safety."""

import re
from functools import partial

import pytest
import torch
from torchrl.data import NonTensor, Unbounded

from rrl.controllers import ProportionalController
from rrl.trainers.seeds import Stream
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
        found = trainer.evaluator.play(trainer.policy, "training", Stream.FINAL, 2)
        with pytest.raises(FloatingPointError, match="expected finite numbers"):
            trainer.run()  # without the robot's objection
    assert found.limited["finite"].tolist() == [1, 1]
    assert found.lengths.tolist() == [6, 6]  # the episode ends with that step


class Flaky(Robot):
    """Its target is NaN in the fifth step of some episodes, and its reward with it."""

    episodes = 0

    def __init__(self, num_envs=None):
        super().__init__(ENTRIES, batch_size=[] if num_envs is None else [num_envs])

    def _reset(self, tensordict=None):
        self.episodes += 1
        return super()._reset(tensordict)

    def _observe(self):
        broken = (self._count == 5) & (self.episodes % 3 == 0)
        return Machine._observe(self).set(
            "target", torch.where(broken, torch.nan, torch.zeros(*self.batch_size, 2))
        )

    def _step(self, tensordict):
        out = super()._step(tensordict)
        return out.set("reward", out["reward"] + 0.0 * out["target"][..., :1])


class BlindAtResets(Machine):
    """Its target is NaN at every third reset."""

    resets = 0

    def _reset(self, tensordict=None):
        self.resets += 1
        out = super()._reset(tensordict)
        return out.set("target", out["target"] / 0.0) if self.resets % 3 == 0 else out


class FlakyController(ProportionalController):
    """It gives NaN of its own every twentieth time."""

    calls = 0

    def act(self, tensordict):
        self.calls += 1
        return super().act(tensordict) * (torch.nan if self.calls % 20 == 0 else 1.0)


@pytest.mark.parametrize(
    ("robot", "controller", "batching", "broken"),
    [
        (Flaky, ProportionalController, "native", "target"),
        (Flaky, ProportionalController, "serial", "target"),
        (partial(BlindAtResets, ENTRIES), ProportionalController, "serial", "target"),
        (partial(Machine, ENTRIES), FlakyController, "serial", "base_action"),
    ],
)
def test_the_policy_reads_it_and_training_goes_on(
    make_trainer, factory, caplog, robot, controller, batching, broken
):
    environment = factory(
        robot,
        inputs=["position", "target", "base_action"],
        controller=partial(controller, "position", "target"),
        batching=batching,
    )
    with make_trainer(environment) as trainer:
        trainer.run()
        stored = trainer.store.newest()
        steps = trainer.settings.total_steps
    assert trainer.store.log.count == steps
    assert all(value.isfinite().all() for value in stored.values(True, True))
    assert re.search(rf"\b{broken}\b.*: NaN or infinity; the episode ends", caplog.text)


@pytest.mark.parametrize("key", ["success", ("metrics", "state")])
def test_text_that_would_be_reported_is_refused_by_name(make_trainer, factory, key):
    environment = factory(partial(Machine, {**ENTRIES, key: NonTensor(())}))
    name = key if isinstance(key, str) else "/".join(key)
    with pytest.raises(ValueError, match=rf"environment: {name}: expected one number .*, got text"):
        make_trainer(environment)
