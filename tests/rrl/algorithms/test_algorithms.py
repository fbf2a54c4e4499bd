"""What every algorithm on stacked seeds must do, whichever it is."""

import copy
import math
from functools import partial

import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import TanhNormal

from agents import ACTION, OBSERVATION, batches, critics, make_agent, parameters
from rrl.algorithms import DDPG, SAC, TD3
from rrl.algorithms.squashed_gaussian import SquashedGaussian
from rrl.controllers import ProportionalController
from rrl.exploration import GaussianExploration, NoExploration
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings
from toy_envs import EPISODE_STEPS, PointMass

ALGORITHMS = [TD3, SAC, DDPG]
each_algorithm = pytest.mark.parametrize("algorithm", ALGORITHMS)


@each_algorithm
@pytest.mark.parametrize("layer_norm", [False, True])
def test_seeds_do_not_touch_each_other(algorithm, layer_norm):
    one, other = (
        make_agent(algorithm, 3, layer_norm=layer_norm),
        make_agent(algorithm, 3, layer_norm=layer_norm),
    )
    data = batches(4, 3)
    changed = data.clone()
    changed["next", "reward"][:, 1] += 10.0
    one.update(data)
    other.update(changed)
    for k, same in ((0, True), (1, False), (2, True)):
        pairs = zip(one.policy_of(k).parameters(), other.policy_of(k).parameters(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs) is same


@each_algorithm
def test_a_seed_learns_in_a_stack_what_it_learns_alone(algorithm):
    stack, alone = make_agent(algorithm, 3, seed=5), make_agent(algorithm, 1, seed=6)
    data = batches(6, 3)
    stack.update(data.clone())
    alone.update(data[:, 1:2].clone())
    for mine, other in zip(
        stack.policy_of(1).parameters(), alone.policy_of(0).parameters(), strict=True
    ):
        torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-6)


@each_algorithm
def test_an_untrained_residual_is_exactly_zero(algorithm):
    agent = make_agent(algorithm, 2)
    td = TensorDict({"observation": torch.randn(2, OBSERVATION)}, [2])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(agent.policy(td)["action"], torch.zeros(2, ACTION))
        assert torch.equal(agent.policy_of(1)(td)["action"], torch.zeros(2, ACTION))


@each_algorithm
def test_state_dict_restores_acting_and_the_next_update_to_the_last_bit(algorithm):
    agent, other = make_agent(algorithm, 2), make_agent(algorithm, 2, seed=7)
    td = TensorDict({"observation": torch.randn(4, OBSERVATION)}, [4])
    agent.update(batches(3, 2))
    agent.policy(td.clone())
    other.load_state_dict(copy.deepcopy(agent.state_dict()))
    actions = []
    for learner in (agent, other):
        learner.update(batches(3, 2, seed=1))
        actions.append(learner.policy(td.clone())["action"])
    assert torch.equal(*actions)
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@each_algorithm
def test_the_global_generator_is_left_alone(algorithm):
    agent = make_agent(algorithm, 2)
    before = torch.get_rng_state()
    agent.update(batches(3, 2))
    agent.policy(
        TensorDict({"observation": torch.randn(4, OBSERVATION, generator=torch.Generator())}, [4])
    )
    assert torch.equal(before, torch.get_rng_state())


@each_algorithm
def test_in_the_burn_in_critics_and_targets_learn_and_the_policy_waits(algorithm):
    agent = make_agent(algorithm, last_layer_bound=0.1, critic_burn_in=4)
    before = copy.deepcopy(parameters(agent))
    metrics = agent.update(batches(4, 1))
    moved = {name for name in before if not torch.equal(before[name], parameters(agent)[name])}
    assert any("loss.target" in name and "value" in name for name in moved)
    assert not any(name.startswith("_actor") for name in moved)
    assert "loss_actor" not in metrics
    assert "loss_actor" in agent.update(batches(4, 1))
    assert any(
        name.startswith("_actor")
        for name in before
        if not torch.equal(before[name], parameters(agent)[name])
    )


@each_algorithm
@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
def test_the_compiled_update_equals_the_eager_one(algorithm):
    eager, compiled = (
        make_agent(algorithm, 2, last_layer_bound=0.1, compiled=c) for c in (False, True)
    )
    for learner in (eager, compiled):
        learner.update(batches(10, 2))
    for name, value in parameters(eager).items():
        torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-5, atol=1e-5)


@each_algorithm
@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_compiled_learner_goes_on_from_a_state_as_the_eager_one_does(algorithm):
    eager, compiled = (
        make_agent(algorithm, tau=0.3, last_layer_bound=0.1, compiled=c) for c in (False, True)
    )
    eager.update(batches(4, 1))
    compiled.load_state_dict(copy.deepcopy(eager.state_dict()))
    for learner in (eager, compiled):
        learner.update(batches(4, 1, seed=1))
    for name, value in parameters(eager).items():
        torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_two_compiled_learners_keep_their_own_hyperparameters():
    for gamma in (0.5, 0.9):
        eager, compiled = (
            make_agent(TD3, gamma=gamma, actor_lr=gamma / 100, compiled=c) for c in (False, True)
        )
        for learner in (eager, compiled):
            learner.update(batches(4, 1))
        for name, value in parameters(eager).items():
            torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-4, atol=1e-5)


@each_algorithm
@pytest.mark.parametrize(
    ("name", "value"), [("gamma", 1.0), ("tau", 0.0), ("policy_delay", 0), ("critic_burn_in", -1)]
)
def test_bad_hyperparameters_are_named(algorithm, name, value):
    with pytest.raises(ValueError, match=name):
        make_agent(algorithm, **{name: value})


@pytest.mark.parametrize(("name", "value"), [("initial_std", 0.0), ("initial_temperature", 0.0)])
def test_bad_hyperparameters_of_sac_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        make_agent(SAC, **{name: value})


def test_the_squashed_gaussian_is_torchrls_tanh_normal():
    loc, scale = torch.randn(7, 3), torch.rand(7, 3) + 0.1
    noise = torch.randn(7, 3)
    action, log_prob = SquashedGaussian(
        loc, scale, noise, torch.full((7,), 0.5)
    ).rsample_and_log_prob()
    torch.testing.assert_close(action, (loc + scale * noise).tanh())
    reference = TanhNormal(loc, scale, event_dims=1).log_prob(action)
    torch.testing.assert_close(log_prob, 0.5 * reference, rtol=1e-4, atol=1e-4)
    density = SquashedGaussian(torch.zeros(1), torch.ones(1), torch.zeros(1), torch.tensor(1.0))
    assert density.rsample_and_log_prob()[1].item() == pytest.approx(-0.5 * math.log(2 * math.pi))


def test_sacs_critic_learns_the_soft_bellman_target():
    """The target, written out: r + gamma (1 - terminated) (min Q' - alpha log pi)."""
    agent = make_agent(SAC, 2, last_layer_bound=0.3, initial_temperature=0.7, gamma=0.9)
    batch = batches(1, 2)
    agent.prepare(batch)
    batch = batch[0]
    with torch.no_grad():
        loss, _ = agent.value_loss(batch)
        loc, scale = agent.head(agent._actor(batch["next", "observation"]))
        before = loc + scale * batch["next", "action_noise"]
        log_prob = TanhNormal(loc, scale, event_dims=1).log_prob(before.tanh())
        inputs = batch["next", "observation"], before.tanh()
        least = torch.stack(
            [q(*inputs) for q in critics(agent, "target_qvalue_network_params")]
        ).min(0)[0]
        soft = least - 0.7 * log_prob
        target = (
            batch["next", "reward"].squeeze(-1)
            + 0.9 * ~batch["next", "terminated"].squeeze(-1) * soft
        )
        now = torch.stack(
            [
                q(batch["observation"], batch["action"])
                for q in critics(agent, "qvalue_network_params")
            ]
        )
        expected = (now - target).square().sum(0)
    torch.testing.assert_close(loss, expected, rtol=1e-3, atol=1e-4)


def test_sac_tunes_each_seeds_temperature_to_the_entropy():
    agent = make_agent(SAC, 2, initial_std=0.01, temperature_lr=0.01)  # far too little entropy
    for i in range(20):
        agent.update(batches(5, 2, seed=i))
    assert (agent.temperature > 0.1).all()


def test_a_stochastic_policy_acts_alike_in_any_stack():
    td = TensorDict({"observation": torch.zeros(6, OBSERVATION)}, [6])
    stack, alone = (
        make_agent(SAC, 3, seed=4).policy(td.clone()),
        make_agent(SAC, 1, seed=5).policy(td[2:4].clone()),
    )
    torch.testing.assert_close(stack["action"][2:4], alone["action"])
    assert stack["action"].unique(dim=0).shape[0] == 6


def point_mass(num_envs=1):
    return PointMass([num_envs])


@each_algorithm
def test_a_residual_learns_what_the_controller_does_not_know(algorithm, tmp_path):
    """Four seeds on the drifting point: better than the controller, by a one-sided t test over the seeds."""
    environment = EnvironmentFactory(
        point_mass,
        partial(ProportionalController, gain=10.0, clip=0.5),
        ["end_effector_position", "goal"],
        max_episode_steps=EPISODE_STEPS,
    )
    settings = TrainerSettings(
        num_seeds=4,
        total_steps=1600,
        warmup_steps=400,
        steps_per_collection=EPISODE_STEPS,
        batch_size=32,
        evaluation={"every": 0, "final_episodes": 50, "slots": 50},
        checkpoint={"every": 0},
    )
    exploration = NoExploration if algorithm is SAC else partial(GaussianExploration, sigma=0.3)
    agent = partial(algorithm, hidden=[64, 64], gamma=0.9, tau=0.01)
    with Trainer(settings, environment, agent, exploration, tmp_path) as trainer:
        comparisons = trainer.run()["training"]
    gains = [c.summary()["return_gain"] for c in comparisons]
    assert stats.ttest_1samp(gains, 0.0, alternative="greater").pvalue < 0.01, gains
