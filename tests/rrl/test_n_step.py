"""n-step returns against their definition, above all where episodes end."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives.value import TD0Estimator

from rrl.n_step import STEPS, n_step_transitions

GAMMA = 0.9


def episode(
    time: int = 8, terminated_at: int | None = None, truncated_at: int | None = None
) -> TensorDict:
    """One environment [1, T]; the observation counts the steps, the reward of step t is t + 1."""
    count = torch.arange(time + 1, dtype=torch.float32).reshape(1, -1, 1)
    terminated, truncated = (
        torch.zeros(1, time, 1, dtype=torch.bool),
        torch.zeros(1, time, 1, dtype=torch.bool),
    )
    if terminated_at is not None:
        terminated[:, terminated_at] = True
    if truncated_at is not None:
        truncated[:, truncated_at] = True
    ends = {"done": terminated | truncated, "terminated": terminated}
    following = {"observation": count[:, 1:], "reward": count[:, 1:].clone(), **ends}
    return TensorDict({"observation": count[:, :-1], "next": following}, [1, time])


def targets(data: TensorDict) -> list[float]:
    """What TorchRL's estimator makes of the transitions when every next observation is worth 100."""
    data = data.clone()
    data["next", "state_value"] = torch.full_like(data["next", "reward"], 100.0)
    return TD0Estimator(gamma=GAMMA, value_network=None).value_estimate(data).flatten().tolist()


def by_definition(rewards: list[float], n: int, end: int, worth: float) -> list[float]:
    """r_0 + ... + gamma^(m-1) r_(m-1) + gamma^m V, V = ``worth`` where the window ends with the data at ``end``."""
    out = []
    for t in range(end):
        m = min(n, end - t)
        value = 100.0 if t + m < end else worth
        out.append(sum(GAMMA**i * rewards[t + i] for i in range(m)) + GAMMA**m * value)
    return out


@pytest.mark.parametrize("n", [1, 2, 3, 5, 20])
@pytest.mark.parametrize(("end", "worth"), [("terminated_at", 0.0), ("truncated_at", 100.0)])
def test_targets_at_the_end_of_an_episode(n: int, end: str, worth: float) -> None:
    """Nothing is bootstrapped through a termination; a truncation bootstraps with the discount of its steps."""
    data = n_step_transitions(episode(**{end: 4}), n, GAMMA)
    rewards = [float(t + 1) for t in range(8)]
    assert targets(data)[:5] == pytest.approx(by_definition(rewards, n, 5, worth), rel=1e-5)
    assert targets(data)[5:] == pytest.approx(by_definition(rewards[5:], n, 3, 100.0), rel=1e-5)


def test_a_window_stops_at_the_end_of_the_data() -> None:
    data = n_step_transitions(episode(4), 3, GAMMA)
    assert data[STEPS].flatten().tolist() == [3, 3, 2, 1]
    assert data["next", "observation"].flatten().tolist() == [3, 4, 4, 4]


def test_one_step_changes_nothing() -> None:
    data = episode(terminated_at=3)
    same = n_step_transitions(data, 1, GAMMA)
    assert (same.exclude(STEPS) == data).all()
    assert (same[STEPS] == 1).all()


def test_environments_do_not_mix_and_the_data_is_left_alone() -> None:
    one, other = episode(terminated_at=2), episode(truncated_at=5)
    both = torch.cat([one, other])
    before = both.clone()
    out = n_step_transitions(both, 3, GAMMA)
    assert (both == before).all()
    assert (out[:1] == n_step_transitions(one, 3, GAMMA)).all()
    assert (out[1:] == n_step_transitions(other, 3, GAMMA)).all()
    assert (n_step_transitions(one[0], 3, GAMMA) == out[0]).all()


def test_the_result_lies_where_the_data_does() -> None:
    """A device without data tells without a GPU which tensors meet on another one."""
    there = n_step_transitions(episode(terminated_at=3).to("meta"), 3, GAMMA)
    assert all(value.device.type == "meta" for value in there.values(True, True))


def test_a_bad_number_of_steps_is_named() -> None:
    with pytest.raises(ValueError, match="n_step: expected a whole number of at least 1"):
        n_step_transitions(episode(), 0, GAMMA)
