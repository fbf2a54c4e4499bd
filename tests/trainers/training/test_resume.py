"""A run that dies and goes on is the run that never died, whatever learns, acts and is controlled."""

import signal
from dataclasses import replace
from functools import partial

import pytest
import torch
from torchrl.modules import OrnsteinUhlenbeckProcessModule

from rrl.algorithms import DDPG, SAC, TD3, mlp, no_exploration
from rrl.trainers.loggers import read_metrics
from rrl.trainers.settings import CheckpointSettings, EvaluationSettings
from rrl.trainers.training.interruption import Interrupted
from runs import assert_same_run, run, run_until
from toy_envs import RememberingPointMass, RemembersAndResetsItself

SMALL = {"network": partial(mlp, hidden=[16]), "gamma": 0.9}
ENSEMBLE = {"num_critics": 3, "target_subset": 2, "last_layer_bound": 0.1}
LEARNERS = {
    "TD3": partial(TD3, **SMALL, **ENSEMBLE),
    "SAC": partial(SAC, **SMALL),
    "DDPG": partial(DDPG, **SMALL),
}
DEATHS = [
    ("collection.collect", 40),
    ("store.extend", 70),
    ("agent.update", 90),
    ("evaluator.compare", 120),
    ("checkpoints.save", 140),
]
"""Where the run dies, each time after the step to which it had come."""


def point(num_envs=1, kind=RememberingPointMass):
    return kind([num_envs])


ENVIRONMENTS = {
    "one without batch": (partial(RememberingPointMass, []), "serial", 1),
    "serial": (partial(RememberingPointMass, []), "serial", 2),
    "parallel": (partial(RememberingPointMass, []), "parallel", 2),
    "native": (point, "native", 2),
    "resets itself": (partial(point, kind=RemembersAndResetsItself), "native", 2),
}


@pytest.fixture
def make(make_trainer, simulated):
    """Builds a trainer that collects in the middle of episodes; checkpoints every 20 steps."""

    def make(run_dir, algorithm="TD3", compiled=False, environment=None, **changes):
        explore = partial(OrnsteinUhlenbeckProcessModule, annealing_num_steps=100, dt=1.0)
        return make_trainer(
            run_dir,
            environment=environment or simulated,
            agent=partial(LEARNERS[algorithm], compiled=compiled),
            exploration=no_exploration if algorithm == "SAC" else explore,
            **{
                "total_steps": 160,
                "warmup_steps": 30,
                "steps_per_collection": 10,
                "updates_per_step": 0.4,
                "batch_size": 16,
                "buffer_capacity": 100,
                "evaluation": EvaluationSettings(every=40, episodes=2, final_episodes=2, slots=2),
                "checkpoint": CheckpointSettings(every=20),
                **changes,
            },
        )

    return make


def broken(make, **arguments):
    """The run that dies at every place of ``DEATHS``."""
    for i, (place, env_steps) in enumerate(DEATHS):
        trainer = make("broken", **arguments)
        if i:
            trainer.resume()
        run_until(trainer, place, env_steps)
    trainer = make("broken", **arguments)
    trainer.resume()
    return run(trainer)


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "algorithm",
    [pytest.param(a, marks=() if a == "TD3" else pytest.mark.slow) for a in LEARNERS],
)
def test_a_run_that_dies_at_many_places_is_the_run_that_never_died(make, algorithm, collection):
    arguments = {"algorithm": algorithm, "collection": collection, "n_step": 2}
    assert_same_run(run(make("whole", **arguments)), broken(make, **arguments))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
@pytest.mark.parametrize("collection", ["turn", "overlap"])
@pytest.mark.parametrize("algorithm", LEARNERS)
def test_so_it_is_with_compiled_updates(make, algorithm, collection):
    arguments = {"algorithm": algorithm, "collection": collection, "compiled": True}
    assert_same_run(run(make("whole", **arguments)), broken(make, **arguments))


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(k, marks=() if k in ("serial", "native") else pytest.mark.slow)
        for k in ENVIRONMENTS
    ],
)
def test_so_it_is_with_every_kind_of_environment(make, factory, kind, collection):
    base, batching, num_envs = ENVIRONMENTS[kind]
    arguments = {
        "environment": replace(factory, base=base, batching=batching),
        "num_envs": num_envs,
        "steps_per_collection": 10 // num_envs,
        "collection": collection,
    }
    whole = run(make("whole", **arguments))
    run_until(make("broken", **arguments), "agent.update", 70)
    second = make("broken", **arguments)
    second.resume()
    assert second.collection.can_continue
    assert second.env_steps == 60
    assert_same_run(whole, run(second))


def test_an_environment_that_resets_itself_ends_with_the_last_observation_it_showed(make, factory):
    environment = replace(factory, base=ENVIRONMENTS["resets itself"][0])
    trainer = make("run", environment=environment, num_envs=2, n_step=1)
    data, _ = trainer.collection.collect(0)
    for _ in range(3):
        more, _ = trainer.collection.collect(0)
        data = torch.cat([data, more], 1)
    trainer.close()
    over = data["next", "done"].squeeze(-1)
    assert over.sum() == 2 * 2  # 40 steps of two environments, episodes of 20
    for key in ("goal", "end_effector_position"):
        assert torch.equal(data["next", key][over], data[key][over])
        goes_on = ~over[:, :-1]
        assert torch.equal(data["next", key][:, :-1][goes_on], data[key][:, 1:][goes_on])


@pytest.mark.slow  # compiling takes its time
@pytest.mark.filterwarnings("ignore")  # torch.compile warns of its own settings
def test_a_compiled_run_resumes_to_rounding(make_trainer, simulated):
    """Compiled kernels need not round alike in another process; here they do to a part in 10^5."""
    agent = partial(TD3, network=partial(mlp, hidden=[16]), compiled=True)
    compiled = partial(make_trainer, environment=simulated, agent=agent)
    whole = compiled("whole", total_steps=200)
    whole.run()
    compiled_first = compiled("broken", total_steps=140)
    compiled_first.run()
    compiled_first.close()
    resumed = compiled("broken", total_steps=200)
    resumed.resume()
    resumed.run()
    for mine, other in zip(whole.agent.parameters(), resumed.agent.parameters(), strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-5, atol=1e-6)
    whole.close()
    resumed.close()


class Standing(RememberingPointMass):
    """Stands still while it is evaluated, as a robot does."""

    def stop(self):
        pass


@pytest.mark.slow
def test_what_was_stopped_for_an_evaluation_begins_an_episode_after_a_resume_too(make, simulated):
    """Evaluation and checkpoint fall into the middle of an episode."""
    changes = {
        "environment": replace(simulated, base=partial(point, kind=Standing)),
        "evaluation": EvaluationSettings(every=30, episodes=2, final_episodes=2, slots=2),
        "checkpoint": CheckpointSettings(every=30),
    }
    whole = run(make("whole", **changes))
    run_until(make("broken", **changes), "store.extend", 30)
    second = make("broken", **changes)
    assert second.resume().name == "checkpoint-000000000030"
    assert_same_run(whole, run(second))


def test_an_evaluation_that_was_broken_off_is_made_after_the_resume(make):
    """As on a robot, where an evaluation that waits for it ends when the run is to end."""

    def followed(trainer):
        metrics = read_metrics(trainer.run_dir)
        return [step for step, _ in metrics["eval/drift/return"]]

    first = make("run")
    follow = first.acceptance.follow

    def broken_off(env_steps):
        if env_steps == 80:
            raise Interrupted(signal.SIGINT)
        return follow(env_steps)

    first.acceptance.follow = broken_off
    with first, pytest.raises(Interrupted):
        first.run()
    second = make("run")
    second.resume()
    run(second)
    assert followed(second) == [0, 40, 80, 120, 160]
    never = make("never")
    run(never)
    assert_same_run(second, never)
