"""Products in bfloat16: which, how near to float32, and where not."""

import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx

from agents import batches, make_agent, parameters
from rrl.algorithms.products import bfloat16_problem, multiply_in_bfloat16

BFLOAT16 = 2**-8
"""The largest relative error of a rounded number."""

OPERATIONS = {
    "mm": lambda a, b: a[0] @ b[0],
    "addmm": lambda a, b: torch.addmm(b[0, 0], a[0], b[0]),
    "bmm": lambda a, b: a @ b,
    "baddbmm": lambda a, b: torch.baddbmm(a[:, :, :1], a, b),
    "a transposed factor": lambda a, b: a @ b.mT.contiguous().mT,
}
CPU = torch.device("cpu")


def replaced(operation, *tensors):
    """The result of an operation whose products were replaced, and the types of its products."""
    graph = make_fx(operation, tracing_mode="fake")(*tensors)
    multiply_in_bfloat16(graph.graph)
    graph.recompile()
    kinds = [n.meta["val"].dtype for n in graph.graph.nodes if "mm" in str(n.target)]
    return graph(*tensors), kinds


@pytest.mark.parametrize("name", OPERATIONS)
def test_a_wide_product_is_of_bfloat16_and_its_result_of_float32(name):
    torch.manual_seed(0)
    a, b = torch.randn(2, 64, 96), torch.randn(2, 96, 64)
    got, kinds = replaced(OPERATIONS[name], a, b)
    exact = OPERATIONS[name](a, b)
    assert kinds == [torch.bfloat16]
    assert got.dtype == torch.float32
    size = a.abs() @ b.abs() + 1  # of all that is added up
    assert not torch.equal(got, exact)
    assert ((got - exact).abs() < 3 * BFLOAT16 * size).all()


@pytest.mark.parametrize("shape", [(64, 63, 64), (1, 64, 64), (64, 64, 3)])
@pytest.mark.parametrize("name", OPERATIONS)
def test_a_narrow_product_stays_as_it_is(name, shape):
    rows, inner, columns = shape
    a, b = torch.randn(2, rows, inner), torch.randn(2, inner, columns)
    got, kinds = replaced(OPERATIONS[name], a, b)
    assert kinds == [torch.float32]
    assert torch.equal(got, OPERATIONS[name](a, b))


def test_a_product_of_double_precision_stays_as_it_is():
    a, b = torch.randn(64, 64).double(), torch.randn(64, 64).double()
    got, kinds = replaced(torch.mm, a, b)
    assert kinds == [torch.float64]
    assert torch.equal(got, a @ b)


def test_bfloat16_without_compiling_is_a_contradiction():
    with pytest.raises(ValueError, match="products: bfloat16 is for compiled updates; set comp"):
        make_agent(products="bfloat16")


@pytest.mark.parametrize(("names", "knows"), [(("avx2",), False), (("amx_bf16",), True)])
def test_a_processor_is_asked_and_a_gpu_is_not(monkeypatch, names, knows):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: dict.fromkeys(names, True))
    assert (bfloat16_problem(CPU) is None) == knows
    assert bfloat16_problem(torch.device("cuda")) is None


def test_a_version_of_torch_that_cannot_say_is_taken_to_lack_it(monkeypatch):
    monkeypatch.delattr(torch.cpu, "get_capabilities", raising=False)
    assert "no instructions for bfloat16" in bfloat16_problem(CPU)


def compiled(products):
    """The tensors of a learner after two compiled updates with wide batches."""
    agent = make_agent(
        hidden=(64, 64), last_layer_bound=0.1, policy_delay=1, compiled=True, products=products
    )
    torch.manual_seed(0)
    agent.update(torch.cat([batches(2, seed) for seed in range(4)], 1))
    return parameters(agent)


@pytest.mark.slow
def test_a_learner_with_products_in_bfloat16_learns_almost_the_same(monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    exact, rounded = compiled("float32"), compiled("bfloat16")
    weights = [name for name, value in exact.items() if value.ndim > 1 and "optimizer" not in name]
    assert any(not torch.equal(exact[name], rounded[name]) for name in weights)
    for name in weights:
        assert rounded[name].dtype == torch.float32
        torch.testing.assert_close(rounded[name], exact[name], rtol=0.05, atol=4e-3)


@pytest.mark.slow
def test_a_processor_without_bfloat16_is_named_and_learns_in_float32(monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    with pytest.warns(UserWarning, match="products: this processor has no instructions") as said:
        rounded = compiled("bfloat16")
    assert len([w for w in said if "products" in str(w.message)]) == 1
    for name, value in compiled("float32").items():
        assert torch.equal(rounded[name], value)
