"""Mirror images: a group of maps, an actor that is the same in all of them, learning from images."""

import copy
import itertools

import pytest
import torch
from tensordict import TensorDict

from agents import ACTION, OBSERVATION, batches, make_agent, parameters
from rrl.algorithms import DDPG, SAC, TD3
from rrl.keys import OBSERVATION as FEATURES
from rrl.symmetry import Symmetry

LEFT_RIGHT = ([-2, -1, 3, 4, 5], [-1, 2])
FRONT_BACK = ([1, 2, -3, -4, 5], [1, -2])
QUARTER_TURN = ([2, -1, 3, 4, 5], [2, -1])
MIRRORS = Symmetry([LEFT_RIGHT, FRONT_BACK])
every_algorithm = pytest.mark.parametrize("algorithm", [TD3, SAC, DDPG])


@pytest.mark.parametrize(
    ("mirrors", "size"),
    [
        ([LEFT_RIGHT], 2),
        ([LEFT_RIGHT, FRONT_BACK], 4),
        ([QUARTER_TURN], 4),
        ([QUARTER_TURN, LEFT_RIGHT], 8),
    ],
)
def test_mirrors_generate_a_group(mirrors, size):
    symmetry = Symmetry(mirrors)
    x = torch.randn(7, OBSERVATION)
    images = symmetry.images(x)
    assert symmetry.num_images == size
    assert images.shape == (7, size, OBSERVATION)
    assert torch.equal(images[:, 0], x)
    assert len({tuple(image) for image in images[0].tolist()}) == size
    for g in range(size):  # images of an image are the same images
        assert {tuple(i) for i in symmetry.images(images[:1, g])[0].tolist()} == {
            tuple(i) for i in images[0].tolist()
        }


def test_the_image_is_what_the_map_says():
    x, which = torch.arange(1.0, 6.0), torch.tensor(1)
    assert Symmetry([LEFT_RIGHT]).reflect(x, which).tolist() == [-2, -1, 3, 4, 5]
    assert Symmetry([QUARTER_TURN]).reflect_action(x[:2], which).tolist() == [2, -1]


def test_returned_actions_undo_the_image():
    symmetry, action = Symmetry([QUARTER_TURN, LEFT_RIGHT]), torch.randn(6, ACTION)
    every = torch.arange(8).expand(6, 8)
    images = symmetry.reflect_action(action.unsqueeze(1).expand(6, 8, ACTION), every)
    torch.testing.assert_close(
        symmetry.return_actions(images), action.unsqueeze(1).expand_as(images)
    )


@every_algorithm
@pytest.mark.parametrize("mirrors", [[LEFT_RIGHT, FRONT_BACK], [QUARTER_TURN]])
def test_the_policy_does_in_the_image_the_image_of_what_it_does(algorithm, mirrors):
    symmetry = Symmetry(mirrors)
    agent = make_agent(algorithm, last_layer_bound=0.5, symmetry=symmetry)
    agent.update(batches(3))
    observation = torch.randn(10, OBSERVATION)
    for policy, x in ((agent.policy, observation), (agent.policy, observation[5:])):
        with torch.no_grad(), torch.inference_mode():
            action = deterministic(policy, x)
            assert action.abs().max() > 0.01
            for g in range(symmetry.num_images):
                which = torch.full((len(x),), g)
                image = deterministic(policy, symmetry.reflect(x, which))
                torch.testing.assert_close(
                    image, symmetry.reflect_action(action, which), rtol=1e-4, atol=1e-5
                )


def deterministic(policy, observation):
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return policy(TensorDict({"observation": observation}, [len(observation)]))["action"]


@every_algorithm
def test_one_observation_without_batch(algorithm):
    agent = make_agent(algorithm, symmetry=MIRRORS)
    assert agent.policy(TensorDict({"observation": torch.randn(OBSERVATION)}))["action"].shape == (
        ACTION,
    )


@every_algorithm
def test_an_untrained_residual_is_zero(algorithm):
    agent = make_agent(algorithm, symmetry=MIRRORS)
    assert not deterministic(agent.policy, torch.randn(5, OBSERVATION)).any()


def test_every_image_is_learned_from_with_its_reward(monkeypatch):
    agent, seen = make_agent(TD3, symmetry=MIRRORS), []
    reflect = Symmetry.reflect_transitions

    def watched(symmetry, given):
        reflect(symmetry, given)
        seen.append(given.clone())

    monkeypatch.setattr(Symmetry, "reflect_transitions", watched)
    data = batches(40)
    agent.update(data.clone())
    (given,) = seen
    images = MIRRORS.images(data["observation"])
    which = (images == given[FEATURES].unsqueeze(-2)).all(-1).long().argmax(-1)
    assert torch.equal(given[FEATURES], MIRRORS.reflect(data["observation"], which))
    assert torch.equal(given["next", FEATURES], MIRRORS.reflect(data["next", "observation"], which))
    assert torch.equal(given["action"], MIRRORS.reflect_action(data["action"], which))
    assert torch.equal(given["next", "reward"], data["next", "reward"])
    torch.testing.assert_close(
        which.flatten().bincount() / which.numel(), torch.full((4,), 0.25), atol=0.06, rtol=0.0
    )


def test_state_dict_restores_the_next_images():
    agent, other = make_agent(symmetry=MIRRORS), make_agent(symmetry=MIRRORS)
    agent.update(batches(3))
    other.load_state_dict(copy.deepcopy(agent.state_dict()))
    for learner in (agent, other):
        torch.manual_seed(1)
        learner.update(batches(3, seed=1))
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@pytest.mark.parametrize(
    ("mirrors", "message"),
    [
        ([([1, 1], [1])], "the numbers 1 to 2 once each"),
        ([([1, 3], [1])], "the numbers 1 to 2 once each"),
        ([([0, 1], [1])], "the numbers 1 to 2 once each"),
        ([([1, 2], [])], "the numbers"),
        ([], "at least one"),
        ([([1, 2], [1]), ([1], [1])], "same lengths"),
        (
            [([2, 3, 4, 5, 1, 7, 8, 6, *range(9, 40), 8 + 32], [1]), ([2, 1, *range(3, 41)], [1])],
            "at most 64 images",
        ),
    ],
)
def test_bad_mirrors_are_named(mirrors, message):
    with pytest.raises(ValueError, match=message):
        Symmetry(mirrors)


def test_a_symmetry_of_another_size_is_named():
    with pytest.raises(
        ValueError, match="symmetry: expected maps of 5 features and 2 numbers of action"
    ):
        make_agent(symmetry=Symmetry([([-1, 2], [-1, 2])]))


def test_images_of_images_cover_all_pairs():
    for one, other in itertools.product(range(4), repeat=2):
        x = torch.randn(OBSERVATION)
        twice = MIRRORS.reflect(MIRRORS.reflect(x, torch.tensor(one)), torch.tensor(other))
        assert any(torch.equal(twice, image) for image in MIRRORS.images(x))


def test_images_are_made_where_the_numbers_lie():
    symmetry = Symmetry([([1, -2], [-1])])
    numbers, which = torch.zeros(3, 2, device="meta"), torch.zeros(3, dtype=torch.long)
    assert symmetry.images(numbers).device.type == "meta"
    assert symmetry.reflect(numbers, which.to("meta")).device.type == "meta"
    assert symmetry.return_actions(torch.zeros(3, 2, 1, device="meta")).device.type == "meta"
    entries = {FEATURES: numbers, "action": numbers[:, :1], "next": {FEATURES: numbers}}
    batches = TensorDict(entries, [3])
    symmetry.reflect_transitions(batches)
    assert batches["action"].device.type == "meta"
