"""The global generators: saved on one machine, restored on another."""

import pytest
import torch

from rrl.trainers.generators import Generators


@pytest.mark.parametrize("more", [1, 8])
def test_a_machine_with_fewer_gpus_takes_what_it_has_room_for(more):
    gpus = torch.cuda.get_rng_state_all() if torch.cuda.is_available() else []
    saved = Generators().state_dict()
    saved["torch_cuda"] = gpus + more * [torch.zeros(16, dtype=torch.uint8)]
    wanted = torch.rand(3)
    Generators().load_state_dict(saved)
    assert torch.equal(torch.rand(3), wanted)
