"""The whole chain under TorchRL's Collector, as a trainer uses it."""

from __future__ import annotations

import copy

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from transform_cases import CASES, make_env


def test_stored_actions_are_the_residuals_and_add_up_to_what_was_executed() -> None:
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(6, 2), nn.Tanh())
    policy = TensorDictModule(network, in_keys=["observation"], out_keys=["action"])
    env = make_env(CASES["chain"], (2,))
    collector = Collector(
        env,
        copy.deepcopy(policy),
        frames_per_batch=50,
        total_frames=100,
        trust_policy=True,
        use_buffers=False,
        auto_register_policy_transforms=False,
    )
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(200), batch_size=32)
    for batch in collector:
        buffer.extend(batch.reshape(-1))
    stored = buffer.storage[:100]
    with torch.no_grad():
        said = policy(stored.select("observation"))["action"]
    assert torch.allclose(stored["action"], said, atol=1e-5)
    undisturbed = stored["base_action"] + torch.tensor([0.5, 1.0]) * stored["action"]
    error = stored["next", "executed_action"] - torch.clamp(undisturbed, -1.0, 1.0)
    inside = stored["next", "executed_action"].abs() < 1.0
    assert error[inside].abs().max() < 5 * 0.3 + 0.2
    bias = error[..., 0][inside[..., 0]].mean() - error[..., 1][inside[..., 1]].mean()
    assert bias > 0.1
    collector.shutdown()
