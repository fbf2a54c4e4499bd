"""Environments as people have them: what they call things, how they keep their state, what they count in."""

import random
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn

from lines import (
    EPISODE,
    Chatty,
    Forgetful,
    ForgetsTheTime,
    HoldsALock,
    KeepsAFile,
    LegacyGenerator,
    Line,
    Nested,
    OwnsANetwork,
    RefusesItsState,
    Scoring,
    Slashes,
    of,
)
from rrl.controllers import ProportionalController, ZeroController
from rrl.trainers import EnvironmentFactory
from rrl.trainers.settings import AcceptanceSettings, CheckpointSettings, EvaluationSettings
from rrl.trainers.storage.files import claimed
from rrl.transforms import ControlNoise
from runs import assert_same_run, run, run_until

NO_EVALUATION = EvaluationSettings(every=0)


@pytest.fixture
def make(make_trainer):
    def make(run_dir, environment, **changes):
        return make_trainer(
            run_dir,
            environment=environment,
            **{
                "total_steps": 120,
                "warmup_steps": 30,
                "steps_per_collection": 10,
                "batch_size": 16,
                "evaluation": EvaluationSettings(every=60, episodes=2, final_episodes=2, slots=2),
                "checkpoint": CheckpointSettings(every=30),
                **changes,
            },
        )

    return make


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "base",
    [
        Line,
        Nested,
        *(pytest.param(b, marks=pytest.mark.slow) for b in (Slashes, LegacyGenerator, Chatty)),
    ],
)
def test_a_state_of_arrays_generators_and_text_is_saved_and_gone_on_from(make, base, collection):
    environment = of(base)
    whole = run(make("whole", environment, collection=collection))
    run_until(make("broken", environment, collection=collection), "checkpoints.save", 90)
    second = make("broken", environment, collection=collection)
    second.resume()
    assert second.collection.can_continue
    assert_same_run(whole, run(second))


@pytest.mark.parametrize("num_envs", [1, 2])
def test_what_cannot_be_saved_is_refused_at_the_first_checkpoint_with_its_path(make, num_envs):
    with make("run", of(KeepsAFile), num_envs=num_envs, steps_per_collection=5) as trainer:
        with pytest.raises(TypeError, match=r"'devices'\]\[0\]\['handle'\]: expected .* a object"):
            trainer.run()
        assert trainer.env_steps == 0


@pytest.mark.parametrize(
    ("base", "said"),
    [
        (Forgetful, None),
        (OwnsANetwork, None),
        (ForgetsTheTime, None),
        (HoldsALock, "the environment's state cannot be restored (TypeError: cannot pickle"),
        (RefusesItsState, "the environment's state cannot be restored (NotImplementedError: not"),
    ],
)
def test_an_environment_that_cannot_go_on_is_found_out_and_begins_a_new_episode(
    make, base, said, caplog
):
    environment = of(base)
    first = run(make("run", environment, total_steps=60))
    assert not first.collection.can_continue
    assert said is None or said in caplog.text
    second = make("run", environment)
    second.resume()
    assert not second.collection.can_continue
    stored = run(second).replay.storage[:]
    assert len(stored) == 120
    assert torch.equal(stored["base_action"][:60], first.replay.storage[:]["base_action"])


@pytest.mark.parametrize("base", [Forgetful, OwnsANetwork])
def test_one_that_has_no_state_to_give_is_not_moved_to_try_it(make, base):
    class Counting(base):
        moves = 0

        def _step(self, tensordict):
            Counting.moves += 1
            return super()._step(tensordict)

    with make("run", of(Counting)) as trainer:
        assert not trainer.collection.can_continue
    assert Counting.moves == 0


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize("num_envs", [1, 2])
def test_double_precision_reaches_the_environment_and_single_the_learner(
    make, num_envs, collection
):
    environment = of(Line, dtype=torch.float64)
    changes = {
        "num_envs": num_envs,
        "steps_per_collection": 10 // num_envs,
        "collection": collection,
    }
    trainer = run(make("run", environment, **changes))
    stored = trainer.replay.storage[:]
    assert {value.dtype for value in stored.values(True, True)} <= {
        torch.float32,
        torch.bool,
        torch.int64,  # the index
    }
    assert all(p.dtype == torch.float32 for p in trainer.agent.parameters())


@pytest.mark.parametrize("n_step", [1, 3])
@pytest.mark.parametrize("reward", [torch.int64, torch.uint8, torch.bool, torch.float16])
def test_a_reward_of_any_type_is_learned_from_in_single_precision(make, reward, n_step):
    environment = of(Scoring, reward=reward)
    with make("run", environment, n_step=n_step, evaluation=NO_EVALUATION) as trainer:
        stored = trainer.store.extend(trainer.collection.collect(0)[0])["next", "reward"]
    assert stored.dtype == torch.float32
    discounted = sum(trainer.agent.gamma**k for k in range(n_step))
    assert stored[0].item() == pytest.approx(discounted)


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_default_type_of_the_process_does_not_matter(make, dtype, collection):
    torch.set_default_dtype(torch.float64)
    try:
        trainer = run(make("run", of(Line, dtype=dtype), collection=collection))
        second = make("run", of(Line, dtype=dtype), collection=collection, total_steps=150)
        second.resume()
        run(second)
    finally:
        torch.set_default_dtype(torch.float32)
    assert all(p.dtype == torch.float32 for p in trainer.agent.parameters())
    assert second.env_steps == 150


class Drawn(Line):
    """Draws its starts from the process's own generators."""

    def _reset(self, tensordict=None, **kwargs):
        self.t, self.x = 0, np.array([random.random(), np.random.rand() + torch.rand(()).item()])  # noqa: NPY002
        return TensorDict(self._observe(), [])


def test_evaluation_leaves_no_trace_in_what_is_drawn_from_global_generators(make):
    environment = of(Drawn)
    often = EvaluationSettings(every=30, episodes=3, final_episodes=2)
    never = EvaluationSettings(every=0, episodes=3, final_episodes=2)
    same = {"acceptance": AcceptanceSettings(enabled=False)}  # what is handed over is decided there
    runs = [run(make(f"{e.every}", environment, evaluation=e, **same)) for e in (often, never)]
    assert_same_run(*runs)


def test_text_does_not_reach_the_learner_and_evaluation_plays_it(make, make_trainer):
    environment = of(Chatty)
    trainer = run(make("run", environment, num_envs=2, steps_per_collection=5))
    assert "camera" not in trainer.replay.storage[:]


def test_an_environment_without_batch_dimensions_goes_through_every_path(make):
    environment = of(Line)
    with make("run", environment, profile=True, n_step=3) as trainer:
        assert trainer.collection.env.batch_size == ()
        results = trainer.run()
    assert len(results["drift"].residual.returns) == 2
    assert trainer.replay.storage[:]["position"].shape == (120, 2)


def test_a_controller_without_an_idea_is_fine(make):
    environment = EnvironmentFactory(
        Line, ZeroController, ["position"], batching="serial", max_episode_steps=EPISODE
    )
    assert run(make("run", environment)).env_steps == 120


def test_nothing_is_drawn_again_however_often_a_run_dies_between_two_checkpoints(make):
    noisy = replace(of(Forgetful), disturbances=[partial(ControlNoise, sigma=0.1)])
    make = partial(make, "run", noisy, checkpoint=CheckpointSettings(every=120), n_step=1)
    for dies_at in (50, 80):  # the round that begins there is stored, and the last that is
        trainer = make()
        if dies_at > 50:
            trainer.resume()
        run_until(trainer, "store.extend", dies_at)
    trainer = make()
    trainer.resume()
    stored = run(trainer).replay.storage[:]
    begun = [0, 60, 90]
    moved = (stored["next", "position"] - stored["position"]) / 0.1
    noise = moved - stored["base_action"] - 0.5 * stored["action"]
    for drawn in (stored["position"], stored["action"], noise):
        assert len(torch.unique(drawn[begun].round(decimals=4), dim=0)) == 3


class FreshNetwork(ProportionalController):
    """Draws weights when it is made, as one does that loads others over them."""

    def __init__(self, *arguments, **settings):
        nn.Linear(3, 3)
        super().__init__(*arguments, **settings)


def test_what_is_drawn_to_build_an_environment_does_not_reach_the_run(make):
    environment = replace(of(Line), controller=partial(FreshNetwork, "position", "goal", gain=0.5))
    whole = run(make("whole", environment))
    run_until(make("broken", environment), "checkpoints.save", 60)
    second = make("broken", environment)
    second.resume()
    assert_same_run(whole, run(second))


def test_a_run_that_is_at_work_is_left_alone(make, tmp_path):
    def never(**arguments):
        raise AssertionError("built")

    environment = replace(of(Line), base=never)
    (tmp_path / "run").mkdir()
    with claimed(tmp_path / "run"), pytest.raises(BlockingIOError, match="another process"):
        make("run", environment)


def test_a_run_does_not_become_shorter_than_it_is(make):
    run(make("run", of(Line), total_steps=60))
    with (
        make("run", of(Line), total_steps=40) as shorter,
        pytest.raises(ValueError, match=r"total_steps: expected at least 60, .*, got 40"),
    ):
        shorter.resume()
