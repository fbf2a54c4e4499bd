"""What the machine lacks is said, and the run goes on."""

import pytest
import torch

from rrl.trainers.process import configure_process


@pytest.fixture(autouse=True)
def _restore():
    before = torch.get_float32_matmul_precision()
    yield
    torch.set_float32_matmul_precision(before)


def test_bfloat16_products_without_amx_are_named(monkeypatch, settings):
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    with pytest.warns(UserWarning, match="trainer.matmul_precision=medium: this processor has no AMX"):
        configure_process(settings(matmul_precision="medium"))
    assert torch.get_float32_matmul_precision() == "highest"


def test_nothing_is_said_where_nothing_is_lacking(monkeypatch, settings, recwarn):
    configure_process(settings())
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: True)
    configure_process(settings(matmul_precision="medium"))
    assert torch.get_float32_matmul_precision() == "medium"
    assert not recwarn.list
