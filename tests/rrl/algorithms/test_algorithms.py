"""What every algorithm must do, whichever it is."""

import copy
import io
from functools import partial

import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import AdditiveGaussianModule, TanhNormal

from agents import ACTION, BATCH, OBSERVATION, batches, critics, learn, make_agent, parameters
from rrl.algorithms import DDPG, SAC, TD3, mlp, no_exploration
from rrl.controllers import ProportionalController
from rrl.keys import OBSERVATION as FEATURES
from rrl.trainers import EnvironmentFactory, Trainer, TrainerSettings
from toy_envs import EPISODE_STEPS, PointMass

ALGORITHMS = [TD3, SAC, DDPG]
each_algorithm = pytest.mark.parametrize("algorithm", ALGORITHMS)


@each_algorithm
@pytest.mark.parametrize("layer_norm", [False, True])
def test_all_random_numbers_come_from_torchs_generator(algorithm, layer_norm):
    make = partial(make_agent, algorithm, layer_norm=layer_norm, last_layer_bound=0.1)
    one, same, other = make(), make(), make(seed=1)
    for agent in (one, same, other):
        learn(agent, 4)
    for name, value in parameters(one).items():
        assert torch.equal(value, parameters(same)[name]), name
    assert any(not torch.equal(v, parameters(other)[name]) for name, v in parameters(one).items())


ENSEMBLE = {"num_critics": 4, "target_subset": 2}


@pytest.mark.parametrize(
    ("algorithm", "arguments"),
    [(TD3, {}), (SAC, {}), (DDPG, {}), (TD3, ENSEMBLE), (SAC, ENSEMBLE)],
)
def test_the_default_type_of_the_process_changes_nothing(algorithm, arguments):
    learned = []
    for default in (torch.float32, torch.float64):
        data = batches(4)
        torch.set_default_dtype(default)
        try:
            agent = make_agent(algorithm, last_layer_bound=0.1, **arguments)
            agent.update(data)
        finally:
            torch.set_default_dtype(torch.float32)
        learned.append(parameters(agent))
    for name, value in learned[0].items():
        assert torch.equal(value, learned[1][name]), name


def as_double(value):
    return value.double() if value.is_floating_point() else value


@each_algorithm
def test_data_of_double_precision_is_learned_from_in_single(algorithm):
    """As DMControl's and Gymnasium's environments give it."""
    single, double = (make_agent(algorithm, last_layer_bound=0.1) for _ in range(2))
    data = batches(4)
    for agent, given in ((single, data), (double, data.apply(as_double))):
        torch.manual_seed(1)
        agent.update(given)
    for name, value in parameters(single).items():
        assert torch.equal(value, parameters(double)[name]), name


def pickled(agent):
    file = io.BytesIO()
    torch.save(agent, file)
    file.seek(0)
    return torch.load(file, weights_only=False)


@pytest.mark.parametrize(
    ("algorithm", "arguments"),
    [
        (TD3, {}),
        (SAC, {}),
        (DDPG, {}),
        (TD3, ENSEMBLE),
        (TD3, {"critic_inputs": {"observation": 5}}),
    ],
)
@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_a_copy_learns_on_as_the_original_does(algorithm, arguments, copied):
    agent = make_agent(algorithm, last_layer_bound=0.1, reward_scale=None, **arguments)
    agent.calibrate(batches(1)[0])
    learn(agent, 3)
    random = torch.get_rng_state()
    other = copied(agent)
    assert torch.equal(torch.get_rng_state(), random)
    before = copy.deepcopy(parameters(agent))
    learn(other, 3, seed=1)
    for name, value in parameters(agent).items():
        assert torch.equal(value, before[name]), name
    learn(agent, 3, seed=1)
    td = TensorDict({"observation": torch.randn(4, OBSERVATION)}, [4])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        actions = [learner.policy(td.clone())["action"] for learner in (agent, other)]
    assert torch.equal(*actions)
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@pytest.mark.parametrize(
    ("algorithm", "arguments"),
    [(TD3, {}), (SAC, {}), (DDPG, {}), (TD3, ENSEMBLE), (SAC, ENSEMBLE)],
)
def test_a_learner_that_was_moved_and_moved_back_learns_on_as_before(algorithm, arguments):
    """As from a GPU to the CPU, to be saved, and back."""
    stayed, moved = (make_agent(algorithm, last_layer_bound=0.1, **arguments) for _ in range(2))
    for agent in (stayed, moved):
        learn(agent, 4)
    moved.double().float()
    for agent in (stayed, moved):
        learn(agent, 8, seed=1)
    for name, value in parameters(stayed).items():
        assert torch.equal(value, parameters(moved)[name]), name


@each_algorithm
def test_an_empty_batch_has_an_empty_answer(algorithm):
    td = TensorDict({"observation": torch.zeros(0, OBSERVATION)}, [0])
    assert make_agent(algorithm).policy(td)["action"].shape == (0, ACTION)


@pytest.mark.parametrize(("algorithm", "draws"), [(TD3, True), (SAC, True), (DDPG, False)])
def test_what_is_drawn_in_an_update_changes_it(algorithm, draws):
    one, other = (make_agent(algorithm, last_layer_bound=0.1) for _ in range(2))
    for seed, agent in enumerate((one, other)):
        torch.manual_seed(seed)
        agent.update(batches(4))
    moved = any(not torch.equal(v, parameters(other)[n]) for n, v in parameters(one).items())
    assert moved is draws


@each_algorithm
def test_state_dict_restores_acting_and_the_next_update_to_the_last_bit(algorithm):
    agent, other = make_agent(algorithm), make_agent(algorithm, seed=7)
    td = TensorDict({"observation": torch.randn(4, OBSERVATION)}, [4])
    learn(agent, 3)
    other.load_state_dict(copy.deepcopy(agent.state_dict()))
    actions = []
    for learner in (agent, other):
        learn(learner, 3, seed=1)
        actions.append(learner.policy(td.clone())["action"])
    assert torch.equal(*actions)
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@each_algorithm
def test_in_the_burn_in_critics_and_targets_learn_and_the_policy_waits(algorithm):
    agent = make_agent(algorithm, last_layer_bound=0.1, critic_burn_in=4)
    before = copy.deepcopy(parameters(agent))

    def moved():
        now = parameters(agent)
        return {name for name in before if not torch.equal(before[name], now[name])}

    metrics = learn(agent, 4)
    assert any("loss.target" in name and "value" in name for name in moved())
    assert not any(name.startswith(("policy", "loss.actor")) for name in moved())
    assert "loss_actor" not in metrics
    assert "loss_actor" in learn(agent, 4)
    assert any(name.startswith("policy") for name in moved())


@each_algorithm
@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
def test_the_compiled_update_equals_the_eager_one(algorithm):
    eager, compiled = (
        make_agent(algorithm, last_layer_bound=0.1, compiled=c) for c in (False, True)
    )
    for learner in (eager, compiled):
        learn(learner, 10)
    assert compiled.compile_seconds > 0
    for name, value in parameters(eager).items():
        torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-5, atol=1e-5)


@each_algorithm
@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_compiled_learner_goes_on_from_a_state_as_the_eager_one_does(algorithm):
    eager, compiled = (
        make_agent(algorithm, tau=0.3, last_layer_bound=0.1, compiled=c) for c in (False, True)
    )
    learn(eager, 4)
    compiled.load_state_dict(copy.deepcopy(eager.state_dict()))
    for learner in (eager, compiled):
        learn(learner, 4, seed=1)
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
            learn(learner, 4)
        for name, value in parameters(eager).items():
            torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-4, atol=1e-5)


def test_sacs_critic_learns_the_soft_bellman_target():
    """The target, written out: r + gamma (1 - terminated) (min Q' - alpha log pi)."""
    agent = make_agent(SAC, last_layer_bound=0.3, initial_temperature=0.7, gamma=0.9)
    learn(agent, 3)
    batch = agent.readings.prepare(batches(1))[0]
    temperature = agent.loss.log_alpha.detach().exp()
    torch.manual_seed(2)
    loss, _ = agent.value_loss(batch)
    with torch.no_grad():
        features = batch["next", FEATURES]
        head = agent.policy[0](TensorDict({"observation": features}, [BATCH]))
        torch.manual_seed(2)
        before = head["_loc"] + head["_scale"] * torch.randn(BATCH, ACTION)
        density = TanhNormal(head["_loc"], head["_scale"], event_dims=1)
        inputs = features, before.tanh()
        values = [q(*inputs) for q in critics(agent.loss, "target_qvalue_network_params")]
        soft = torch.stack(values).min(0)[0] - temperature * density.log_prob(before.tanh())
        goes_on = ~batch["next", "terminated"].squeeze(-1)
        target = batch["next", "reward"].squeeze(-1) + 0.9 * goes_on * soft
        now = [
            q(batch[FEATURES], batch["action"])
            for q in critics(agent.loss, "qvalue_network_params")
        ]
        expected = (torch.stack(now) - target).square().sum(0).mean()
    torch.testing.assert_close(loss, expected, rtol=1e-3, atol=1e-4)


def test_sac_tunes_the_temperature_to_the_entropy():
    agent = make_agent(SAC, initial_std=0.01, temperature_lr=0.01)  # far too little entropy
    for i in range(20):
        metrics = learn(agent, 5, seed=i)
    assert metrics["entropy"] < -ACTION
    assert agent.loss.log_alpha.exp() > 0.1
    assert metrics["temperature"] > 0.1


def test_a_stochastic_policy_draws_each_action_and_without_exploration_is_the_tanh_of_the_mean():
    agent = make_agent(SAC, last_layer_bound=0.5)
    td = TensorDict({"observation": torch.zeros(6, OBSERVATION)}, [6])
    assert agent.policy(td.clone())["action"].unique(dim=0).shape[0] == 6
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        out = agent.policy(td.clone())
    torch.testing.assert_close(out["action"], out["_loc"].tanh())


def point_mass(num_envs=1):
    return PointMass([num_envs])


@pytest.mark.parametrize(
    "algorithm", [TD3, *(pytest.param(a, marks=pytest.mark.slow) for a in (DDPG, SAC))]
)
def test_a_residual_learns_what_the_controller_does_not_know(algorithm, tmp_path):
    """Four runs on the drifting point: better than the controller, by a one-sided t test over the seeds."""
    environment = EnvironmentFactory(
        point_mass,
        partial(ProportionalController, gain=10.0, clip=0.5),
        ["end_effector_position", "goal"],
        max_episode_steps=EPISODE_STEPS,
    )
    gaussian = partial(AdditiveGaussianModule, sigma_init=0.3, sigma_end=0.3)
    exploration = no_exploration if algorithm is SAC else gaussian
    agent = partial(algorithm, network=partial(mlp, hidden=[64, 64]), gamma=0.9, tau=0.01)
    gains = []
    for seed in range(4):
        settings = TrainerSettings(
            seed=seed,
            total_steps=800,
            warmup_steps=200,
            steps_per_collection=EPISODE_STEPS,
            batch_size=32,
            evaluation={"every": 0, "final_episodes": 50, "slots": 50},
            acceptance={"enabled": False},
            checkpoint={"every": 0},
        )
        with Trainer(environment, settings, agent, exploration, tmp_path / str(seed)) as trainer:
            gains.append(trainer.run()["training"].summary()["return_gain"])
    assert stats.ttest_1samp(gains, 0.0, alternative="greater").pvalue < 0.01, gains
