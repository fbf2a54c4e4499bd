"""The loop learns, stores what the paper stores, and resumes as if never stopped."""

from functools import partial

import pytest
import torch
from scipy import stats
from torchrl.modules import OrnsteinUhlenbeckProcessModule

from rrl.algorithms import TD3, mlp
from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.loggers import read_metrics
from rrl.trainers.settings import CheckpointSettings, EvaluationSettings
from rrl.transforms import ControlNoise, ObservationLatency, ObservationNoise


@pytest.mark.slow
def test_residual_beats_its_controller(make_trainer):
    comparisons = []
    for seed in range(4):
        trainer = make_trainer(
            f"seed-{seed}",
            seed=seed,
            total_steps=1600,
            warmup_steps=400,
            agent=partial(TD3, network=partial(mlp, hidden=[64, 64]), gamma=0.9),
            evaluation=EvaluationSettings(every=0, final_episodes=100, slots=100),
        )
        comparisons.append(trainer.run()["drift"])
        trainer.close()
    gains = [(c.residual.returns - c.controller.returns).mean() for c in comparisons]
    assert stats.ttest_1samp(gains, 0.0, alternative="greater").pvalue < 0.01
    assert all(c.summary()["mcnemar_p"] < 0.001 for c in comparisons)


def test_a_seed_fixes_the_run_to_the_last_bit(make_trainer):
    runs = []
    for run_dir in ("first", "second"):
        trainer = make_trainer(run_dir, num_envs=2)
        trainer.run()
        trainer.close()
        runs.append(trainer.agent.state_dict())
    assert_same_state(*runs)


def test_the_buffer_holds_the_policys_action(make_trainer):
    trainer = make_trainer(total_steps=100, warmup_steps=40, controller_steps=40)
    data = trainer.collection.rollout(trainer.env_steps)
    trainer.store.extend(trainer.collection.collect(0)[0])
    stored = trainer.replay.storage[:]
    assert torch.equal(stored["action"], torch.zeros_like(stored["action"]))
    assert "base_action" not in stored
    assert data["base_action"].abs().max() > 0
    assert data["next", "executed_action"].abs().max() > 0
    trainer.close()


def insertion(variant):
    """The insertion task with everything that has a state: noise on control and sensing, latency."""
    force, size = ("wrench", 6) if variant == "sim" else ("force_z", 1)
    return EnvironmentFactory(
        base=partial(InsertionEnv, variant=variant, seed=0),
        controller=partial(ProportionalController, gain=0.5, clip=0.5, unit=0.02),
        inputs={force: Input(scale=[0.1] * size), "blocks": Input(scale=5.0), "goal": Input()},
        disturbances=[partial(ControlNoise, mu=0.1, sigma=0.05)],
        sensing=[
            partial(ObservationNoise, in_keys=["blocks"], sigma=0.001),
            partial(ObservationLatency, in_keys=["blocks"], steps=2),
        ],
        max_episode_steps=50,
    )


@pytest.mark.parametrize("variant", [pytest.param("sim", marks=pytest.mark.slow), "real"])
def test_resuming_equals_never_having_stopped(make_trainer, variant):
    make = partial(
        make_trainer,
        environment=insertion(variant),
        exploration=partial(OrnsteinUhlenbeckProcessModule, eps_init=0.5, eps_end=0.1, dt=1.0),
        num_envs=2,
        warmup_steps=40,
        steps_per_collection=20,  # the episode of 50 steps is under way at every checkpoint
        evaluation=EvaluationSettings(every=40, episodes=2, final_episodes=2, slots=2),
        checkpoint=CheckpointSettings(every=40),
    )
    whole = make("whole", total_steps=120)
    whole.run()
    first = make("broken", total_steps=80)
    first.run()
    first.close()
    second = make("broken", total_steps=120)
    second.resume()
    assert second.env_steps == 80
    second.run()
    assert_same_state(whole.agent.state_dict(), second.agent.state_dict())
    expected, resumed = whole.replay.storage[:], second.replay.storage[:]
    assert (expected == resumed).all()
    curves = [
        {k: v for k, v in read_metrics(t.run_dir).items() if not k.startswith(("time/", "clock/"))}
        for t in (whole, second)
    ]
    assert curves[0] == curves[1]
    whole.close()
    second.close()


def test_resuming_without_a_checkpoint_says_so(make_trainer):
    trainer = make_trainer()
    with pytest.raises(
        FileNotFoundError, match="a run that saved a checkpoint, got one without any"
    ):
        trainer.resume()
    trainer.close()


def assert_same_state(expected, actual):
    """The same tensors and numbers, to the last bit, in nested dictionaries and lists."""
    if isinstance(expected, dict):
        assert expected.keys() == actual.keys()
        expected, actual = list(expected.values()), list(actual.values())
    if isinstance(expected, list):
        assert len(expected) == len(actual)
        for one, other in zip(expected, actual, strict=True):
            assert_same_state(one, other)
    elif isinstance(expected, torch.Tensor):
        assert torch.equal(expected, actual)
    else:
        assert expected == actual
