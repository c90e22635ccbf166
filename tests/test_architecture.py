"""Imports run one way, heavy packages stay in few named places, and everything public says what it is."""

import ast
from functools import lru_cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import hjprofile

HOME = Path(hjprofile.__file__).parent
WINGS = ("grids", "fronts", "characteristics", "layer", "vertical_steps")
# from the bottom up
ROOMS = (
    "errors", "interrupts", "files", "problem", "solvers.kernels", "solvers.stop", "solvers.run", "solvers", "studies",
    "output", "cli",
)  # fmt: skip
KERNELS = ("solvers.kernels", *(f"solvers.{wing}.kernels" for wing in WINGS))
ONLY_IN = {  # package -> the modules and rooms that may import it
    "numba": KERNELS,
    "pyvista": ("output.vtk",),
    "vtkmodules": ("output.vtk",),
    "matplotlib": ("output.plots",),
    "PIL": ("output.plots",),
    "tomllib": ("problem.case_files", "output.store", "cli"),
    "tomli_w": ("problem.case", "output.store", "cli"),
    "cyclopts": ("cli",),
    "rich": ("cli",),
}
LONGEST = 450  # lines that can be read in one sitting


def name_of(path):
    """`problem.case` for hjprofile/problem/case.py, `problem` for its __init__, "" for the package's own."""
    parts = path.relative_to(HOME).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(HOME.rglob("*.py")) if path.parent.name != "cases"}


@lru_cache
def tree(module):
    return ast.parse(MODULES[module].read_text(encoding="utf-8"))


def imported(source):
    """Every module an AST imports, at any depth; of `from a import b` both a and a.b, of which one may be a name."""
    found = set()
    for node in ast.walk(source):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are written out in full"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def inside(name, places):
    return any(name == place or name.startswith(f"{place}.") for place in places)


def own_imports(source):
    """The package's own modules among them, by their short names; "" is the package itself."""
    full = {name for name in imported(source) if inside(name, ["hjprofile"])}
    return {name.removeprefix("hjprofile").lstrip(".") for name in full} & MODULES.keys()


def room(module):
    """The room that a module is in: the longest name that fits."""
    return max((r for r in ROOMS if inside(module, [r])), key=len)


def faults(module, source):
    """What in a module's imports goes against the order of the rooms or the places of packages."""
    for name in own_imports(source) - {""}:
        if ROOMS.index(room(name)) > ROOMS.index(room(module)):
            yield f"{module} imports {name}, which is above it"
        if name == "cli":
            yield f"{module} imports the command line"
    for name in imported(source):
        package = name.split(".")[0]
        if package in ONLY_IN and not inside(module, ONLY_IN[package]):
            yield f"{module} imports {name}"


ROOMED = [m for m in MODULES if m not in ("", "__main__")]


def test_every_room_is_there():
    assert {room(module) for module in ROOMED} == set(ROOMS)
    for places in ONLY_IN.values():  # a place that is gone would let nothing fail
        assert all(place in MODULES for place in places)


@pytest.mark.parametrize("module", ROOMED)
def test_imports_run_one_way(module):
    assert sorted(set(faults(module, tree(module)))) == []


def test_kernels_are_made_of_kernels():
    """What is compiled into one from elsewhere would not be looked at for changes: `kernels/disk_cache.py`."""
    kernels = [m for m in ROOMED if inside(m, KERNELS)]
    taken = set().union(*(own_imports(tree(m)) for m in kernels)) - {""}
    assert {m for m in taken if not inside(m, KERNELS)} == {"files"}
    assert [m for m in kernels if "files" in own_imports(tree(m))] == ["solvers.kernels.disk_cache"]


def test_no_circle_of_modules():
    """Rooms apart, no module may need itself; the package's own __init__ imports nothing before it is asked."""
    TopologicalSorter({m: own_imports(tree(m)) - {"", m} for m in ROOMED}).prepare()


@pytest.mark.parametrize("module", ROOMED)
def test_the_package_is_asked_for_nothing_but_its_version(module):
    """Anything else would import what lies above."""
    source = tree(module)
    aliases = {
        alias.asname or alias.name
        for node in ast.walk(source) if isinstance(node, ast.Import)
        for alias in node.names if alias.name == "hjprofile"
    }  # fmt: skip
    asked = {
        node.attr
        for node in ast.walk(source)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases
    }
    taken = {
        alias.name
        for node in ast.walk(source) if isinstance(node, ast.ImportFrom) and node.module == "hjprofile"
        for alias in node.names
    }  # fmt: skip
    assert asked | taken <= {"__version__", *MODULES}


@pytest.mark.parametrize("module", ["", "__main__"])
def test_the_front_door(module):
    """`import hjprofile` costs nothing: its names are imported when they are asked for. Only __main__ knows the cli."""
    assert imported(tree(module)) & {*ONLY_IN, "numpy", "scipy"} == set()
    assert ("cli" in own_imports(tree(module))) == (module == "__main__")
    for node in tree(module).body:
        if isinstance(node, ast.Import | ast.ImportFrom) and module == "":
            assert own_imports(ast.Module([node], [])) == set()


@pytest.mark.parametrize(
    ("module", "line", "words"),
    [
        ("problem.grid", "from hjprofile.solvers import run", "problem.grid imports solvers"),
        (
            "solvers.run",
            "import hjprofile.solvers.grids.kink_tracker",
            "solvers.run imports solvers.grids.kink_tracker",
        ),
        ("studies.accuracy", "def f():\n    from hjprofile.output.store import load_run", "imports output.store"),
        ("output.store", "from hjprofile.cli import main", "imports the command line"),
        ("cli", "if True:\n    import hjprofile.cli", "imports the command line"),
        ("solvers.grids.march", "from numba import njit", "solvers.grids.march imports numba"),
        ("output.plots", "import pyvista as pv", "output.plots imports pyvista"),
        ("studies.accuracy", "import matplotlib.figure", "imports matplotlib.figure"),
    ],
)
def test_a_wrong_import_is_found(module, line, words):
    assert any(words in fault for fault in faults(module, ast.parse(line)))


def test_a_right_import_is_not():
    lines = "from hjprofile.solvers.run import State\nfrom hjprofile.problem import Problem\nimport hjprofile\n"
    assert list(faults("solvers.grids.kink_tracker", ast.parse(lines))) == []


@pytest.mark.parametrize("module", MODULES)
def test_everything_public_has_a_docstring(module):
    source = tree(module)
    assert ast.get_docstring(source), "the module itself"
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    public = [node for node in source.body if isinstance(node, kinds) and not node.name.startswith("_")]
    assert [node.name for node in public if not ast.get_docstring(node)] == []


@pytest.mark.parametrize("module", MODULES)
def test_no_module_is_too_long(module):
    lines = MODULES[module].read_text(encoding="utf-8").count("\n")
    assert lines <= LONGEST
