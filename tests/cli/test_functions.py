"""Every command has its function in Python, and both return the same."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import hjprofile as hj
from hjprofile.cli.common import app
from hjprofile.output.plots import statement_pictures, study_pictures
from hjprofile.solvers.closed_forms import closed_form
from hjprofile.studies import (
    characteristic_statements,
    chart,
    consistency,
    dependence,
    stability,
    statement_runs,
)


@pytest.fixture
def small(monkeypatch):
    """Studies of a fraction of a second."""
    for name, values in (
        ("CELLS", 60), ("STEPS", 100), ("CFL", (0.5, 1.0, 2.0)), ("VISCOSITY", (0.5, 1.0)), ("VISCOSITY_AT", (0.45,)),
        ("SMALLEST", (0.1,)), ("EXPONENTS", (1.0,)), ("REFRESH", (1,)), ("BISECTIONS", 1), ("CUTS", (0.1,)),
    ):  # fmt: skip
        monkeypatch.setattr(stability, name, values)
    for name, value in (("PAIRS", 1), ("CELLS", 80), ("WAVES", 1), ("REFRESHES", (16, 8))):
        monkeypatch.setattr(dependence, name, value)
    monkeypatch.setattr(characteristic_statements, "TIMES", 21)
    monkeypatch.setattr(statement_runs, "MOMENTS", 21)


@pytest.fixture
def undrawn(monkeypatch):
    """Pictures of studies are empty files, which take no time."""
    for where, names in (
        (statement_pictures, ("statements_picture", "invariant_picture")),
        (study_pictures, ("chart_picture", "stability_picture", "dependence_picture")),
    ):
        for name in names:
            monkeypatch.setattr(where, name, lambda *_: b"")


def test_stability(small, undrawn, in_tmp, call):
    code, out, _ = call("stability", "travelling_kink", "--out", "there")
    found = hj.stability("travelling_kink")
    assert code == 0 and out.startswith(f"{found}\n")
    rows = list(csv.reader(Path("there/stability.csv").read_text().splitlines()))[1:]
    assert [row[1:3] + row[4:5] for row in rows] == [[t.method, t.parameter, t.outcome] for t in found.rows]
    low, high, proved = found.limits["godunov"]
    assert low < high and proved == 1.0


def test_dependence(small, undrawn, in_tmp, call):
    case = hj.load_case("two_kinks")
    found = hj.dependence(case.problem, case.grid, name=case.name)
    code, out, _ = call("dependence", "two_kinks", "--out", "there")
    assert code == 0 and found.holds and all(line in out for line in str(found).splitlines())
    rows = list(csv.reader(Path("there/dependence.csv").read_text().splitlines()))[1:]
    assert [[row[1], float(row[5])] for row in rows] == [[d.study, d.distance] for d in found.rows]
    (titles,) = {d.case for d in hj.dependence(case.problem, case.grid).rows}
    assert titles == case.problem.title


def test_exact_is_none_where_no_closed_form_is_known():
    law, kink = hj.rational(), hj.kinks([-2.0], [0.8])
    form = hj.exact(hj.Problem(law, kink, end=1.0))
    exact = hj.track_fronts(hj.Problem(law, kink, end=1.0), hj.Grid(-3.0, 60), fronts=1600)
    assert np.abs(form.u(1.0, exact.x) - exact.u[-1]).max() < 1e-5  # the error of these fronts is 1e-6
    layer, given = (
        hj.Problem(law, kink, 1.0, supply_flux=0.1),
        hj.Problem(law, kink, 1.0, coefficient=hj.coefficient("1 - x")),
    )
    assert closed_form(layer) is not None  # that of slow erosion, which it does not follow
    assert hj.exact(layer) is None and hj.exact(given) is None
    assert hj.exact(hj.Problem(law, hj.steady(0.4), 1.0)).kink(0.5) != 0.0
    with pytest.raises(hj.InputError, match="must be of the type Problem"):
        hj.exact(kink)


def test_explain(call):
    text = hj.explain("A folder of another case")
    assert call("explain", "a-folder-of-another-case")[1] == f"A folder of another case\n\n{text}\n"
    for wrong in ("nonsense", 3):
        with pytest.raises(hj.InputError, match="heading"):
            hj.explain(wrong)


def test_a_study_from_python_has_the_files_of_its_command(small, undrawn, in_tmp, call, monkeypatch):
    """Same names, and the same tables where they hold no run times."""
    case = hj.load_case("two_kinks", {"domain.cells": 200, "time.end": 0.5, "time.snapshots": 5})
    Path("case.toml").write_text(tomli_w.dumps(hj.solve_case(case).case))
    case = hj.load_case("case.toml")
    grid, checked = case.grid, hj.check(case)
    monkeypatch.setattr(consistency, "check_consistency", lambda *_: checked.comparisons)  # which is of seconds
    for command, study in (
        ("check", checked),
        ("dependence", hj.dependence(case.problem, grid, name=case.name)),
        ("statements", hj.statements(case.problem, grid, name=case.name)),
    ):
        assert call(command, "case.toml", "--out", f"by command/{command}")[0] == 0
        files = hj.write_study(study, f"by function/{command}")
        assert files == sorted(files, key=files.index) and files
        for file in files:
            other = Path("by command") / command / file.name
            assert file.suffix == ".png" or file.read_bytes() == other.read_bytes()
        assert {f.name for f in files} == {f.name for f in other.parent.iterdir()} - {".hjprofile.json"}


def test_studies_that_are_written_into_a_folder_of_something_else(in_tmp):
    """Nothing that belongs to another case is removed."""
    problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1, snapshots=3)
    run = hj.solve_hj(problem, hj.Grid(-4.0, 40))
    hj.write_run(run, "folder", vtk=False, plots=False)
    before = {p.name for p in Path("folder").iterdir()}
    found = chart.Chart("a", (), chart.Reference("r", 0.0, 0.0, *np.zeros((2, 1, 1))))
    with pytest.raises(hj.InputError, match=r"folder belongs to another result that was written from Python"):
        hj.write_study(found, "folder")
    assert {p.name for p in Path("folder").iterdir()} == before
    for wrong in (run, 3, [found, run], []):
        with pytest.raises(hj.InputError, match=r"study = .* must be a result of check, chart"):
            hj.write_study(wrong, "folder")


def test_import(in_tmp, call):
    """The function and the command write the same two files."""
    Path("gps.txt").write_text("dist;elev\n0;10,0\n5;12,5\n10;16,0\n20;20,0\n")
    code, out, _ = call("import", "gps.txt", "--length", "4", "--out", "a.toml", "--to", "10")
    made = hj.import_survey("gps.txt", "b.toml", length=4.0, to=10.0)
    assert code == 0 and out.startswith("\n".join(made.account)) and made.survey == Path("b.csv")
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    assert Path("a.toml").read_text().replace('"a.csv', '"b.csv').replace('"a"', '"b"') == Path("b.toml").read_text()
    with pytest.raises(hj.InputError, match=r"b\.toml exists, and import replaces no file"):
        hj.import_survey("gps.txt", "b.toml")
    for wrong, words in (
        ({"uphill": "up"}, "uphill = 'up' is not known"), ({"unit": "m"}, "unit is not an option"),
        ({"length": "long"}, "length = 'long'"), ({"nodata": "none"}, "nodata = 'none' must be"),
    ):  # fmt: skip
        with pytest.raises(hj.InputError, match=words):
            hj.import_survey("gps.txt", "c.toml", **wrong)
    assert not Path("c.toml").exists() and not Path("c.csv").exists()


def test_the_table_of_the_page_has_a_function_for_every_command():
    page = (Path(hj.__file__).parents[1] / "docs" / "api.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| (`.*) \|$", page, re.M))
    commands = {name for name in app if not name.startswith("-")}
    assert set(rows) == commands
    for functions in rows.values():
        for name in re.findall(r"`([\w.]+)`", functions):
            thing = hj
            for part in name.split("."):
                thing = getattr(thing, part)
            assert callable(thing), name
