"""What a round of collected transitions says of itself."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded

from rrl.trainers.settings import AcceptanceSettings, EvaluationSettings
from toy_envs import PointMass


class Telling(PointMass):
    """Reports all that there is a name for."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, drift=0.0, **kwargs)
        number = Unbounded((*self.batch_size, 1))
        for group, name in (("reward_terms", "near"), ("safety", "limit"), ("metrics", "steps")):
            self.observation_spec[group] = Composite({name: number.clone()}, shape=self.batch_size)
        flag = Binary(1, (*self.batch_size, 1), dtype=torch.bool)
        self.observation_spec["diverged"] = flag

    def _observe(self):
        steps = self._steps.float()
        return {
            **super()._observe(),
            "reward_terms": TensorDict({"near": steps}, self.batch_size),
            "safety": TensorDict({"limit": (steps > 10).float()}, self.batch_size),
            "metrics": TensorDict({"steps": steps}, self.batch_size),
            "diverged": self._steps == self.episode_steps,
        }


REPORTED = "success", "diverged", "reward_terms", "safety", "metrics"


class TellingAndResetsItself(Telling):
    """Starts the next episode within a step, and reports what the ended one came to."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.__dict__["_torchrl_native_autoreset"] = True

    def _step(self, tensordict):
        out = super()._step(tensordict)
        if out["done"].any():
            again = self._reset(TensorDict({"_reset": out["done"]}, batch_size=self.batch_size))
            out.update(again.exclude(*REPORTED))
        return out


@pytest.fixture
def metrics_of(make_trainer, factory):
    """What two rounds of an episode each say."""

    def collect(kind):
        trainer = make_trainer(
            kind.__name__,
            environment=replace(factory, base=lambda num_envs=1: kind([num_envs])),
            evaluation=EvaluationSettings(every=0),
            acceptance=AcceptanceSettings(enabled=False),
            num_envs=2,
            steps_per_collection=20,
            total_steps=400,
            warmup_steps=200,
            checkpoint={"every": 40},
            controller_steps=200,
        )
        with trainer:
            found = [trainer.collection.collect(n * 40)[1] for n in range(2)]
        return [{k: v for k, v in f.items() if not k.startswith("clock/")} for f in found]

    return collect


def test_an_environment_that_resets_itself_reports_as_any_other(metrics_of):
    expected = metrics_of(Telling)
    assert expected[0]["train/success"] == 1.0
    assert expected[0]["train/diverged"] == 2.0
    assert metrics_of(TellingAndResetsItself) == expected
