"""Compiled updates; where nothing can be compiled a learner says so once and learns all the same."""

import os
import pwd
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import torch
from torch._inductor import config

from agents import learn, make_agent, parameters
from rrl.algorithms.compilation import TESTED, CompiledUpdate, being_traced, compiler_problem

TESTS = Path(__file__).parents[2]
BROKEN_COMPILER = """#!/bin/sh
[ "$1" = --version ] && echo "g++ 13.3.0" && exit 0
exit 1
"""
LEARN_WITHOUT_COMPILER = """
import warnings
import torch
from agents import learn, make_agent, parameters

with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    compiled = make_agent(compiled=True, last_layer_bound=0.1)
    for k in (4, 3):  # graphs of several kinds
        learn(compiled, k)
print(*(w.message for w in caught if issubclass(w.category, UserWarning)), sep="\\n")
eager = make_agent(last_layer_bound=0.1)
for k in (4, 3):
    learn(eager, k)
for name, value in parameters(eager).items():
    assert torch.equal(parameters(compiled)[name], value), name
"""


def test_without_a_compiler_the_update_runs_as_it_is():
    said = pytest.warns(
        UserWarning, match="no C\\+\\+ compiler .* install g\\+\\+, or set compiled=false"
    )
    with config.patch("cpp.cxx", ("/nowhere/g++",)), said as warnings:
        assert compiler_problem() is not None
        compiled = make_agent(compiled=True)
    assert len(warnings) == 1
    eager = make_agent()
    for agent in (compiled, eager):
        learn(agent, 4)
    for name, value in parameters(eager).items():
        assert torch.equal(parameters(compiled)[name], value)


HIDDEN = {
    "no module": "sys.modules['torch.fx.experimental.proxy_tensor'] = None",
    "no compiler of C++": "sys.modules['torch._inductor.cpp_builder'] = None",
    "no function": "del torch._inductor.compile",
    "other arguments": "torch._inductor.compile = lambda gm, example_inputs: gm",
}
"""How another version of PyTorch may differ, after all that others import of it."""


@pytest.mark.parametrize("how", HIDDEN)
def test_with_other_compiler_interfaces_the_update_runs_as_it_is(how):
    """In a process of its own, where the interface is hidden before our first import."""
    hide = f"import sys, torch, torchrl.objectives, torch._inductor\n{HIDDEN[how]}\n"
    there = {"PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", hide + LEARN_WITHOUT_COMPILER],
        check=True, env=os.environ | there, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    (said,) = done.stdout.splitlines()
    assert f"PyTorch {torch.__version__} has other compiler interfaces than {TESTED}" in said
    assert "g++" not in said


def test_the_tested_version_is_the_one_that_is_installed_for_tests():
    assert f"torch=={TESTED}." in (TESTS.parent / "constraints.txt").read_text()


def test_a_user_without_a_home_has_a_cache(monkeypatch, tmp_path):
    """As in a container whose user number has no entry in /etc/passwd."""

    def nobody(number):
        raise KeyError(f"getpwuid(): uid not found: {number}")

    for name in ("HOME", "XDG_CACHE_HOME", "TORCHINDUCTOR_CACHE_DIR"):
        monkeypatch.setenv(name, "")  # so that it is put back as it was
        monkeypatch.delenv(name)
    monkeypatch.setattr(pwd, "getpwuid", nobody)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    make_agent(compiled=True)
    assert compiler_problem() is None
    assert Path(os.environ["TORCHINDUCTOR_CACHE_DIR"]).is_relative_to(tmp_path)


@pytest.mark.slow
def test_with_a_broken_compiler_the_update_runs_as_it_is_and_the_cache_is_named_once(tmp_path):
    """In a process of its own, because PyTorch remembers what a compiler can do."""
    compiler, cache = tmp_path / "broken-g++", tmp_path / "cache"
    compiler.write_text(BROKEN_COMPILER)
    compiler.chmod(0o755)
    there = {
        "CXX": str(compiler),
        "TORCHINDUCTOR_CACHE_DIR": str(cache),
        "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)]),
    }
    command = [sys.executable, "-c", LEARN_WITHOUT_COMPILER]
    done = subprocess.run(
        command, check=True, env=os.environ | there, stdout=subprocess.PIPE, text=True
    )
    (said,) = done.stdout.splitlines()
    assert "the update is not compiled" in said
    assert said.endswith(f"if the compiler's cache is damaged, remove {cache}")


@pytest.mark.slow
def test_torn_entries_of_the_cache_are_said_in_one_line(tmp_path):
    script = "import logging; logging.basicConfig()\n" + LEARN_WITHOUT_COMPILER.split("eager")[0]
    there = {
        "TORCHINDUCTOR_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)]),
    }

    def say():
        command = [sys.executable, "-c", script.replace("k in (4, 3)", "k in (4,)")]
        done = subprocess.run(
            command, check=True, env=os.environ | there, capture_output=True, text=True
        )
        return done.stderr.splitlines()

    whole = say()
    for path in (tmp_path / "fxgraph").rglob("*"):
        if path.is_file():
            os.truncate(path, 20)
    torn = [line for line in say() if line not in whole]
    assert torn == [
        "WARNING:rrl.algorithms.compilation:"
        f"the compiler's cache is damaged, compiled anew; remove {tmp_path}"
    ]


def test_with_a_compiler_there_is_no_problem():
    assert compiler_problem() is None


@pytest.mark.parametrize("there", [pytest.param(True, marks=pytest.mark.slow), False])
def test_the_compiler_can_be_imported_ahead(there):
    """In a process of its own: importing us does not import it, importing it ahead does, if it is there; no warning."""
    script = f"""
import sys, warnings
import rrl.algorithms.compilation
from torch._inductor import config
assert "torch._inductor.compile_fx" not in sys.modules
warnings.simplefilter("error")
with config.patch("cpp.cxx", config.cpp.cxx if {there} else ("/nowhere/g++",)):
    rrl.algorithms.compilation.import_compiler()
assert ("torch._inductor.compile_fx" in sys.modules) == {there}
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", script], check=True)


def test_what_the_processor_can_do_is_found_out_from_when_a_learner_to_be_compiled_is_made():
    """In a process of its own, because PyTorch remembers it; what it finds is what PyTorch would."""
    script = f"""
import sys, threading, warnings
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from agents import make_agent
warnings.simplefilter("error")
name = "rrl-vector-instructions"
make_agent()
assert name not in [thread.name for thread in threading.enumerate()]
make_agent(compiled=True)
(thread,) = [thread for thread in threading.enumerate() if thread.name == name]
thread.join()
from torch._inductor.cpu_vec_isa import valid_vec_isa_list
assert valid_vec_isa_list.cache_info().currsize == 1
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", script], check=True)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
def test_a_compiled_update_changes_the_tensors_that_its_update_holds_on_to(caplog):
    module, traced = torch.nn.Module(), []
    module.weight = torch.nn.Parameter(torch.ones(3))
    module.register_buffer("total", torch.zeros(3))
    module.register_buffer("count", torch.zeros(()))

    def update(x):
        traced.append(being_traced())
        (slope,) = torch.autograd.grad((module.weight * x).sum(), [module.weight])
        with torch.no_grad():
            module.weight.data.sub_(slope)  # another tensor with the parameter's memory
            module.total.add_(module.weight)
            module.count.add_(1)
        return {"slope": slope, "sum": module.total.sum()}

    compiled = CompiledUpdate(update, module)
    assert compiled.compile_seconds == 0
    with caplog.at_level("INFO", "rrl.algorithms.compilation"):
        first = compiled(torch.full((3,), 2.0))
    assert "compiling the update" in caplog.text
    assert compiled.compile_seconds > 0
    assert (first["slope"] == 2).all()
    assert (module.weight == -1).all()
    assert (module.total == -1).all()
    with torch.no_grad():
        module.weight.fill_(5.0)  # as a checkpoint does
    second = compiled(torch.ones(3))
    assert (module.weight == 4).all()
    assert second["sum"] == 9
    assert module.count == 2
    assert traced == [False, True]  # Python ran once as it is and once to be recorded
