"""Updates from images: who teaches the encoder, and that compiling changes nothing."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from rrl.algorithms import DDPG, SAC, TD3, mlp
from rrl.encoders import automatic
from rrl.inputs import Input
from rrl.symmetry import Symmetry

BATCH, SIDE = 8, 12
INPUTS = {"camera": Input(shape=(SIDE, SIDE, 3), channels="last"), "vector": Input(shape=(2,))}
POSES = {"pose": Input(shape=(4,))}
LEARNERS = {
    "TD3": TD3,
    "ensemble": partial(TD3, num_critics=3),
    "SAC": SAC,
    "SAC ensemble": partial(SAC, num_critics=3),
}
each_learner = pytest.mark.parametrize("learner", LEARNERS)


def make(learner, seed=0, inputs=INPUTS, **arguments):
    torch.manual_seed(seed)
    encoder = partial(automatic, channels=[4, 4], kernels=[3, 3], strides=[2, 2], features=6)
    given = {"encoder": encoder, "network": partial(mlp, hidden=[16]), "last_layer_bound": 0.1}
    return LEARNERS.get(learner, learner)(inputs, 2, **given | arguments)


def batches(k):
    draw = torch.Generator().manual_seed(0)

    def state():
        picture = (k, BATCH, SIDE, SIDE, 3)
        return {
            "camera": torch.randint(0, 256, picture, generator=draw, dtype=torch.uint8),
            "vector": torch.randn(k, BATCH, 2, generator=draw),
            "pose": torch.randn(k, BATCH, 4, generator=draw),
        }

    over = torch.rand(k, BATCH, 1, generator=draw) < 0.1
    following = {"reward": torch.randn(k, BATCH, 1, generator=draw), "done": over}
    following = {**state(), **following, "terminated": over.clone()}
    action = torch.rand(k, BATCH, 2, generator=draw) * 2 - 1
    return TensorDict({**state(), "action": action, "next": following}, [k, BATCH])


def learn(agent, k=2, seed=0):
    torch.manual_seed(seed)
    return agent.update(batches(k))


def parameters(agent):
    return {n: v.clone() for n, v in agent.state_dict().items() if isinstance(v, torch.Tensor)}


@each_learner
def test_the_critics_teach_the_encoder(learner):
    agent = make(learner, actor_lr=1e-9)
    before = [p.clone() for p in agent.encoder.parameters()]
    learn(agent, 1)
    assert all(
        not torch.equal(a, b) for a, b in zip(before, agent.encoder.parameters(), strict=True)
    )
    assert len(agent.encoders) == 1


@each_learner
def test_critics_with_entries_of_their_own_leave_the_encoder_to_the_policy(learner):
    agent = make(learner, critic_inputs=POSES)
    fixed = make(learner, critic_inputs=POSES, actor_lr=1e-12)
    before = [p.clone() for p in agent.encoder.parameters()]
    for one in (agent, fixed):
        learn(one, 4)
    assert all(
        not torch.equal(a, b) for a, b in zip(before, agent.encoder.parameters(), strict=True)
    )
    assert all(
        torch.allclose(a, b, atol=1e-9)
        for a, b in zip(before, fixed.encoder.parameters(), strict=True)
    )
    state = batches(1)[0].select(*INPUTS)
    assert agent.policy(state)["action"].shape == (BATCH, 2)  # without a pose


@each_learner
@pytest.mark.parametrize("critic_inputs", [None, POSES, {**INPUTS, **POSES}])
def test_random_numbers_come_from_torchs_generator(learner, critic_inputs):
    one, same, other = (make(learner, critic_inputs=critic_inputs) for _ in range(3))
    for agent, seed in ((one, 0), (same, 0), (other, 1)):
        learn(agent, 4, seed)
    for name, value in parameters(one).items():
        assert torch.equal(value, parameters(same)[name]), name
    assert any(not torch.equal(v, parameters(other)[n]) for n, v in parameters(one).items())


def renamed(entries, **names):
    return {names.get(key, key): entry for key, entry in entries.items()}


@each_learner
@pytest.mark.parametrize("name", ["observation", "critic_observation"])
@pytest.mark.parametrize(
    ("inputs", "critic_inputs"),
    [
        (INPUTS, {**INPUTS, **POSES}),
        (INPUTS, POSES),
        ({"vector": INPUTS["vector"]}, INPUTS),
        (INPUTS, {"vector": INPUTS["vector"]}),
    ],
)
def test_an_entry_may_have_any_name(learner, name, inputs, critic_inputs):
    agents = []
    for names in ({}, {"vector": name}):
        agent = make(
            learner, inputs=renamed(inputs, **names), critic_inputs=renamed(critic_inputs, **names)
        )
        torch.manual_seed(0)
        data = batches(3)
        for half in (data, data["next"]):
            for old, new in names.items():
                half.rename_key_(old, new)
        agent.calibrate(data.reshape(-1))
        agent.update(data)
        agents.append(parameters(agent))
    expected, found = agents
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert torch.equal(found[key], value), key


def test_the_name_of_features_is_refused():
    with pytest.raises(ValueError, match=r"inputs: expected no entry called '_observation'"):
        make("TD3", inputs=renamed(INPUTS, vector="_observation"))


class Counting(torch.nn.Module):
    """Learns a factor; augmenting adds one, and what it reads is kept."""

    out_features = 1

    def __init__(self, inputs):
        super().__init__()
        self.factor, self.seen = torch.nn.Parameter(torch.ones(1)), []

    def augment(self, *values):
        return [value + 1 for value in values]

    def forward(self, *values):
        self.seen += values
        return self.factor * sum(value.mean(-1, keepdim=True) for value in values)


def test_what_actor_and_critics_read_is_augmented_once():
    vector, pose = {"vector": Input(shape=(2,))}, {"pose": Input(shape=(4,))}
    agent = make("TD3", inputs=vector, critic_inputs={**vector, **pose}, encoder=Counting)
    learn(agent)
    data = batches(2)
    augmented = [data[i][place] + 1 for i in range(2) for place in ("vector", ("next", "vector"))]
    for encoder in agent.encoders:
        seen = [value for value in encoder.seen if value.shape[-1] == 2]
        assert seen
        assert all(any(torch.equal(v, known) for known in augmented) for v in seen)


def test_an_agent_starts_from_the_encoder_of_another():
    one, other = make("TD3"), make("TD3", seed=1)
    learn(one)
    other.start_from(one)
    for a, b in zip(one.encoder.parameters(), other.encoder.parameters(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
@pytest.mark.parametrize("critic_inputs", [None, POSES])
@each_learner
def test_a_compiled_update_is_the_eager_one(learner, critic_inputs):
    compiled, eager = (
        make(learner, critic_inputs=critic_inputs, compiled=c) for c in (True, False)
    )
    for agent in (compiled, eager):
        for seed in range(3):
            learn(agent, 2, seed)
    assert compiled.compile_seconds > 0
    assert compiled._updates._compiled
    for name, value in parameters(eager).items():
        assert torch.allclose(value, parameters(compiled)[name], atol=1e-5), name


def test_what_cannot_learn_from_images_says_so():
    with pytest.raises(ValueError, match=r"encoder: expected one that learns nothing.*use TD3"):
        make(DDPG)
    mirror = Symmetry([([-1, *range(2, 9)], [-1, 2])])
    with pytest.raises(ValueError, match=r"symmetry: expected .*use_symmetries to false"):
        make("TD3", symmetry=mirror)
