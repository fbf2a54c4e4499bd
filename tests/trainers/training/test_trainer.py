"""The loop learns, keeps seeds apart, stores what the paper stores, and resumes as if never stopped."""

from functools import partial

import pytest
import torch
from scipy import stats

from rrl.algorithms import TD3
from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv
from rrl.exploration import OrnsteinUhlenbeckExploration
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.loggers import read_metrics
from rrl.trainers.settings import CheckpointSettings, EvaluationSettings
from rrl.transforms import ControlNoise, ObservationLatency, ObservationNoise


def test_residual_beats_its_controller(make_trainer):
    trainer = make_trainer(
        num_seeds=4,
        total_steps=1600,
        warmup_steps=400,
        agent=partial(TD3, hidden=[64, 64], gamma=0.9),
        evaluation=EvaluationSettings(every=0, final_episodes=100, slots=100),
    )
    comparisons = trainer.run()["drift"]
    trainer.close()
    gains = [(c.residual.returns - c.controller.returns).mean() for c in comparisons]
    assert stats.ttest_1samp(gains, 0.0, alternative="greater").pvalue < 0.01
    assert all(c.summary()["mcnemar_p"] < 0.001 for c in comparisons)


def test_a_seed_learns_alike_alone_and_in_a_stack(make_trainer):
    def stored(**changes):
        trainer = make_trainer(run_dir=str(changes), **changes)
        trainer.run()
        trainer.close()
        content = trainer.replay.storage[:].reshape(-1, changes["num_seeds"])
        return content, trainer.agent

    stack, stacked_agent = stored(seed=3, num_seeds=3)
    alone, agent = stored(seed=4, num_seeds=1)
    warmup = 100  # identical episodes as long as nothing was learned
    for key in ("observation", "action", ("next", "reward")):
        assert torch.equal(stack[:warmup, 1][key], alone[:warmup, 0][key])
        # afterwards products of other sizes round differently in the last bits
        torch.testing.assert_close(stack[:, 1][key], alone[:, 0][key], rtol=1e-3, atol=1e-4)
    for mine, other in zip(
        stacked_agent.policy_of(1).parameters(), agent.policy_of(0).parameters(), strict=True
    ):
        torch.testing.assert_close(mine, other, rtol=1e-3, atol=1e-4)


def test_a_seed_fixes_the_run_to_the_last_bit(make_trainer):
    runs = []
    for run_dir in ("first", "second"):
        trainer = make_trainer(run_dir, num_seeds=2)
        trainer.run()
        trainer.close()
        runs.append(trainer.agent.state_dict())
    assert_same_state(*runs)


def test_the_buffer_holds_the_policys_action(make_trainer):
    trainer = make_trainer(total_steps=100, warmup_steps=40, warmup_exploration=False)
    data = trainer.experience.rollout(trainer.env_steps)
    stored = trainer.store.interleave(data)
    assert torch.equal(stored["action"], torch.zeros_like(stored["action"]))
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


@pytest.mark.parametrize("variant", ["sim", "real"])
def test_resuming_equals_never_having_stopped(make_trainer, variant):
    make = partial(
        make_trainer,
        environment=insertion(variant),
        exploration=partial(OrnsteinUhlenbeckExploration, sigma=0.2),
        num_seeds=2,
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
    without_time = [
        {k: v for k, v in read_metrics(t.run_dir).items() if not k.startswith("time/")}
        for t in (whole, second)
    ]
    final = 80  # the shortened run evaluated there once more, at its end
    for metric, seeds in without_time[0].items():
        for seed, points in seeds.items():
            assert dict(points) == {
                step: value
                for step, value in without_time[1][metric][seed]
                if step != final or step in dict(points)
            }
    whole.close()
    second.close()


def test_resuming_without_a_checkpoint_says_so(make_trainer):
    trainer = make_trainer()
    with pytest.raises(FileNotFoundError, match="no checkpoint in"):
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
