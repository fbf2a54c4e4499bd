"""An environment on another device than the CPU, collected in every way, evaluated and resumed."""

from functools import partial

import pytest
import torch
from torchrl.data import Unbounded

from rrl.controllers import ProportionalController
from situation_envs import Simulator

ENTRIES = {
    "position": Unbounded((2,)),
    "target": Unbounded((2,)),
    ("metrics", "x"): Unbounded((1,)),
}
DEVICES = [
    "cpu:0",  # a device of another name, so that it is known without a GPU who is given what
    pytest.param(
        "cuda:0", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="without a GPU")
    ),
]


class Elsewhere(Simulator):
    """Its tensors lie on its device, and it takes no others."""

    def __init__(self, device, num_envs=1):
        super().__init__(ENTRIES, batch_size=[num_envs])
        self.to(torch.device(device))

    def to(self, device):
        super().to(device)
        self._count, self._push = self._count.to(device), self._push.to(device)
        return self

    def _observe(self):
        return super()._observe().to(self.device)

    def _step(self, tensordict):
        assert tensordict.device == self.device
        assert tensordict["action"].device.type == self.device.type
        return super()._step(tensordict).to(self.device)


@pytest.fixture
def elsewhere(factory):
    def make(device):
        return factory(
            partial(Elsewhere, device),
            inputs=["position", "target", "base_action"],
            controller=partial(ProportionalController, "position", "target"),
            batching="native",
        )

    return make


@pytest.mark.parametrize("device", DEVICES)
def test_the_chain_lies_on_the_cpu(elsewhere, device):
    env = elsewhere(device).make(2)
    assert env.base_env.device == torch.device(device)
    assert env.device == torch.device("cpu")
    seen = env.rollout(10, break_when_any_done=False)
    assert seen.device == torch.device("cpu")
    assert all(value.device.type == "cpu" for value in seen.values(True, True))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    "changes",
    [{}, {"n_step": 3}, pytest.param({"collection": "overlap"}, marks=pytest.mark.slow)],
    ids=["turn", "n_step", "overlap"],
)
def test_a_run_is_trained_evaluated_and_resumed(check_run, elsewhere, device, changes):
    check_run(elsewhere(device), True, num_envs=2, steps_per_collection=10, **changes)
