"""In TorchRL's own collector and buffer: what is stored is what was executed, a share is drawn."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose
from torchrl.modules import RandomPolicy

from rrl.interventions import InterventionSampler, ScriptedOperator, relabel_interventions
from rrl.transforms import ControlNoise, Intervention, ResidualAction
from toy_envs import PointMass
from transform_cases import proportional


def test_a_collector_stores_the_executed_residual() -> None:
    operator = ScriptedOperator(proportional(), share=0.5, noise=0.3, seed=0)
    chain = Compose(
        ControlNoise(), Intervention(operator, 0.5), ResidualAction(proportional(), scale=0.4)
    )
    env = TransformedEnv(PointMass((2,)), chain)
    collector = Collector(
        env,
        RandomPolicy(env.action_spec),
        frames_per_batch=80,
        total_frames=400,
        postproc=relabel_interventions,
        auto_register_policy_transforms=False,
    )
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(400), sampler=InterventionSampler(0.25), batch_size=64
    )
    for data in collector:
        buffer.extend(data.reshape(-1))
    collector.shutdown()
    stored = buffer[:]
    taken, clipped = stored["intervened"].squeeze(-1), stored["exceeds_authority"].squeeze(-1)
    assert 0 < taken.sum() < 400
    assert 0 < clipped.sum() < taken.sum()
    assert not (clipped & ~taken).any()
    assert (stored["action"].abs() <= 1).all()
    total = (stored["base_action"] + 0.4 * stored["action"]).clamp(-1, 1)
    error = (stored["next", "executed_action"] - total).abs().amax(-1)
    assert error[~clipped].max() < 1e-5 < error[clipped].min()
    share = torch.stack([buffer.sample()["intervened"] for _ in range(50)]).float().mean()
    assert share == pytest.approx(0.25 + 0.75 * float(taken.float().mean()), abs=0.05)


def flagged(count: int, every: int, device: str = "cpu") -> TensorDictReplayBuffer:
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(count, device=device), sampler=InterventionSampler(0.25)
    )
    numbers = torch.arange(count)
    flags = (numbers % every == every - 1).unsqueeze(-1)
    buffer.extend(TensorDict({"intervened": flags, "number": numbers}, [count]))
    return buffer


def needs_a_gpu(device: str):
    missing = not torch.cuda.is_available()
    return pytest.param(device, marks=pytest.mark.skipif(missing, reason="without a GPU"))


@pytest.mark.parametrize("device", ["cpu", needs_a_gpu("cuda:0")])
def test_every_part_of_a_sample_has_the_share(device) -> None:
    torch.manual_seed(0)
    drawn = flagged(1000, 500, device).sample(64 * 20)["intervened"].reshape(20, 64)
    at_least = drawn.sum(-1)
    assert (at_least >= 16).all() and (at_least <= 18).all()


def test_before_the_first_intervention_all_is_drawn_from_all() -> None:
    assert not flagged(100, every=1000).sample(64)["intervened"].any()


def test_a_storage_of_no_tensordict_is_told() -> None:
    buffer = TensorDictReplayBuffer(sampler=InterventionSampler(0.5), batch_size=2)
    buffer.extend(TensorDict({"intervened": torch.zeros(4, 1, dtype=torch.bool)}, [4]))
    with pytest.raises(TypeError, match="such as LazyTensorStorage, got a ListStorage"):
        buffer.sample()


def test_what_lacks_the_flag_is_told() -> None:
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(4), sampler=InterventionSampler(0.5), batch_size=2
    )
    buffer.extend(TensorDict({"x": torch.zeros(4)}, [4]))
    with pytest.raises(KeyError, match="store steps as relabel_interventions leaves them"):
        buffer.sample()
    with pytest.raises(KeyError, match="is there an Intervention among"):
        relabel_interventions(TensorDict({"action": torch.zeros(4, 1)}, [4]))
    with pytest.raises(ValueError, match="share: expected a number in"):
        InterventionSampler(1.5)
