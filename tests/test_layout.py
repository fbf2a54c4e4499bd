"""The house's rules: who may import whom, and what an installation puts where."""

import ast
import importlib
import inspect
import re
import sys
from itertools import takewhile
from pathlib import Path
from textwrap import dedent

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {"rrl": "rrl", "envs": "rrl.envs", "trainers": "rrl.trainers", "configs": "rrl.configs"}
FORBIDDEN = {
    "rrl": {"rrl.envs", "rrl.trainers", "rrl.configs", "hydra", "omegaconf", "wandb", "mujoco"},
    "envs": {"rrl.trainers", "rrl.configs", "hydra", "omegaconf", "wandb"},
    "trainers": {"rrl.envs", "mujoco", "dm_control"},
    "configs": {"rrl", "torch"},
}
HYDRA_ONLY_IN = {"compose.py"}
IN_BETWEEN = {
    ROOT / "trainers/training/ways_to_collect.py",  # knows every way, and each uses the interface
    ROOT / "envs/insertion/config.py",  # what model, physics and task are all made by
}
"""Files whose folder is both above and below another one, in no circle themselves."""
WRITTEN = [*FOLDERS, "tests", "benchmarks", "examples", "docs"]
LONGEST_FILE = 300
"""Lines."""
EXTENSION_POINTS = {
    *("_call", "_inv_call", "_post_step_mdp_hooks"),  # of TorchRL's transforms
    *("_reset", "_step", "_set_seed"),  # of its environments and transforms, or entries of both
    *("_check_kwargs", "_make_specs"),  # of its wrappers of other libraries' environments
    "_apply",  # of torch's modules: what ``to`` calls
    "_build",  # of dm_control's entities
}
"""What libraries have others write or call, whose documentation says so."""
UNDERSCORED = {
    *("_asdict", "_replace", "_exit"),  # public in spite of it: of named tuples and of os
    *("_modules", "_buffers"),  # of torch's modules, tables that the documentation names
    "_envs",  # of SerialEnv, which has no other way to its environments
    "_shm_done_flags",  # of ParallelEnv, which leaves them raised when it has loaded a state
    "_torchrl_native_autoreset",  # how TorchRL marks an environment that resets itself
    "_rng",  # of TorchRL's samplers, where a buffer puts its generator
    *("_cursor", "_write_count"),  # of a writer's state: a buffer filled anew goes on at its place
    *("_substep", "_hooks"),  # of composer, whose own substep raises or logs where physics diverges
    *("_model", "_data"),  # of robosuite, which wraps MuJoCo's
    "_freeze_rand_vec",  # of Meta-World, whose resets follow no seed otherwise
    "_check_success",  # of robosuite, which reports no success otherwise
}
"""Other names of others with an underscore that are used, for want of a public way as simple."""
PRIVATE = re.compile(r"_[a-z](\w*[a-z\d])?")
BY_NAME = {"get", "pop", "setdefault", "getattr", "setattr", "hasattr", "delattr", "__setattr__"}


def imports(path: Path) -> set[str]:
    """Absolute names that a file imports, relative ones resolved to nothing."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def sources() -> list[Path]:
    return [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_respect_the_layers(path):
    folder = path.relative_to(ROOT).parts[0]
    for name in imports(path):
        top = name.split(".")[0]
        assert top not in {"envs", "trainers", "configs"}, f"{name}: import it as rrl.{name}"
        for forbidden in FORBIDDEN[folder]:
            assert not (name == forbidden or name.startswith(forbidden + ".")), name
        if top in {"hydra", "omegaconf"}:
            assert path.name in HYDRA_ONLY_IN


def privates(tree: ast.AST) -> tuple[set[str], set[str], set[str]]:
    """Private names that code makes, those that it has of itself, and those of anything else."""
    made, own, others = set(), set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            made.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            made.add(node.id)
        elif isinstance(node, ast.Attribute):
            is_own = ast.unparse(node.value) in ("self", "cls", "super()")
            (own if is_own else others).add(node.attr)
            if is_own and isinstance(node.ctx, ast.Store):
                made.add(node.attr)
        elif isinstance(node, ast.Call) and (called := ast.unparse(node.func).split(".")[-1]):
            named = made if called == "register_buffer" else others if called in BY_NAME else set()
            named |= texts(node.args)
        elif isinstance(node, ast.Subscript):
            others |= texts([node.slice])
        elif isinstance(node, ast.Dict):
            others |= texts(node.keys)
    return tuple(
        {name for name in names if PRIVATE.fullmatch(name)} for names in (made, own, others)
    )


def texts(nodes: list[ast.expr]) -> set[str]:
    return {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}


def of_libraries(cls: type) -> set[str]:
    """Private names that a class of ours uses or takes, and a library's class above it has."""
    above = [c for c in cls.__mro__ if c.__module__ not in ("builtins", "typing", "abc")]
    ours = [c for c in above if c.__module__.split(".")[0] == "rrl"]
    names = [privates(ast.parse(dedent(inspect.getsource(c)))) for c in ours]
    made, own, _ = zip(*names, strict=True)
    theirs = set().union(*(vars(c) for c in above if c not in ours))
    for library in {c.__module__ for c in above if c not in ours}:
        if source := getattr(sys.modules[library], "__file__", None):
            theirs |= set(re.findall(r"self\.(_\w+)", Path(source).read_text()))
    return own[0] - set().union(*made) | (own[0] | made[0]) & theirs


def test_private_names_of_libraries_are_left_alone():
    found = set()
    for path in sources():
        tree = ast.parse(path.read_text())
        made, own, others = privates(tree)
        found |= others - made - own
        if classes := [node.name for node in tree.body if isinstance(node, ast.ClassDef)]:
            name = ".".join([FOLDERS[path.relative_to(ROOT).parts[0]], *_below(path)])
            module = importlib.import_module(name)
            found |= set().union(*(of_libraries(getattr(module, name)) for name in classes))
    assert found == EXTENSION_POINTS | UNDERSCORED


def _below(path: Path) -> tuple[str, ...]:
    parts = path.relative_to(ROOT).with_suffix("").parts[1:]
    return parts[:-1] if parts[-1] == "__init__" else parts


def rooms() -> list[set[str]]:
    """The rows of the design's table of rooms, names of files and folders of ``trainers/``."""
    table = (ROOT / "docs/design.md").read_text().partition("| room | its one purpose |")[2]
    rows = takewhile(lambda line: line.startswith("|"), table.splitlines()[2:])
    return [set(re.findall(r"`([\w.]+)/?`", row.split("|")[1])) for row in rows]


def imported(path: Path, for_types: bool = True) -> set[Path]:
    """Files of ours that a file imports, wherever and however; a package is its ``__init__.py``."""
    folder, found, tree = path.parent.relative_to(ROOT).parts, set(), ast.parse(path.read_text())
    for node in [] if for_types else ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {_file(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = node.module.split(".") if node.module else []
            if node.level:
                parts = ["rrl", *folder[: len(folder) + 1 - node.level], *parts]
            found |= {_file([*parts, alias.name]) or _file(parts) for alias in node.names}
    return found - {None, path}


def _file(parts: list[str]) -> Path | None:
    """Return the file behind the parts of an absolute name; None: it is none of ours."""
    if parts[:1] != ["rrl"]:
        return None
    inside = parts[1:] if parts[1:2] and parts[1] in FOLDERS else parts
    place = ROOT.joinpath(*inside)
    return next((p for p in (place / "__init__.py", place.with_suffix(".py")) if p.is_file()), None)


def room(path: Path) -> str:
    """Return the file or folder of ``trainers/`` that a file in there belongs to."""
    return path.relative_to(ROOT / "trainers").parts[0]


def test_rooms_of_the_trainers_import_one_way():
    order = {name: i for i, row in enumerate(rooms()) for name in row}
    for path in sorted((ROOT / "trainers").rglob("*.py")):
        if (name := room(path)) in ("__init__.py", "__main__.py"):
            continue
        assert name in order, f"{name} is missing from the table of rooms in docs/design.md"
        used = {room(p) for p in imported(path) if p.is_relative_to(ROOT / "trainers")}
        above = {other for other in order if order[other] <= order[name]}
        assert used <= above, f"{path} imports {used - above}"


def circles(edges: dict[Path, set[Path]]) -> set[Path]:
    """Return what cannot be put into an order in which everything comes after what it needs."""
    left = dict(edges)
    while free := {a for a, needed in left.items() if not needed & left.keys() - {a}}:
        left = {a: needed for a, needed in left.items() if a not in free}
    return set(left)


def test_nothing_is_imported_in_a_circle():
    """Neither files nor folders; an ``__init__.py`` only shows what lies below it."""
    files = {p: imported(p, for_types=False) for p in sources() if p.name != "__init__.py"}
    assert not circles(files)
    places = {p: p if p.parent == ROOT / "trainers" else p.parent for p in files}
    folders = {place: set() for place in places.values()}
    for path in files.keys() - IN_BETWEEN:
        folders[places[path]] |= {places.get(p, p.parent) for p in files[path] - IN_BETWEEN}
    assert not circles(folders)


@pytest.mark.parametrize("folder", WRITTEN)
def test_no_file_is_long(folder):
    lines = {p: len(p.read_text().splitlines()) for p in (ROOT / folder).rglob("*.py")}
    assert {path: n for path, n in lines.items() if n > LONGEST_FILE} == {}


def raised(function: ast.FunctionDef) -> list[str]:
    """What the body raises by name and lets out; errors that it catches itself are not listed."""
    found, todo = [], list(function.body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            found.append(ast.unparse(node.exc.func))
        elif not isinstance(node, ast.FunctionDef | ast.Lambda | ast.ClassDef):
            todo += node.handlers if isinstance(node, ast.Try) else ast.iter_child_nodes(node)
    return [name for name in found if name != "AssertionError" and not name.startswith("_")]


def test_what_raises_says_so():
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and (doc := ast.get_docstring(node)):
                public = not node.name.startswith("_")
                assert not (public and raised(node)) or "Raises:" in doc, (path, node.name)


def test_words_are_spelled_in_one_way():
    files = [p for folder in WRITTEN for p in (ROOT / folder).rglob("*")]
    other = re.compile("(?i)normali[s]|cent[r]e|behavio[u]r|neighbo[u]r|colo[u]r|optimi[s]")
    for path in (p for p in files if p.suffix in (".py", ".yaml", ".md")):
        assert not other.findall(path.read_text()), path


def test_every_package_is_declared():
    declared = (ROOT / "pyproject.toml").read_text()
    for folder, package in FOLDERS.items():
        for init in sorted((ROOT / folder).rglob("__init__.py")):
            name = ".".join([package, *init.parent.relative_to(ROOT / folder).parts])
            assert f'"{name}"' in declared, f"{name} is missing from [tool.setuptools] packages"


def test_every_yaml_lies_in_the_configs_package():
    assert list((ROOT / "configs").rglob("*.yaml"))
    for folder in ("rrl", "envs", "trainers"):
        assert not list((ROOT / folder).rglob("*.yaml"))
