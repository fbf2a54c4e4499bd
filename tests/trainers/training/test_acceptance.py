"""What a run hands over is the controller, until a policy passes the test against it."""

import json
import logging
from collections import Counter
from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
import torch

from candidates import AGAINST, consider, follow, say
from rrl.algorithms import TD3, mlp
from rrl.robot import RobotFault
from rrl.trainers import AcceptanceSettings, EvaluationSettings
from rrl.trainers.evaluation import rollout
from rrl.trainers.evaluation.episodes import write_results
from rrl.trainers.loggers import read_metrics
from rrl.trainers.metric import Metric
from rrl.trainers.report.notes import notes
from rrl.trainers.report.tables import one_run, success_rows
from rrl.trainers.seeds import Stream, first_seed
from rrl.trainers.training.schedule import episodes_ahead
from runs import assert_same
from toy_envs import DRIFT, PointMass


def action(policy, trainer):
    """What a policy says in a state, ``[2]``."""
    env = trainer.evaluator.scenarios["drift"].make(1)
    return policy(env.reset())["action"][0].detach()


STUBBORN = partial(TD3, network=partial(mlp, hidden=[16]), gamma=0.9, actor_lr=1e-12)
"""A learner that stays with what it was told to say."""


def test_until_a_policy_passes_the_run_hands_over_the_controller(make_tested):
    with make_tested() as trainer:
        found, values = consider(trainer, 0)  # it has learned nothing, and is the controller
        assert values["acceptance/episodes"] == 0
        assert (action(trainer.policy, trainer) == 0).all()
        assert found.accepted is found.controller
        say(trainer, AGAINST)
        found, values = consider(trainer, 100)
        assert values["acceptance/accepted"] == 1
        assert values["acceptance/evidence"] >= 1
        assert 0 < values["acceptance/episodes"] <= 20
        assert found.accepted is found.residual
        assert found.summary()["accepted_env_steps"] == 100
        torch.testing.assert_close(action(trainer.policy, trainer), torch.tensor([AGAINST, 0.0]))


def test_what_was_handed_over_is_played_once_more_after_a_resume(make_tested):
    with make_tested() as trainer:
        trainer.acceptance.handed_over.take(50)
        trainer.acceptance.load_state_dict(trainer.acceptance.state_dict())
        played = []
        play = trainer.evaluator._play

        def counted(policy, scenario, seed, episodes):
            played.append(episodes)
            return play(policy, scenario, seed, episodes)

        trainer.evaluator._play = counted
        ahead = episodes_ahead(trainer.settings, trainer.evaluator, trainer.acceptance, 100)
        consider(trainer, 200)
    assert sum(played) == ahead["in evaluations"] == 3 * 20


def test_what_the_learner_becomes_afterwards_changes_nothing(make_tested):
    with make_tested() as trainer:
        say(trainer, AGAINST)
        good, _ = consider(trainer, 100)
        for x in (0.9, 0.0, -0.2):  # worse than the controller, as good, better by less
            say(trainer, x)
            found, values = consider(trainer, 200)
            assert values["acceptance/episodes"] == 0
            assert (found.accepted.returns == good.residual.returns).all()
            assert found.accepted_env_steps == 100
        expected = action(trainer.policy, trainer)
        state = trainer.acceptance.state_dict()
        with make_tested("other") as other:
            say(other, 0.5)
            other.acceptance.load_state_dict(state)
            assert torch.equal(action(other.policy, other), expected)
            assert action(other.agent.policy, other)[0] == pytest.approx(0.5)
            say(other, 0.9)
            found, _ = consider(other, 300)  # plays the accepted policy again
            assert (found.accepted.returns == good.residual.returns).all()
            assert_same(other.acceptance.state_dict(), state)
            assert other.acceptance.handed_over.restore_learner()
            assert torch.equal(action(other.agent.policy, other), expected)


def test_a_policy_that_promises_more_and_is_worse_is_not_taken(make_tested, factory):
    """It is chosen by episodes that are not the ones it is tested on."""

    class Deceiving(PointMass):
        """Without drift, but on the followed episodes."""

        def _set_seed(self, seed):
            super()._set_seed(seed)
            following = seed is not None and seed >> 29 == Stream.FOLLOWING
            self._drift = torch.tensor([DRIFT if following else 0.0, 0.0])

    environment = replace(factory, base=lambda num_envs=1: Deceiving([num_envs]))
    with make_tested(environment=environment) as made:
        say(made, AGAINST)
        found, values = consider(made, 100)
        assert found.residual.success.mean() > found.controller.success.mean()
        assert values["acceptance/episodes"] > 0
        assert values["acceptance/accepted"] == 0
        assert values["acceptance/alpha_left"] < AcceptanceSettings().alpha
        assert (action(made.policy, made) == 0).all()


def test_a_policy_that_the_robot_answers_with_faults_is_not_taken(
    make_tested, factory, monkeypatch
):
    """Without them it would solve every episode, as it does the followed ones."""
    monkeypatch.setattr(rollout, "RETRY", 0.0)

    class Protected(PointMass):
        """An arm that stops by itself where it is pushed, but on the followed episodes."""

        def _set_seed(self, seed):
            super()._set_seed(seed)
            self._bears_it = seed is not None and seed >> 29 == Stream.FOLLOWING

        def _step(self, tensordict):
            if tensordict["action"][0, 0] > 0.55 and not self._bears_it:
                raise RobotFault("protective stop")
            return super()._step(tensordict)

        def stop(self):
            pass

    environment = replace(
        factory,
        base=lambda num_envs=1: Protected([num_envs], drift=-0.02),
        batching="serial",
        disturbances=[],
    )
    with make_tested(environment=environment) as made:
        say(made, 0.4)
        found, values = consider(made, 100)
        assert found.residual.success.all()
        assert found.controller.success.mean() > 0.8
        assert values["acceptance/episodes"] > 0
        assert values["acceptance/faults"] > 0
        assert values["acceptance/controller_faults"] == 0
        assert values["acceptance/accepted"] == 0


def test_of_two_that_solve_as_much_the_one_within_its_budgets_is_better(make_tested):
    how = {"push": Metric(reduce="max", budget=1.0)}
    with make_tested() as trainer:
        say(trainer, AGAINST)
        found = follow(trainer)
        taken = []
        for push, lost in ((2.0, 0.0), (0.5, 1.0), (0.5, 2.0), (2.0, 0.0)):
            pushes, returns = np.full(20, push), found.residual.returns - lost
            changes = {"metrics": {"push": pushes}, "declared": how, "returns": returns}
            residual = replace(found.residual, **changes)
            _, values = trainer.acceptance.consider(replace(found, residual=residual), 100)
            taken.append(values["acceptance/accepted"])
        assert taken == [1, 1, 0, 0]


class Logged(PointMass):
    """Writes down every seed it is given."""

    seeds: ClassVar = Counter()

    def _set_seed(self, seed):
        Logged.seeds[seed] += 1
        super()._set_seed(seed)


def test_no_candidate_sees_an_episode_that_anything_has_seen_before(make_tested, factory):
    environment = replace(factory, base=lambda num_envs=1: Logged([num_envs]))
    with make_tested(environment=environment, seed=3) as trainer:
        Logged.seeds.clear()
        played = 0
        for n, x in enumerate((-0.2, -0.4, AGAINST)):
            say(trainer, x)
            _, values = consider(trainer, 100 * (n + 1))
            assert values["acceptance/episodes"] > 0
            played += int(values["acceptance/episodes"])
        seeds = {s: n for s, n in Logged.seeds.items() if s >> 29 == Stream.ACCEPTANCE}
        first = first_seed(Stream.ACCEPTANCE, 3)
        assert set(seeds.values()) == {2}  # once by the policy and once by the controller
        assert sorted(seeds) == list(range(first, first + played, 10))  # ten slots side by side


def test_a_run_reports_both_the_latest_policy_and_what_it_hands_over(make_tested, tmp_path, caplog):
    caplog.set_level(logging.INFO, "rrl")
    with make_tested(total_steps=300, agent=STUBBORN) as trainer:
        say(trainer, AGAINST)
        consider(trainer, 100)
        say(trainer, 0.9)  # of the learner; it is worse than the controller
        results = trainer.run()
    assert "acceptance: at most 1200 episodes in 3 evaluations" in caplog.text
    summary = results["drift"].summary()
    assert summary["accepted_success"] > summary["controller_success"] == 0
    assert summary["success"] == 0
    assert summary["accepted_rescues"] == 20 * summary["accepted_success"]
    record = read_metrics(trainer.run_dir)
    assert [step for step, _ in record["eval/drift/accepted_success"]] == [0, 100, 200, 300]
    assert {v for _, v in record["eval/drift/accepted_env_steps"]} == {100}
    rows = success_rows(one_run(results))
    assert [row[0] for row in rows] == ["drift", "drift, handed over"]
    assert rows[0][1] == rows[1][1]
    assert float(rows[1][2].split()[0]) == pytest.approx(100 * summary["accepted_success"], abs=0.1)
    assert "Handed over: the policy after 100 environment steps" in notes(one_run(results), {})[-1]
    write_results(results, tmp_path / "results.json")
    content = json.loads((tmp_path / "results.json").read_text())["drift"]
    assert sum(content["episodes"]["accepted_success"]) == summary["accepted_rescues"]
    handed_over = results["drift"].handed_over
    assert handed_over.summary()["success"] == summary["accepted_success"]


def test_a_run_in_which_no_policy_passes_says_so(make_tested):
    only_at_the_end = EvaluationSettings(every=0, final_episodes=10)
    with make_tested(total_steps=120, agent=STUBBORN, evaluation=only_at_the_end) as made:
        say(made, 0.9)
        results = made.run()
        assert (action(made.policy, made) == 0).all()
    compared = results["drift"]
    assert compared.accepted is compared.controller
    assert "Handed over: the controller alone." in notes(one_run(results), {})[-1]
    record = read_metrics(made.run_dir)
    assert [step for step, _ in record["acceptance/episodes"]] == [120]  # at the end alone


def test_without_a_test_the_latest_policy_is_handed_over(make_tested, caplog):
    caplog.set_level(logging.INFO, "rrl")
    with make_tested(acceptance=AcceptanceSettings(enabled=False)) as trainer:
        results = trainer.run()
        assert trainer.policy is trainer.agent.policy
    assert results["drift"].accepted is None
    assert results["drift"].handed_over.residual is results["drift"].residual
    assert not [name for name in read_metrics(trainer.run_dir) if "accept" in name]
    assert "accept" not in caplog.text
    assert [row[0] for row in success_rows(one_run(results))] == ["drift"]
    assert len(notes(one_run(results), {})) == 1


@pytest.mark.parametrize(
    "wrong", [{"margin": 0.0}, {"margin": 1.0}, {"alpha": 0.0}, {"alpha": 1.0}, {"episodes": 0}]
)
def test_settings_out_of_range_are_named(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=name):
        AcceptanceSettings(**wrong)
