"""Several cases in one command, values by options, cases that are checked or made, and progress."""

import json
import re
import sys
import tomllib
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest
import tomli_w
from rich.console import Console

import hjprofile as hj
from hjprofile.cli import common
from hjprofile.cli.common import Progress
from hjprofile.errors import InputError
from hjprofile.problem.new_case import TEMPLATE
from hjprofile.solvers.method import Feature, requirements
from hjprofile.solvers.methods import METHODS

SCENE = {
    "title": "Scene",
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -4.0, "cells": 40},
    "time": {"end": 0.2, "snapshots": 3},
    "output": {"vtk": False, "plots": False},
}


def write_case(name, **changes):
    path = Path(f"{name}.toml")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(tomli_w.dumps(SCENE | changes), encoding="utf-8")
    return path


@pytest.fixture
def cases(in_tmp):
    """Two good cases, one that breaks down, one that is bad, and one that is absent."""
    write_case("a", title="A")
    write_case("b", title="B", erosion={"law": "log"})
    dip = {"kind": "steps", "edges": [-3.5, -2.0], "values": [-0.4]}
    unstable = {"method": "godunov", "cfl": 2.5}
    write_case("stops", title="Stops", profile=dip, time={"end": 4.0, "snapshots": 9}, solver=unstable)
    write_case("bad", domain={"left": -4.0, "cells": "40"}, tiem={"end": 1.0})
    return ["a.toml", "stops.toml", "bad.toml", "absent.toml", "b.toml"]


def test_each_case_has_its_folder_and_failures_stop_nothing(cases, call):
    code, out, err = call("run", *cases)
    assert code == 2
    accounts = out.split("\n\n")
    assert [account.strip().splitlines()[0] for account in accounts if account.strip()] == ["A", "Stops", "B"]
    found = [line for line in err.splitlines() if line.startswith("hjprofile: ")]
    assert [re.match(r"hjprofile: (\w+)", line)[1] for line in found] == ["stops", "bad", "bad", "absent"]
    assert all(" (see: hjprofile explain " in line for line in found) and len(found) == err.count("\n")
    assert {path.name for path in Path("results").iterdir()} == {"a", "b", "stops"}
    alone = hj.solve_case(hj.load_case("b.toml"))
    assert (hj.load_run("results/b").u == alone.u).all() and hj.load_run("results/b").done
    assert not hj.load_run("results/stops").done


@pytest.mark.parametrize(
    ("some", "worst"), [([0, 4], 0), ([0, 1, 4], 1), ([1, 2], 2), ([2, 1], 2), ([4, 3], 2), ([3, 4], 2)]
)
def test_the_exit_code_is_the_largest(cases, call, some, worst):
    assert call("run", *(cases[i] for i in some), "-q")[:2] == (worst, "")


def test_several_cases_into_a_folder_that_is_named(cases, call):
    code, _, err = call("run", "a.toml", "b.toml", "-o", "there")
    assert (code, err) == (0, "") and {path.name for path in Path("there").iterdir()} == {"a", "b"}
    assert (hj.load_run("there/a").case["erosion"]["law"], Path("results").exists()) == ("rational", False)
    assert call("run", "a.toml", "-o", "single")[0] == 0 and Path("single/profile.nc").exists()


def test_default_folders_of_other_cases_are_refused_one_by_one(cases, call):
    write_case("other/a", time={"end": 0.1, "snapshots": 2})
    assert call("run", "other/a.toml")[0] == 0
    code, out, err = call("run", "a.toml", "b.toml")
    assert code == 2 and err.count("\n") == 1 and "results/a belongs to " in err
    assert out.strip().startswith("B\n") and hj.load_run("results/a").time[-1] == 0.1


def test_documents_of_several_cases(cases, call):
    code, out, _ = call("run", *cases, "--json")
    document = json.loads(out)
    assert (code, list(document)) == (2, ["cases"])
    assert [entry["case"] for entry in document["cases"]] == cases
    assert [entry.get("status", "")[:4] for entry in document["cases"]] == ["done", "stop", "", "", "done"]
    assert [("error" in entry, "files" in entry) for entry in document["cases"]] == [
        (False, True), (False, True), (True, False), (True, False), (False, True)
    ]  # fmt: skip


def test_an_interruption_stops_all(cases, call, monkeypatch):
    def interrupted(*_):
        raise hj.RunError("interrupted at t = 1", "interrupted")

    monkeypatch.setattr("hjprofile.solvers.solve.solve_and_keep", interrupted)
    code, out, err = call("run", "a.toml", "b.toml")
    assert (code, out, err.count("\n")) == (1, "", 1) and "interrupted at t = 1" in err


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), MemoryError()])
def test_other_failures_stop_only_their_case(cases, call, monkeypatch, error):
    from hjprofile.solvers import solve

    honest = solve.solve_and_keep

    def failing(case, *more):
        if case.name == "a":
            raise error
        return honest(case, *more)

    monkeypatch.setattr(solve, "solve_and_keep", failing)
    code, out, err = call("run", "a.toml", "b.toml")
    assert (code, err.count("\n")) == (1, 1) and out.strip().startswith("B\n")


def test_values_by_options(cases, call):
    code, out, err = call(
        "run", "a.toml", "--set", "domain.cells=50", "--set", "profile.positions=[-3.5, -2.5]",
        "--set", "solver.method=godunov", "--set", "time.snapshots=[0.0, 0.05]", "--set", "title='Not A'",
        "--cfl", "0.5",
    )  # fmt: skip
    assert (code, err) == (0, "") and out.startswith("Not A\n")
    run = hj.load_run("results/a")
    assert (run.cells, run.method, run.time.tolist()) == (50, "godunov", [0.0, 0.05])
    assert run.case["profile"]["positions"] == [-3.5, -2.5]
    assert run.case["solver"] == {"method": "godunov", "cfl": 0.5}


def test_values_by_options_are_values_of_toml():
    from hjprofile.problem.case_files import read_values

    texts = [
        "a.x=1",
        "a.y = 0.5",
        "a.z=true",
        "a.s='1'",
        "a.w=log-law",
        "a.f=../data/x.csv",
        "a.h=~/x.csv",
        "a.n=[1, 2]",
    ]
    assert read_values(texts, {"b.c": 3}) == {
        "b.c": 3, "a.x": 1, "a.y": 0.5, "a.z": True, "a.s": "1", "a.w": "log-law", "a.f": "../data/x.csv",
        "a.h": "~/x.csv", "a.n": [1, 2],
    }  # fmt: skip
    for bad in ("a.x", "=1", "a.x=", "a.x=1 2", "a.x=[1", "a.x=1\nb=2", "a.x='"):
        with pytest.raises(InputError):
            read_values([bad], {})


def test_files_that_are_left_out(cases, call):
    write_case("drawn", output={"vtk": True, "plots": True})
    code, _, err = call("run", "drawn.toml", "--no-plots")
    assert (
        (code, err) == (0, "") and Path("results/drawn/vtk").is_dir() and not list(Path("results/drawn").glob("*.png"))
    )
    assert call("run", "drawn.toml", "--no-vtk", "--no-plots")[0] == 0
    assert {path.suffix for path in Path("results/drawn").iterdir()} <= {".nc", ".csv", ".json"}


def test_a_quiet_command_prints_failures_only(cases, call):
    assert call("run", "a.toml", "--quiet") == (0, "", "")
    code, out, err = call("run", "stops.toml", "-q")
    assert (code, out, err.count("\n")) == (1, "", 1) and "stopped at t = " in err
    assert json.loads(call("run", "a.toml", "-q", "--json")[1])["status"] == "done"
    assert call("validate", "a.toml", "-q") == (0, "", "")


def test_validate_reports_all_faults_of_all_files(cases, call, monkeypatch):
    monkeypatch.setattr("hjprofile.solvers.solve.solve_and_keep", None)
    write_case("unfit", solver={"method": "auto"})
    code, out, err = call("validate", *cases, "unfit.toml")
    assert code == 2 and [line.split(":")[0] for line in out.splitlines()] == ["a.toml", "stops.toml", "b.toml"]
    assert out.splitlines()[0] == "a.toml: valid (local-lax-friedrichs, 40 cells, to t = 0.2)"
    assert [re.match(r"hjprofile: (\w+)", line)[1] for line in err.splitlines()] == ["bad", "bad", "absent", "unfit"]
    assert not Path("results").exists()
    code, out, _ = call("validate", "a.toml", "bad.toml", "--json")
    document = json.loads(out)
    assert (code, document["valid"], [entry["valid"] for entry in document["cases"]]) == (2, False, [True, False])
    assert {fault["about"] for fault in document["cases"][1]["faults"]} == {
        "a-value-of-the-wrong-kind", "a-misspelt-key"
    }  # fmt: skip
    assert call("validate", "a.toml", "b.toml", "two_kinks")[0] == 0


def test_a_new_case_runs(in_tmp, call):
    code, out, err = call("new", "my_slope")
    assert (code, err) == (0, "") and out == "written: my_slope.toml\nnext: hjprofile run my_slope.toml\n"
    assert call("run", "my_slope.toml", "--cells", "100")[0] == 0 and hj.load_run("results/my_slope").done
    assert json.loads(call("new", "other.toml", "--json")[1]) == {"case": "other.toml"}
    assert hj.load_case(hj.new_case('a "name" of a \\ slope')).problem.title == 'a "name" of a \\ slope'


def alternatives():
    """The blocks of commented lines that hold keys, each with the section in which it stands."""
    section, block = "", []
    for line in [*TEMPLATE.splitlines(), ""]:
        if line.startswith("["):
            section = line.strip("[]")
        if re.match(r"# \w+ = ", line):
            block.append(line[2:])
        elif block:
            yield section, tomllib.loads("\n".join(block))
            block = []


@pytest.mark.parametrize(("section", "table"), list(alternatives()), ids=str)
def test_the_alternatives_of_a_new_case_are_valid(in_tmp, section, table):
    """Each in the place of the keys of its section, or in addition to them."""
    content = tomllib.loads(TEMPLATE.format(title='"t"'))
    content[section] = table if section in ("erosion", "profile") else content[section] | table
    Path("case.toml").write_text(tomli_w.dumps(content))
    hj.solve_case(hj.load_case("case.toml", {"domain.cells": 60, "time.end": 0.05}))


def test_a_new_case_has_alternatives_for_each_law_and_profile_without_files():
    found = list(alternatives())
    assert [t["law"] for s, t in found if s == "erosion"] == ["log", "power", "expression"]
    assert [t["kind"] for s, t in found if s == "profile"] == ["bumps", "steps", "points"]


SURVEYS = {
    "plain": b"x,height\n0,0\n10,6\n20,13\n",
    "semicolons and decimal commas": "Entfernung;Höhe\n0,0;1,5\n10,0;7,5\n".encode("latin-1"),
    "UTF-16": "x\theight\n0\t1\n10\t4\n".encode("utf-16"),
    "blanks without a header": b"0 1\n1 3\n2 4\n",
    "with rows at fault": b"# by hand\nx,height,remark\n0,0,a\n10,steep,b\n20,13,c\n30,15,d\n",
}


@pytest.mark.parametrize("name", SURVEYS)
def test_a_survey_in_the_place_of_a_case(in_tmp, call, name):
    Path("my survey.csv").write_bytes(SURVEYS[name])
    for command in ("run", "check", "validate"):
        code, out, err = call(command, "my survey.csv")
        assert (code, out, err.count("\n")) == (2, "", 1) and "TOML" not in err and "UTF-8" not in err
        assert "my survey.csv is a survey" in err and "`hjprofile import 'my survey.csv'` makes a case" in err
    with pytest.raises(InputError, match="hjprofile import"):
        hj.load_case("my survey.csv")


def test_a_case_with_a_fault_of_toml_is_no_survey(in_tmp, call):
    Path("case.toml").write_text("[profile]\npositions = [-7.0 -5.0]\namplitudes = [\n 0.4 1.2 3.0\n]\n")
    assert "not valid TOML" in call("run", "case.toml")[2]


def test_methods_are_listed(call):
    """Against the messages of methods that refuse a problem, and against orders measured in other tests."""
    code, out, err = call("methods")
    head, *lines = out.splitlines()
    assert (code, err) == (0, "") and head.split() == ["method", "form", "order", "proved", "CFL", "supports"]
    assert [line.split()[0] for line in lines] == list(METHODS)
    rows = {row["name"]: row for row in json.loads(call("methods", "--json")[1])["methods"]}
    assert [(rows[n]["form"], rows[n]["order"]) for n in ("godunov", "conservative", "weno5", "conservative-eno2")] == [
        ("height", 1.0), ("slope", 2.0), ("height", 5.0), ("slope", 2.0)
    ]  # fmt: skip
    layer = hj.load_case("thin_layer").problem
    for name, row in rows.items():
        found = "layer" in row["supports"]
        assert found == (Feature.LAYER in METHODS[name].supports) == (requirements(layer) <= METHODS[name].supports)
    assert [name for name, row in rows.items() if row["needs_tolerance"]] == ["auto"]


class Notebook(Console):
    """A console as rich makes it in a notebook."""

    def __init__(self, **options):
        super().__init__(force_jupyter=True, **options)


WIDGETS = """
class Output:
    shown = []
    def __enter__(self): return self
    def __exit__(self, *_): pass
    def clear_output(self, wait): self.shown.append("bar")
    def close(self): pass
"""


@pytest.mark.parametrize("installed", [True, False])
def test_a_notebook_has_a_bar(in_tmp, monkeypatch, capsys, recwarn, installed):
    """If it has widgets, which rich needs; else lines, and no warning."""
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    monkeypatch.setattr("rich.console.Console", Notebook)
    shell = {name: ModuleType(name) for name in ("IPython", "IPython.display", "ipywidgets")}
    shell["IPython.display"].display = lambda *_, **__: None
    exec(WIDGETS, vars(shell["ipywidgets"]))
    for name, module in shell.items():  # in the place of those that may be installed
        module.__spec__ = ModuleSpec(name, None)
        monkeypatch.setitem(sys.modules, name, module if installed else None)
    with Progress("solving", solves=False) as progress:
        progress.started -= 100.0
        progress.last_line -= 100.0
        progress(0.5)
        assert (progress.bar is not None) == installed
    assert not recwarn.list
    if installed:
        assert sys.modules["ipywidgets"].Output.shown
    assert ("solving: 50% after 100 s" in capsys.readouterr().err) != installed


@pytest.mark.parametrize("quiet", [False, True])
def test_lines_of_progress_without_terminal(monkeypatch, capsys, quiet):
    monkeypatch.setattr(common.time, "monotonic", lambda: clock[0])
    clock = [0.0]
    with Progress("solving", not quiet, solves=False) as progress:
        for clock[0] in range(0, 200, 10):
            progress(clock[0] / 200)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ([] if quiet else [f"hjprofile: solving: {p} % after {s} s".replace(" %", "%") for p, s in (
        (30, 60), (60, 120), (90, 180)
    )])  # fmt: skip


@pytest.mark.parametrize(("terminal", "seconds", "said"), [(False, 0.1, 0), (False, 3.0, 1), (True, 0.1, 1)])
def test_compilation_is_announced(monkeypatch, capsys, terminal, seconds, said):
    """By one line if it takes long; on a terminal by the bar, which then goes on with the progress."""
    from numba.core import event

    clock = [0.0]
    monkeypatch.setattr(common, "LONG_COMPILATION", 1.0)
    monkeypatch.setattr(common.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with Progress("solving") as progress:
        for _ in range(3):
            with event.trigger_event("numba:compile"), event.trigger_event("numba:compile"):  # a loop that calls one
                clock[0] += seconds
        assert (progress.bar is not None) == terminal
        if terminal:
            assert progress.bar.tasks[0].description == "compiling (once)"
            clock[0] = 5.0
            progress(0.5)
            assert (progress.bar.tasks[0].description, progress.bar.tasks[0].percentage) == ("solving", 50.0)
    err = capsys.readouterr().err
    assert ("compiling (once)" in err) == bool(said)
    if not terminal:
        assert err == "hjprofile: compiling (once)\n" * said
    with event.trigger_event("numba:compile"):  # after the command nobody listens
        clock[0] += 10.0
    assert capsys.readouterr().err == ""


def test_a_compiled_loop_is_noticed_once():
    """A new loop at its first call; not at its second."""
    import numba

    from hjprofile.solvers.compilation import noticed

    inner = numba.njit(lambda x: x + 1.0)
    loop = numba.njit(lambda x: inner(x) * 2.0)
    heard = []
    with noticed(heard.append):
        assert loop(1.0) == 4.0 and loop(2.0) == 6.0
    assert heard == [True, False]
