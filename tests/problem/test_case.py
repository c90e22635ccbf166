"""Case files: every key is known and checked, every refusal says where, and a resolved case is the case again."""

import math
import os
import subprocess
import sys
import tomllib
import warnings

import numpy as np
import pytest
import tomli_w
from bad_cases import BAD, COEFFICIENTS, LAWS, NOT_TOML, PROFILES, REMOVED, VALID, changed, with_files
from errors_page import anchors
from same_problem import same

from hjprofile.errors import InputError
from hjprofile.problem.case import load_case, parse_case, resolved_case
from hjprofile.problem.case_files import find_case, shipped_cases


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return with_files(tmp_path_factory.mktemp("case"))


def write(folder, content, name="scene.toml"):
    path = folder / name
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    return path


def refusal(path, overrides=None):
    with pytest.raises(InputError) as refused:
        load_case(path, overrides)
    return str(refused.value)


def test_a_valid_case_is_what_it_says(folder):
    case = load_case(write(folder, VALID))
    assert (case.name, case.source) == ("scene", str(folder / "scene.toml"))
    assert (case.problem.title, case.problem.law.name) == ("Two kinks", "rational")
    assert (case.grid.left, case.grid.cells) == (-6.0, 60)
    assert (case.problem.end, case.problem.times.tolist()) == (1.0, [0.0, 0.5, 1.0])
    assert (case.method, case.cfl, case.vtk, case.plots) == ("godunov", 0.9, False, False)


def test_defaults(folder):
    content = changed({"title": REMOVED, "time.snapshots": REMOVED, "solver": REMOVED, "output": REMOVED})
    case = load_case(write(folder, content, "short.toml"))
    assert case.problem.title == "short"
    assert case.problem.times.size == 31
    assert (case.method, case.cfl, case.vtk, case.plots) == ("local-lax-friedrichs", 0.9, True, True)


def test_integers_are_numbers(folder):
    one = load_case(write(folder, changed({"domain.left": -6, "time.end": 1, "solver.cfl": 1})))
    assert (one.grid.left, one.problem.end, one.cfl) == (-6.0, 1.0, 1.0)
    assert isinstance(one.grid.left, float)


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_refused_by_name(folder, name):
    """One sentence and a heading of the documentation, without a warning, with numpy as a user has it."""
    changes, section, words = BAD[name]
    there = set(folder.iterdir())
    with np.errstate(all="warn", under="ignore"), warnings.catch_warnings(), pytest.raises(InputError) as refused:
        warnings.simplefilter("error")
        parse_case(changed(changes), "scene", "scene.toml", folder)
    message = str(refused.value)
    assert message.startswith(f"scene.toml: {f'[{section}] ' if section else ''}")
    assert [w for w in words if w not in message] == []
    assert "\n" not in message
    assert refused.value.about in anchors()
    assert set(folder.iterdir()) - there <= {folder / "__pycache__"}  # of the user's Python file


@pytest.mark.parametrize("name", NOT_TOML)
def test_files_that_are_no_toml(folder, name):
    content, words = NOT_TOML[name]
    path = folder / "broken.toml"
    path.write_bytes(content)
    message = refusal(path)
    assert [w for w in (str(path), *words) if w not in message] == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("two_kinkz", ["two_kinkz: there is no such file", "did you mean 'two_kinks'?", "its cases are: "]),
        ("nowhere/two_kinkz.toml", ["did you mean 'two_kinks'?"]),
        (".", ["no such file"]),
        ("", ["no such file"]),
        ("nul\0", ["no such file"]),
        ("x" * 5000, ["xxx: cannot be read: File name too long"]),
    ],
)
def test_cases_that_do_not_exist(name, words, in_tmp):
    message = refusal(name)
    assert [w for w in words if w not in message] == []


def test_a_shipped_case_gives_way_to_a_file(in_tmp):
    assert find_case("two_kinks") == shipped_cases()["two_kinks"]
    (in_tmp / "two_kinks").write_text(tomli_w.dumps(VALID))
    assert load_case("two_kinks").grid.cells == 60


@pytest.mark.parametrize("name", shipped_cases())
def test_shipped_cases_load(name):
    case = load_case(name)
    assert case.problem.title and case.name == name


def test_overrides_replace_and_are_checked(folder):
    path = write(folder, VALID)
    case = load_case(path, {"domain.cells": 80, "solver.method": "telescoping", "time.end": 2.0})
    assert (case.grid.cells, case.method, case.problem.end, case.cfl) == (80, "telescoping", 2.0, 0.9)
    assert load_case(write(folder, changed({"solver": REMOVED})), {"solver.cfl": 0.5}).cfl == 0.5
    path = write(folder, VALID)
    assert refusal(path, {"domain.cells": 2}) == f"{path}: [domain] cells = 2 must be a whole number, 4 or more"
    assert "cfl = nan must be a positive number" in refusal(path, {"solver.cfl": math.nan})
    assert "[domain] cels is not a known key; did you mean 'cells'?" in refusal(path, {"domain.cels": 50})
    assert "domian is not a known key; did you mean 'domain'?" in refusal(path, {"domian.cells": 50})
    assert "solver = 3 must be a table" in refusal(write(folder, changed({"solver": 3})), {"solver.cfl": 0.5})


def test_a_grid_that_fits_no_memory_is_refused_before_anything_is_allocated(folder, monkeypatch):
    pages = {"SC_PAGE_SIZE": 1024, "SC_PHYS_PAGES": 1024}  # 1 MiB
    monkeypatch.setattr(os, "sysconf", pages.__getitem__)
    message = refusal(write(folder, changed({"domain.cells": 10_000})))
    most = 2**20 // 384  # u, q, K of 3 snapshots twice, and 30 arrays: 48 numbers of 8 bytes a cell
    for words in (
        "cells = 10000 with 3 snapshots needs 0.00358 GiB",
        "this machine has 0.000977",
        f"at most {most} cells",
    ):
        assert words in message
    load_case(write(folder, changed({"domain.cells": most})))
    assert "at most 2730 cells" in refusal(write(folder, changed({"domain.cells": most + 1})))
    assert "use fewer snapshots" in refusal(write(folder, changed({"time.snapshots": 10_000})))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", PROFILES)
def test_a_resolved_case_is_the_case_again(folder, law, kind):
    changes = {"erosion": {"law": law} | LAWS[law], "profile": {"kind": kind} | PROFILES[kind]}
    case = load_case(write(folder, changed(changes)))
    text = tomli_w.dumps(resolved_case(case.problem, case.grid, case.method, case.cfl))
    again = parse_case(tomllib.loads(text), case.name, "resolved", folder)
    assert (again.grid, again.method, again.cfl) == (case.grid, case.method, case.cfl)
    same(again.problem, case.problem, case.grid)
    for section in ("erosion", "profile"):
        assert tomllib.loads(text)[section] == changes[section]


@pytest.mark.parametrize(
    "changes",
    [
        {"time.snapshots": [0.0, 0.1, 1.0]},
        {"time": {"end": 0.0}},
        {"time.end": 0.1 + 0.2, "domain.left": -20 / 3, "solver.cfl": 2 / 3},
        {"title": 'quote " and \\ and\nnewline → ü'},
        {"profile": {"kind": "steady", "flux": 0.1 + 0.2}},
        {"solver.refresh": 0.1 + 0.2},
        *({"coefficient": {"kind": kind} | table} for kind, table in COEFFICIENTS.items()),
        {
            "profile": {
                "kind": "survey",
                "file": "survey.csv",
                "critical_slope": 0.1,
                "length": 2.0,
                "repair": "isotonic",
            }
        },
    ],
)
def test_resolved_values_are_exact(folder, changes):
    case = load_case(write(folder, changed(changes)))
    text = tomli_w.dumps(resolved_case(case.problem, case.grid, case.method, case.cfl, None, case.refresh))
    again = parse_case(tomllib.loads(text), case.name, "resolved", folder)
    assert (again.grid, again.cfl, again.refresh) == (case.grid, case.cfl, case.refresh)
    same(again.problem, case.problem, case.grid)


def test_messages_need_no_docstrings(folder):
    """`python -OO` takes them away: the sentences read "must be None"."""
    path = write(folder, changed({"time.end": "soon", "domain.cells": REMOVED}), "oo.toml")
    script = (
        "import sys; from hjprofile.problem.case import load_case\n"
        "for changes in ({}, {'domain.cells': 40}):\n"
        "    try: load_case(sys.argv[1], changes)\n"
        "    except ValueError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-OO", "-c", script, path], capture_output=True, text=True, check=True)
    assert "cells is missing; it must be a whole number" in done.stdout
    assert "end = 'soon' must be a finite number" in done.stdout
