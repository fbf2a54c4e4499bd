"""Where nothing can be compiled a learner says so once and learns all the same."""

import pytest
import torch
from torch._inductor import config

from agents import batches, make_agent, parameters
from rrl.compilation import compiler_problem


def test_without_a_compiler_the_update_runs_as_it_is():
    said = pytest.warns(UserWarning, match="no C\\+\\+ compiler .* install g\\+\\+, or set compiled=false")
    with config.patch("cpp.cxx", ("/nowhere/g++",)), said as warnings:
        assert compiler_problem() is not None
        compiled = make_agent(compiled=True)
    assert len(warnings) == 1
    eager = make_agent()
    for agent in (compiled, eager):
        agent.update(batches(4, 1))
    for name, value in parameters(eager).items():
        assert torch.equal(parameters(compiled)[name], value)


def test_with_a_compiler_there_is_no_problem():
    assert compiler_problem() is None
