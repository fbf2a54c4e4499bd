"""Exploration noise: its statistics, its reset with the episode, one stream per slot."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rrl.exploration import GaussianExploration, OrnsteinUhlenbeckExploration

BOTH = [GaussianExploration, OrnsteinUhlenbeckExploration]


def explore(module, slots, steps, first=0.0, starts=()):
    """Noise on zero actions, ``[steps, slots, 3]``; an episode starts at step 0 and at ``starts``."""
    rows = []
    for t in range(steps):
        td = TensorDict(
            {
                "action": torch.full((slots, 3), first),
                "is_init": torch.full((slots, 1), t == 0 or t in starts),
            },
            [slots],
        )
        rows.append(module(td)["action"].clone())
    return torch.stack(rows)


def make(kind, slots=1, **arguments):
    return kind(Bounded(-1, 1, (slots, 3)), num_slots=slots, **{"sigma": 0.2, **arguments})


def test_gaussian_noise_has_the_given_spread_and_stays_in_bounds():
    noise = explore(make(GaussianExploration, 4), 4, 500)
    assert noise.std() == pytest.approx(0.2, rel=0.05)
    assert explore(make(GaussianExploration, 1, sigma=5.0), 1, 50).abs().max() == 1.0


def test_ornstein_uhlenbeck_noise_is_correlated_within_an_episode_only():
    noise = explore(make(OrnsteinUhlenbeckExploration, 200), 200, 20, starts=(10,)).flatten(1)

    def correlation(t):
        return torch.corrcoef(noise[t - 1 : t + 1])[0, 1]

    assert correlation(9) > 0.7
    assert abs(correlation(10)) < 0.15


def test_correlated_noise_reaches_the_given_spread_and_forgets_at_the_given_rate():
    noise = explore(make(OrnsteinUhlenbeckExploration, 200, theta=0.5), 200, 20).flatten(1)
    assert noise[-1].std() == pytest.approx(0.2, rel=0.1)
    assert torch.corrcoef(noise[-2:])[0, 1] == pytest.approx(0.5, abs=0.1)


def test_a_theta_that_is_no_share_is_refused():
    with pytest.raises(ValueError, match="theta: expected a share"):
        make(OrnsteinUhlenbeckExploration, theta=0.0)


@pytest.mark.parametrize("kind", BOTH)
def test_a_slot_explores_alike_in_any_batch(kind):
    batch = explore(make(kind, 3, seed=5), 3, 8)
    alone = explore(make(kind, 1, seed=6), 1, 8)
    assert torch.equal(batch[:, 1:2], alone)


@pytest.mark.parametrize("kind", BOTH)
def test_silent_unless_exploring(kind):
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(explore(make(kind), 1, 3, first=0.5), torch.full((3, 1, 3), 0.5))


@pytest.mark.parametrize("kind", BOTH)
def test_sigma_goes_to_its_end_in_a_straight_line_and_stays(kind):
    module = make(kind, sigma=0.4, sigma_end=0.1, decay_steps=30)
    seen = []
    for _ in range(5):
        seen.append(module.sigma)
        module.step(10)
    assert seen == pytest.approx([0.4, 0.3, 0.2, 0.1, 0.1])


def test_the_noise_follows_sigma():
    module = make(GaussianExploration, 4, sigma=0.2, sigma_end=0.02, decay_steps=10)
    module.step(10)
    assert explore(module, 4, 500).std() == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("kind", BOTH)
def test_state_dict_continues_the_process(kind):
    module, other = (make(kind, 2, seed=seed, sigma_end=0.1, decay_steps=7) for seed in (0, 9))
    module.step(3)
    explore(module, 2, 4)
    other.load_state_dict(module.state_dict())
    td = TensorDict(
        {"action": torch.zeros(2, 3), "is_init": torch.zeros(2, 1, dtype=torch.bool)}, [2]
    )
    for _ in range(3):
        assert torch.equal(module(td.clone())["action"], other(td.clone())["action"])
        module.step()
        other.step()


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize(
    ("name", "value"), [("sigma", -0.1), ("sigma_end", -0.1), ("decay_steps", 0)]
)
def test_bad_parameters_are_named(kind, name, value):
    with pytest.raises(ValueError, match=name):
        make(kind, **{name: value})
