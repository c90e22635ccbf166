"""Imports run one way, heavy packages stay in few named places, and everything public says what it is."""

import ast
import re
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest

import hjprofile

HOME = Path(hjprofile.__file__).parent
WINGS = ("grids", "fronts", "characteristics", "inverse", "layer", "vertical_steps")
# from the bottom up
ROOMS = (
    "errors", "error_page", "interrupts", "files", "problem", "solvers.kernels", "solvers.stop", "solvers.norms",
    "solvers.states", "solvers.run_repr", "solvers.run_tables", "solvers.run",
    "solvers", "studies", "output", "cli",
)  # fmt: skip
KERNELS = ("solvers.kernels", *(f"solvers.{wing}.kernels" for wing in WINGS))
ONLY_IN = {  # package -> the modules and rooms that may import it
    "numba": (*KERNELS, "solvers.compilation"),
    "vtkmodules": ("output.vtk",),
    "matplotlib": ("output.plots",),
    "PIL": ("output.plots",),
    "tomllib": ("problem.case_files", "output.store", "cli"),
    "tomli_w": ("problem.case", "output.store", "cli"),
    "cyclopts": ("cli",),
    "rich": ("cli",),
}
LONGEST = 450  # lines that can be read in one sitting
# What must not know of what; in the columns folders or modules. Of the studies, `stability` makes schemes of its own.
EXACT = (
    "solvers.fronts", "solvers.characteristics", "solvers.vertical_steps", "solvers.front_tracking", "solvers.inverse",
)  # fmt: skip
NEVER = {
    "solvers.grids": (*EXACT, "solvers.layer", "solvers.whole_line", "solvers.units_of_the_law", "solvers.snapshots"),
    "solvers.fronts": ("solvers.grids", "solvers.characteristics", "solvers.vertical_steps", "solvers.whole_line"),
    "solvers.characteristics": ("solvers.grids", "solvers.fronts", "solvers.vertical_steps", "solvers.whole_line"),
    "solvers.inverse": (*EXACT[:-1], "solvers.layer", "solvers.grids.scheme", "solvers.whole_line"),
    "solvers.layer": (*EXACT, "solvers.whole_line"),
    "solvers.vertical_steps": ("solvers.characteristics", "solvers.layer", "solvers.whole_line"),
    "solvers.select": ("solvers.grids", "solvers.layer", "solvers.whole_line", "solvers.methods"),
    "studies": tuple(f"solvers.{wing}" for wing in WINGS),
    "output": tuple(f"solvers.{wing}" for wing in WINGS),
    "cli": tuple(f"solvers.{wing}" for wing in WINGS),
}
ALLOWED = {("studies.stability", "solvers.grids")}
# From the command `run` to the compiled sweep and back, as docs/development.md walks
READING_PATH = (
    "cli.run_command", "problem.case", "solvers.solve", "solvers.methods", "solvers.grids.grid_run",
    "solvers.grids.march", "solvers.grids.hamilton_jacobi", "solvers.grids.factor", "solvers.grids.kernels.wavefront",
)  # fmt: skip
SHORT_ENOUGH = 1500  # lines of it, empty ones apart
LONG_FUNCTIONS = {"hj_pass", "hancock_pass"}  # sweeps: one loop over lanes, whose parts must be seen together


def name_of(path):
    """`problem.case` for hjprofile/problem/case.py, `problem` for its __init__, "" for the package's own."""
    parts = path.relative_to(HOME).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(HOME.rglob("*.py")) if path.parent.name != "cases"}


@cache
def tree(module):
    return ast.parse(MODULES[module].read_text(encoding="utf-8"))


@cache  # of a node: each tree is parsed and searched once
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


@cache
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


def forbidden(module, imports):
    """Which of its imports a module must not know of."""
    never = {place for part, places in NEVER.items() if inside(module, [part]) for place in places}
    never -= {place for name, place in ALLOWED if name == module}
    return sorted(name for name in imports if inside(name, never))


@pytest.mark.parametrize("module", ROOMED)
def test_what_must_not_be_known(module):
    assert forbidden(module, own_imports(tree(module))) == []


def test_a_forbidden_import_is_found():
    for part, places in NEVER.items():
        assert any(inside(m, [part]) for m in ROOMED)
        for place in places:
            known = [m for m in ROOMED if inside(m, [place])]
            assert known and forbidden(f"{part}.something", known) == sorted(known)


def test_the_core_can_be_read_without_its_extensions():
    """What the grids need, however indirectly, is problems, grids, and what a run is."""
    todo, core = {m for m in ROOMED if inside(m, ["solvers.grids"])}, set()
    while todo:
        core |= todo
        todo = set().union(*(own_imports(tree(m)) for m in todo)) - {""} - core
    extensions = (*EXACT, "solvers.layer", "solvers.whole_line", "solvers.closed_forms", "solvers.select", "studies")
    assert [m for m in sorted(core) if inside(m, (*extensions, "output", "cli"))] == []


def test_the_walk_from_the_command_to_the_kernel_is_short():
    lines = [line for m in READING_PATH for line in MODULES[m].read_text(encoding="utf-8").splitlines() if line.strip()]
    assert len(lines) <= SHORT_ENOUGH
    for above, below in pairwise(READING_PATH[2:]):  # each is needed by the one before, or by what that needs
        assert any(below in own_imports(tree(m)) for m in READING_PATH[: READING_PATH.index(below)]), (above, below)


# parts of solvers/ that the page leaves out
EVERYBODYS = {"run", "run_repr", "run_tables", "norms", "states", "stop", "kernels"}


def part_of(module):
    """`grids` for solvers.grids.march, `select` for solvers.select; "" for what is none of solvers/."""
    names = module.split(".")
    return names[1] if names[0] == "solvers" and len(names) > 1 else ""


def test_the_page_for_developers_shows_the_imports_of_the_solvers():
    page = (HOME.parent / "docs" / "development.md").read_text(encoding="utf-8")
    shown = {}
    for line in re.findall(r"^(\w+) +->(.*)$", page, flags=re.M):
        shown[line[0]] = {name.strip() for name in line[1].split(",")} - {""}
    found = {part_of(m): set() for m in ROOMED}
    for module in ROOMED:
        found[part_of(module)] |= {part_of(name) for name in own_imports(tree(module))}
    own = set(found) - EVERYBODYS - {""}
    assert shown == {part: found[part] & own - {part} for part in own}


def test_no_two_modules_share_a_name():
    names = Counter(path.name for path in MODULES.values() if path.name != "__init__.py")
    assert [name for name, count in names.items() if count > 1] == []


BRANCHES = (ast.For, ast.While, ast.If, ast.With, ast.Try)


def nested(node, depth=0):
    """How deep loops and conditions are nested in a function; those of functions inside it count by themselves."""
    inner = [n for n in ast.iter_child_nodes(node) if not isinstance(n, ast.FunctionDef | ast.ClassDef | ast.Lambda)]
    return max([depth, *(nested(n, depth + isinstance(n, BRANCHES)) for n in inner)])


@pytest.mark.parametrize("module", MODULES)
def test_functions_can_be_seen_whole(module):
    """At most 60 lines, docstring apart, nested at most 4 deep, with at most 10 arguments where it is no command."""
    for node in ast.walk(tree(module)):
        if not isinstance(node, ast.FunctionDef):
            continue
        doc = node.body[0].end_lineno - node.body[0].lineno + 1 if ast.get_docstring(node) else 0
        assert node.end_lineno - node.lineno + 1 - doc <= 60 or node.name in LONG_FUNCTIONS, node.name
        assert nested(node) <= 4, node.name
        count = len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs)
        assert count <= 10 or inside(module, ["cli"]), node.name


def test_kernels_are_made_of_kernels():
    """What is compiled into one from elsewhere would not be looked at for changes: `kernels/disk_cache.py`."""
    kernels = [m for m in ROOMED if inside(m, KERNELS)]
    taken = set().union(*(own_imports(tree(m)) for m in kernels)) - {""}
    assert {m for m in taken if not inside(m, KERNELS)} == {"files"}
    assert [m for m in kernels if "files" in own_imports(tree(m))] == ["solvers.kernels.disk_cache"]


def test_imports_by_name_are_few():
    """The tests above do not see them: `Run.plot`, and the names of the package."""
    by_name = {m for m in MODULES if {"importlib", "importlib.import_module"} & imported(tree(m))}
    assert by_name == {"", "solvers.run"}


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
        ("output.plots", "import vtkmodules", "output.plots imports vtkmodules"),
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
