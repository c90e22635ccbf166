"""The command line with bad input, no place to write, or a run that breaks down: exit code, sentence, no remains."""

import csv
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from bad_cases import BAD, FILES, NOT_TOML, ONE_OF_EACH, VALID, changed, with_files
from errors_page import anchors
from scipy.io import netcdf_file

from hjprofile.cli import main
from hjprofile.output.folder import RECORD
from hjprofile.problem.case_files import shipped_cases


@pytest.fixture
def folder(in_tmp):
    with_files(in_tmp)
    (in_tmp / "scene.toml").write_text(tomli_w.dumps(VALID))
    return in_tmp


def call(capsys, *arguments):
    """Exit code, stdout and stderr, with numpy as a user has it and every warning counted as a line on stderr."""
    with np.errstate(all="warn", under="ignore"), warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("default")
        with pytest.raises(SystemExit) as left:
            main(list(arguments))
    out, err = capsys.readouterr()
    return left.value.code, out, err + "".join(f"{w.category.__name__}: {w.message}\n" for w in warned)


def assert_refused(folder, result, *words, code=2, faults=1):
    """A sentence for each fault on stderr and where there is more of it, nothing else, and nothing in the folder."""
    got, out, err = result
    assert (got, out) == (code, "")
    assert err.endswith("\n") and err.count("\n") == faults
    for line in err.splitlines():
        assert line.startswith("hjprofile: ")
        assert line.rpartition(" (see: hjprofile explain ")[2].removesuffix(")") in anchors()
    assert "Traceback" not in err
    assert [w for w in words if " ".join(w.split()) not in err] == []
    left = {path.name for path in folder.iterdir()} - {"__pycache__"}  # of the user's Python file
    assert left <= {*FILES, "scene.toml", "occupied"}


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_bad_cases(folder, capsys, name):
    """All of them are refused by `parse_case` in tests/problem/test_case.py."""
    changes, section, words = BAD[name]
    (folder / "scene.toml").write_text(tomli_w.dumps(changed(changes)))
    where = f"scene.toml: [{section}] " if section else "scene.toml: "
    assert_refused(folder, call(capsys, "run", "scene.toml"), where, *words)


# names of files of NOT_TOML that are TOML and lack law, kind, cells and end as well -> number of faults
NOTHING_ELSE = {"empty": 4, "hexadecimal": 5, "dotted": 5, "line break in a key": 5}


@pytest.mark.parametrize("name", NOT_TOML)
@pytest.mark.parametrize("command", ["run", "check"])
def test_files_that_are_no_toml(folder, capsys, name, command):
    content, words = NOT_TOML[name]
    (folder / "scene.toml").write_bytes(content)
    faults = NOTHING_ELSE.get(name, 1)
    assert_refused(folder, call(capsys, command, "scene.toml"), "scene.toml", *words, faults=faults)


BAD_SURVEYS = {  # name -> bytes, and the words that the message must hold
    "empty": (b"", ["has no line with two numbers; a survey needs x and height"]),
    "two units in the header": (b"x (km),height (m)\n0,0\n1,1\n", ["the units km and m in its header"]),
    "decimal commas": (
        b"x,height\n0,0,0,5\n1,0,0,7\n",
        ["has the numeric columns '1', '2', '3', '4'", "--columns 1,4"],
    ),
    "units": (b"x,height\n0 m,0 m\n", ["has no line with two numbers"]),
    "top at the left": (b"x,height\n0,9\n1,7\n2,8\n", ["rows 3-4;", "must rise to the left, where its crest is"]),
    "nothing measured": (b"x,height\n0,-9999\n1,-9999\n", ["has 0 points with a height, and 2 without"]),
    "unsorted": (b"x,height\n0,0\n2,1\n1,2\n", ["does not rise in rows 3-4"]),
    "nan": (b"x,height\n0,0\n1,nan\n", ["1 point with a height, and 1 without"]),
    "text": (b"x,height\n0,0\n1,steep\n", ["has 1 row without numbers", "row 3: '1,steep'"]),
    "one point": (b"x,height\n0,0\n", ["has 1 point; a survey needs at least 2"]),
    "not UTF-8": (b"x,height\n0,0\n1,1\xff\n", ["row 3"]),
    "huge": (b"x,height\n0,-1e308\n1,1e308\n2,1.1e308\n", ["has 0 points with a height, and 3 without"]),
    "tiny": (b"x,height\n0,0\n1e-320,1\n", ["has the mean slope inf"]),
}


@pytest.mark.parametrize("name", BAD_SURVEYS)
def test_bad_surveys(folder, capsys, name):
    content, words = BAD_SURVEYS[name]
    (folder / "survey.csv").write_bytes(content)
    content = changed({"profile": {"kind": "survey", "file": "survey.csv", "critical_slope": 0.5, "length": 2.0}})
    (folder / "scene.toml").write_text(tomli_w.dumps(content))
    assert_refused(folder, call(capsys, "run", "scene.toml"), "scene.toml: [profile] file = ", "survey.csv", *words)


def test_a_slope_in_two_units_is_told(folder, capsys):
    """x in feet, heights in metres, on a slope that is otherwise critical; and a critical slope in degrees."""
    profile = {"kind": "survey", "file": "survey.csv", "critical_slope": 0.6, "length": 10.0}
    (folder / "survey.csv").write_text("x,height\n0,0\n32.8,6\n65.6,12\n")
    for critical, of_it in (
        (0.6, "the mean slope 0.183 is 0.305 times the critical slope 0.6; probably x is in feet and height in metres"),
        (11.0, "is 0.0166 times the critical slope 11; critical_slope is height over length, not an angle: for 11"),
    ):
        content = changed({"profile": profile | {"critical_slope": critical}, "domain.left": -7.0})
        (folder / "scene.toml").write_text(tomli_w.dumps(content))
        code, out, err = call(capsys, "run", "scene.toml")
        assert (code, err) == (0, "") and of_it in out
    (folder / "survey.csv").write_text("x,height\n0,0\n10,6\n20,12\n")
    (folder / "scene.toml").write_text(tomli_w.dumps(changed({"profile": profile, "domain.left": -7.0})))
    assert "mean slope" not in call(capsys, "run", "scene.toml")[1]


BAD_USER_FILES = {
    "cannot be imported": "import no_such_module\n",
    "no Python": "def f(q:\n",
    "leaves": "import sys\nsys.exit(0)\n",
    "other name": "def g(q):\n    return q\n",
    "no function": "f = 3\n",
    "fails": "def f(q):\n    raise KeyError(q)\n",
    "no law": "def f(q):\n    return q\n",
}


@pytest.mark.parametrize("name", BAD_USER_FILES)
def test_bad_python_files(folder, capsys, name):
    (folder / "user.py").write_text(BAD_USER_FILES[name])
    content = changed({"erosion": {"law": "python", "file": "user.py", "function": "f"}})
    (folder / "scene.toml").write_text(tomli_w.dumps(content))
    assert_refused(folder, call(capsys, "run", "scene.toml"), "scene.toml: [erosion] ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "two_kinkz"], ["two_kinkz: there is no such file", "did you mean 'two_kinks'?"]),
        (["run", "."], [".: there is no such file (it is a folder)", "its cases are: breaking_bump"]),
        (["run", "scen.toml"], ["scen.toml: there is no such file", "did you mean 'scene.toml'?"]),
        (["run", ""], ["no such file"]),
        (["run", "x" * 5000], ["cannot be read: File name too long"]),
        (["run"], ["run needs at least one CASE"]),
        (["run", "scene.toml", "a/scene.toml"], ["scene.toml and a/scene.toml would be written to", "results/scene;"]),
        (["run", "scene.toml", "scene.toml", "--out", "x"], ["to the same folder x/scene; run them one at a time"]),
        (["run", "scene.toml", "--set", "cells"], ["--set cells must be written --set section.key=value"]),
        (["run", "scene.toml", "--set", "=3"], ["--set =3 must be written --set section.key=value"]),
        (["run", "scene.toml", "--set", "cels=3"], ["'cels' is not a key of a case; did you mean 'domain.cells'?"]),
        (["run", "scene.toml", "--set", "domain.end=3"], ["is not a key of a case; did you mean 'time.end'?"]),
        (["run", "scene.toml", "--set", "solver.metod=godunov"], ["metod is not a known key; did you mean 'method'?"]),
        (["run", "scene.toml", "--set", "solvr.method=godunov"], ["solvr is not a known key; did you mean 'solver'?"]),
        (["run", "scene.toml", "--set", "erosion.m=2"], ["[erosion] m is not a known key"]),
        (["run", "scene.toml", "--set", "domain.cells=many"], ["[domain] cells = 'many' must be a whole number"]),
        (["run", "scene.toml", "--set", "time.end=1\ntitle=2"], ["must have a value as TOML writes it"]),
        (["run", "scene.toml", "--set", "title=a b"], ["--set title=a b must have a value as TOML writes it"]),
        (["run", "scene.toml", "--set", "time.end=1", "--set", "time.end=2"], ["time.end is given twice"]),
        (["run", "scene.toml", "--set", "time.end=1", "--end", "2"], ["time.end is given twice; give one value"]),
        (["run", "survey.csv"], ["survey.csv is a survey", "`hjprofile import survey.csv` makes a case"]),
        (["check", "survey.csv"], ["survey.csv is a survey", "`hjprofile import survey.csv` makes a case"]),
        (["validate"], ["validate needs at least one CASE"]),
        (["validate", "survey.csv"], ["`hjprofile import survey.csv` makes a case from it"]),
        (["validate", "two_kinkz"], ["two_kinkz: there is no such file"]),
        (["new", "scene"], ["scene.toml exists, and a new case replaces no file"]),
        (["new", "."], [". is not a name of a case; write for example"]),
        (["run", "scene.toml", "--cels", "50"], ["--cels"]),
        (["run", "scene.toml", "--cells"], ["--cells"]),
        (["run", "scene.toml", "--cells", "many"], ["--cells", "many"]),
        (["run", "scene.toml", "--cells", "60.7"], ["Invalid value for --cells: '60.7' is not a whole number"]),
        (["run", "scene.toml", "--cells", "9" * 5000], ["Invalid value for --cells: '9999"]),
        (["run", "scene.toml", "--cells", "0"], ["scene.toml: [domain] cells = 0 must be a whole number, 4 or more"]),
        (["run", "scene.toml", "--cells", str(10**15)], ["[domain] cells = 1000000000000000", "cells fit"]),
        (["run", "scene.toml", "--cfl", "0"], ["[solver] cfl = 0.0 must be a positive number"]),
        (["run", "scene.toml", "--cfl", "nan"], ["[solver] cfl = nan must be a positive number"]),
        (["run", "scene.toml", "--cfl=-1"], ["[solver] cfl = -1.0 must be a positive number"]),
        (["run", "scene.toml", "--tolerance", "0"], ["[solver] tolerance = 0.0 must be a positive number"]),
        (["run", "scene.toml", "--tolerance", "1e-20"], ["scene.toml: [solver] tolerance = 1e-20 must lie between"]),
        (["run", "scene.toml", "--method", "auto"], ["scene.toml: [solver] method = 'auto' needs a tolerance"]),
        (
            ["run", "scene.toml", "--method", "godunov", "--tolerance", "1e-3"],
            ["scene.toml: [solver] tolerance applies to the methods characteristics and auto, not to godunov"],
        ),
        (["run", "scene.toml", "--end", "nan"], ["[time] end = nan must be a finite number"]),
        (["run", "scene.toml", "--end=-2"], ["[time] end = -2.0 must be a number, 0 or more"]),
        (["run", "scene.toml", "--method", "godunow"], ["[solver] method = 'godunow'", "did you mean 'godunov'?"]),
        (["run", "scene.toml", "--method", ""], ["[solver] method = '' is not known", "local-lax-friedrichs"]),
        (["runn", "scene.toml"], ["runn"]),
        (["check"], ["check needs at least one CASE"]),
        (["check", "scene.toml", "two_kinkz"], ["two_kinkz: there is no such file"]),
        (["fit", "scene.toml"], ["AFTER"]),
        (["fit", "scene.toml", "survey.csv"], ["--vary"]),
        (["fit", "scene.toml", "nowhere.csv", "--vary", "time.end"], ["nowhere.csv", "does not exist"]),
        (["fit", "scene.toml", "user.py", "--vary", "time.end"], ["has no line with two numbers"]),
        (["fit", "scene.toml", "survey.csv", "--vary", "time.ende"], ["time.ende cannot be varied"]),
        (["plot", "nowhere"], ["nowhere", "profile.nc is missing; run the case again"]),
        (["plot", "scene.toml"], ["scene.toml is not a readable result folder: it is a file; name the folder that"]),
        (["export", "nowhere"], ["export needs a format: --vtk"]),
        (["export", "nowhere", "--vtk"], ["nowhere", "profile.nc is missing"]),
        (["export", "."], ["--vtk"]),
    ],
    ids=lambda value: " ".join(value)[:60],
)
def test_bad_arguments(folder, capsys, arguments, words):
    assert_refused(folder, call(capsys, *arguments), *words)


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("out", ["occupied", "occupied/below", "/proc/hjprofile"])
def test_no_place_to_write(folder, capsys, monkeypatch, command, out):
    """It is found out before anything is solved."""
    monkeypatch.setattr("hjprofile.solvers.solve.solve_and_keep", None)
    monkeypatch.setattr("hjprofile.studies.consistency.check_consistency", None)
    if out.startswith("/proc") and not Path("/proc/self").exists():
        pytest.skip("needs a folder in which not even root may write")
    (folder / "occupied").write_text("mine")
    result = call(capsys, command, "scene.toml", "--out", out)
    assert_refused(folder, result, f"hjprofile: {out}", "no partial file was left", code=1)
    assert (folder / "occupied").read_text() == "mine"


def assert_partial(folder, result, source, at_start):
    """What a run left that broke down: its last good state, complete, and a status that says when, where and why."""
    code, out, err = result
    assert code == 1
    assert err.startswith(f"hjprofile: {source}: stopped at t = ") and err.count("\n") == 1
    status = json.loads((folder / "summary.json").read_text())["status"]
    assert status in err and str(folder) in err
    for words in ("stopped at t = ", " near x = -", " reached -1 in a time step of ", "set cfl to 1 or less"):
        assert words in status
    with netcdf_file(folder / "profile.nc", mmap=False) as file:
        arrays = {name: np.array(variable[:]) for name, variable in file.variables.items()}
    assert set(arrays) == {"time", "x", "x_cell", "u", "q", "K"}
    for values in arrays.values():
        assert values.size and np.all(np.isfinite(values))
    assert np.all(arrays["q"] > -1.0)
    assert (arrays["time"][-1] == 0.0) == at_start
    assert f"stopped at t = {arrays['time'][-1]:.6g} near" in status
    with open(folder / "kinks.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert rows
    for row in rows:
        del row["speed"]  # of a kink seen once it is not known
        assert np.all(np.isfinite([float(value) for value in row.values()]))
    assert [path.name for path in folder.rglob("*") if path.name.startswith(".")] == [RECORD]  # nothing half-written


def test_a_run_that_breaks_down_at_once(in_tmp, capsys):
    result = call(capsys, "run", "two_kinks", "--cfl", "5", "--cells", "400")
    folder = Path("results", "two_kinks")
    assert_partial(folder, result, shipped_cases()["two_kinks"], at_start=True)
    assert (folder / "profile.png").exists() and (folder / "vtk" / "profile.pvd").exists()


def test_a_run_that_breaks_down_on_its_way(folder, capsys):
    content = changed({"profile": {"kind": "steps", "edges": [-4.0, -2.0], "values": [-0.4]}, "time.end": 4.0})
    content |= {"domain": {"left": -6.0, "cells": 150}, "time": {"end": 4.0, "snapshots": 9}}
    content["solver"] = {"method": "godunov", "cfl": 2.5}
    (folder / "scene.toml").write_text(tomli_w.dumps(content))
    result = call(capsys, "run", "scene.toml", "--out", "partial")
    assert_partial(Path("partial"), result, "scene.toml", at_start=False)


@pytest.mark.parametrize(
    ("values", "left", "method", "words"),
    [
        (5.0, -1000.0, "godunov", "the run cannot start: K f' is not a finite number near x = "),
        (-0.999999, -1000.0, "fronts", "front tracking cannot start: ln K changes by "),
    ],
)
def test_a_run_that_cannot_start(folder, capsys, values, left, method, words):
    profile = {"kind": "steps", "edges": [0.9 * left, -2.0], "values": [values]}
    content = changed({"profile": profile, "domain.left": left, "solver.method": method})
    (folder / "scene.toml").write_text(tomli_w.dumps(content))
    code, out, err = call(capsys, "run", "scene.toml")
    assert (code, out) == (1, "") and words in err
    assert err.endswith(" (see: hjprofile explain a-run-that-stops)\n") and err.count("\n") == 1


def process(*arguments, stdout=subprocess.PIPE):
    """`python -m hjprofile ...` with every warning shown and stdout buffered."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"} | {"PYTHONWARNINGS": "default"}
    command = [sys.executable, "-m", "hjprofile", *arguments]
    done = subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=120, env=environment)
    done.stderr = done.stderr.replace("hjprofile: compiling (once)\n", "")  # the first run after an installation
    return done


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["run", "scene.toml", "--cells", "2"], 2),
        (["run", "absent.toml"], 2),
        (["run", "scene.toml", "--out", "occupied"], 1),
        (["run", "scene.toml", "--out", "good"], 0),
    ],
)
def test_a_process_of_its_own(folder, arguments, code):
    (folder / "occupied").write_text("mine")
    done = process(*arguments)
    assert done.returncode == code
    assert done.stderr.count("\n") == (1 if code else 0)
    assert "Traceback" not in done.stderr
    assert (folder / "good" / "summary.json").exists() == (code == 0)
    assert not (folder / "results").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cases"], "hjprofile: No space left on device"),
        (["run", "scene.toml", "--method", "lax-friedrichs", "--cfl", "9"], "scene.toml: stopped at t = "),
    ],
)
def test_stdout_on_a_full_disk(folder, arguments, words):
    with open("/dev/full", "w") as full:
        done = process(*arguments, stdout=full)
    assert done.returncode == 1
    assert words in done.stderr and done.stderr.count("\n") == 1
