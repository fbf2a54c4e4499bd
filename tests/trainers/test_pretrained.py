"""An earlier run as the start of another one: initial weights, a controller, a recorded sequence."""

import numpy as np
import pytest
import torch
import yaml
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from agents import last_linear
from rrl.trainers.configuration import build as assembly
from rrl.trainers.configuration import checks
from rrl.trainers.evaluation.episodes import write_results
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.loggers import read_metrics
from rrl.trainers.pretrained import (
    best_run,
    policy_controller,
    replay_controller,
    start_from,
    trained_run,
)
from rrl.trainers.seeds import Stream
from toy_envs import OneSided

SMALL = [
    "algorithm=td3",
    "algorithm.agent.network.hidden=[16,16]",
    "logger=[csv]",
    "render.enabled=false",
    "trainer.total_steps=100",
    "trainer.warmup_steps=50",
    "trainer.batch_size=16",
    "trainer.evaluation={every: 50, episodes: 2, final_episodes: 2, slots: 2}",
    "trainer.acceptance.episodes=2",
    "trainer.checkpoint.every=0",
]


def resolve(*overrides):
    with initialize_config_module("rrl.configs", version_base="1.3"):
        return OmegaConf.to_container(
            compose("train", overrides=[*SMALL, *overrides]), resolve=True
        )


def train(run_dir, *overrides, **replaced):
    config = {**resolve(*overrides), **replaced}
    with assembly.trainer(config, run_dir) as trainer:
        results = trainer.run()
    write_results(results, run_dir / "results.json")
    (run_dir / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    return run_dir


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Two seeds without a controller."""
    group = tmp_path_factory.mktemp("alone")
    for seed in range(2):
        train(group / f"seed-{seed}", "arm=rl", "env=insertion-sim", f"trainer.seed={seed}")
    return group


@pytest.fixture
def observed(alone):
    env = assembly.environment(config_of(alone / "seed-0")).make(3)
    yield env, env.reset()
    env.close()


def config_of(run_dir):
    return yaml.safe_load((run_dir / "config.yaml").read_text())


def test_initial_weights_are_those_of_the_best_seed_during_training(alone, observed, tmp_path):
    config = resolve("arm=rl", "env=insertion-sim", f"init_from.run='{alone}'")
    assert not checks.problems(config)
    scenario = next(iter(config["env"]["scenarios"]))
    record = {k: read_metrics(alone / f"seed-{k}") for k in range(2)}
    score = {
        k: tuple(r[f"eval/{scenario}/{e}"][-1][1] for e in ("success", "return"))
        for k, r in record.items()
    }
    best = alone / f"seed-{max(score, key=score.get)}"
    assert best_run(alone) == best
    source = trained_run(config_of(best), best).agent
    with assembly.trainer(config, tmp_path) as trainer:
        start_from(trainer.agent, config)
        td = observed[1]
        expected = source.policy(td.clone())["action"]
        assert torch.equal(trainer.agent.policy(td.clone())["action"], expected)


def test_as_a_controller_it_acts_as_it_did(alone, observed):
    run = alone / "seed-1"
    source = trained_run(config_of(run), run).agent
    expected = source.policy(observed[1].clone())["action"]
    given = policy_controller(str(run))(observed[1].clone())["base_action"]
    torch.testing.assert_close(given, expected, atol=1e-5, rtol=1e-5)


ONE_SIDED = {
    "name": "one-sided",
    "base": {"_target_": "toy_envs.OneSided"},
    "batching": "serial",
    "max_episode_steps": 20,
    "inputs": {"goal": {}},
    "scenarios": {"training": None},
}


def test_where_bounds_are_not_symmetric_it_acts_as_it_did(tmp_path):
    run = train(tmp_path / "run", "arm=rl", "env=insertion-sim", env=ONE_SIDED)
    controller, replayed = policy_controller(str(run)), replay_controller(str(run)).actions
    source = trained_run(config_of(run), run).agent
    env = assembly.environment(config_of(run)).make(1)
    with torch.no_grad():
        td = env.reset()
        says = controller(td.clone())["base_action"]
        env.step(source.policy(td))
    executed = env.base_env.executed
    torch.testing.assert_close(says.clamp(min=torch.tensor(OneSided.LOW)), executed)
    assert (
        (replayed - torch.tensor([0.5, 3.0, 0.0, 5.0])).abs() <= torch.tensor([0.5, 1, 1, 1])
    ).all()


def test_the_recorded_sequence_repeats_the_episode_in_its_own_environment(alone):
    config = resolve("env=insertion-sim", "controller=replay", f"controller.run='{alone}'")
    assert not checks.problems(config)
    actions = replay_controller(str(alone)).actions
    assert actions.shape == (50, 3)
    env = assembly.environment(config).make(1)
    td = env.rollout(50, lambda td: td.set("action", torch.zeros(1, 3)))
    torch.testing.assert_close(td["base_action"][0], actions)
    env.close()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["init_from.run=nowhere"],
            "init_from.run: expected the directory of a training run, got 'nowhere'",
        ),
    ],
)
def test_a_run_that_is_not_there_is_named(overrides, message):
    config = resolve(*overrides)
    assert any(message in problem for problem in checks.problems(config, new=True))
    assert checks.problems(config) == []  # a run that has begun does not read it again


def test_a_policy_that_does_not_fit_is_refused(alone, tmp_path):
    config = resolve("env=insertion-real", f"init_from.run='{alone}'")
    with (
        assembly.trainer(config, tmp_path) as trainer,
        pytest.raises(ValueError, match="give both runs the same env"),
    ):
        start_from(trainer.agent, config)


@pytest.mark.parametrize("group", ["inputs", "critic_inputs"])
def test_entries_of_equal_sizes_in_another_order_are_refused(group, tmp_path):
    read = {"goal": {}, "end_effector_position": {}}
    env, turned = ({**ONE_SIDED, group: d} for d in (read, dict(reversed(read.items()))))
    run = train(tmp_path / "run", "env=insertion-sim", "arm=rl", env=env)
    config = resolve("env=insertion-sim", "arm=rl", f"init_from.run='{run}'") | {"env": turned}
    with (
        assembly.trainer(config, tmp_path / "next") as trainer,
        pytest.raises(ValueError, match=rf"env\.{group}.*position.*goal.*goal.*position"),
    ):
        start_from(trainer.agent, config)
    with pytest.raises(ValueError, match=rf"env\.{group}: expected .*goal.*position.*, got .*posi"):
        trained_run({**config_of(run), "env": turned}, run)


@pytest.fixture
def residual(tmp_path):
    """Makes a run that took the policy of step 50, or none, and went on learning after it."""

    def make(accepted):
        config, run_dir = resolve("env=insertion-sim"), tmp_path / "residual"
        with assembly.trainer(config, run_dir) as trainer:
            if accepted:
                move(trainer.agent, 0.3)
                trainer.acceptance.handed_over.take(50)
            move(trainer.agent, -0.2)
            note = {"transitions": trainer.store.mark(), "config": config}
            trainer.checkpoints.save(100, note)
        (run_dir / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
        return run_dir

    return make


def move(agent, by):
    with torch.no_grad():
        last_linear(agent.policy).bias.add_(by)


@pytest.mark.parametrize("accepted", [True, False])
def test_a_run_is_used_by_the_policy_that_it_hands_over(residual, tmp_path, accepted):
    run = residual(accepted)
    config = config_of(run)
    env = assembly.environment(config).make(2)
    td = env.reset()
    trained = trained_run(config, run)
    assert trained.env_steps == 100
    handed_over, latest = (
        p(td.clone())["action"] for p in (trained.handed_over.policy, trained.agent.policy)
    )
    says = {True: np.tanh(0.3), False: 0.0}[accepted]
    np.testing.assert_allclose(handed_over.detach(), says, atol=1e-6)
    np.testing.assert_allclose(latest.detach(), np.tanh(0.1 if accepted else -0.2), atol=1e-6)
    evaluator = Evaluator(assembly.scenarios(config), assembly.settings(config).evaluation)
    compared = trained.handed_over.compare(evaluator, 100, "aligned", Stream.FINAL, 2)
    assert compared.accepted_env_steps == (50 if accepted else 0)
    assert (compared.accepted.returns == compared.controller.returns).all() != accepted
    assert (compared.accepted.returns != compared.residual.returns).all()
    evaluator.close()
    env.close()


@pytest.mark.parametrize("accepted", [True, False])
def test_initial_weights_are_those_of_the_policy_handed_over(residual, tmp_path, accepted, caplog):
    run = residual(accepted)
    config = resolve("env=insertion-sim", f"init_from.run='{run}'")
    with assembly.trainer(config, tmp_path / "next") as trainer:
        before = {k: v.clone() for k, v in trainer.agent.named_parameters()}
        start_from(trainer.agent, config)
        bias = last_linear(trainer.agent.policy).bias.detach()
        torch.testing.assert_close(bias, torch.full_like(bias, 0.3 if accepted else 0.0))
        if not accepted:
            assert all(torch.equal(v, before[k]) for k, v in trainer.agent.named_parameters())
    assert ("hands over the controller; starting from scratch" in caplog.text) != accepted


def test_a_residual_is_no_controller(tmp_path):
    run = train(tmp_path / "run", "env=insertion-sim")
    with pytest.raises(ValueError, match=r"expected a policy that acts alone \(arm=rl\)"):
        policy_controller(str(run))
