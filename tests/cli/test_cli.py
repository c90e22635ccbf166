"""The command line when all goes well, and when a check fails: what it writes, prints and returns."""

import csv
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from grid_methods import TWINS, with_fault

import hjprofile
from hjprofile.cli.common import Progress, app
from hjprofile.output.checkpoint import NAME, Checkpoint
from hjprofile.output.plots import statement_pictures
from hjprofile.output.run_account import run_account, with_error
from hjprofile.output.store import load_run
from hjprofile.problem.case import load_case
from hjprofile.problem.case_files import shipped_cases
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.solve import solve_and_keep, solve_case
from hjprofile.studies import characteristic_statements, dependence, statement_runs, statement_table, statements
from hjprofile.studies import stability as study
from hjprofile.studies.chart import Chart, Point, Reference

SCENE = {
    "title": "Zwei Knicke",
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -4.0, "cells": 160},
    "time": {"end": 4.0, "snapshots": 5},
}
BARE = {"output": {"vtk": False, "plots": False}}
DRAWN = [f"{name}.{form}" for name in ("profile", "diagram", "factor", "norms") for form in ("png", "svg")]
COMMANDS = (
    "run", "check", "chart", "stability", "dependence", "statements", "sweep", "fit", "plot", "compare", "animate",
    "export", "cases", "explain", "import", "validate", "new", "methods")  # fmt: skip


def write_case(folder, name="scene", **changes):
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(SCENE | changes), encoding="utf-8")
    return path


@pytest.fixture
def folder(in_tmp):
    write_case(in_tmp)
    write_case(in_tmp, "bare", **BARE)
    return in_tmp


def contents(folder):
    """Name -> bytes of the files that a user sees."""
    files = (p for p in Path(folder).rglob("*") if p.is_file() and p.name[0] != ".")
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def test_a_run_counts_the_memory_of_its_files(folder, call, monkeypatch):
    """5 snapshots: 24 * 5 + 24 numbers of 8 bytes for each of 160 cells are 184 kB with files, 96 kB without."""
    pages, sysconf = {"SC_PAGE_SIZE": 1024, "SC_PHYS_PAGES": 150}, os.sysconf
    monkeypatch.setattr(os, "sysconf", lambda name: pages.get(name) or sysconf(name))
    code, _, err = call("run", "scene.toml")
    assert code == 2 and not Path("results").exists()
    said = " ".join(err.split())
    for words in (
        "scene.toml: [domain] cells = 160 with 5 snapshots needs",
        "at most 133 cells fit",
        "--no-plots and --no-vtk",
    ):
        assert words in said
    assert call("run", "scene.toml", "--no-plots", "--no-vtk")[0] == 0
    pages["SC_PHYS_PAGES"] = 90
    code, _, err = call("run", "bare.toml")
    assert code == 2 and "needs" in err and "--no-vtk" not in err


def test_run_then_plot_and_export_again(folder, call):
    code, out, err = call("run", "scene.toml")
    assert (code, err) == (0, "")
    run = load_run("results/scene")
    assert np.array_equal(run.u, solve_case(load_case("scene.toml")).u)
    written = contents("results/scene")
    assert {"profile.nc", "summary.json", "profile.png", "vtk/sheet.vtr"} < written.keys()

    lines = out.splitlines()
    assert lines[0] == "Zwei Knicke"
    assert [line.split()[0] for line in lines[1:]] == [
        "solved", "volume", "toe", "kinks", "budgets", "bounds", "error", "written"
    ]  # fmt: skip
    assert f"local-lax-friedrichs, 160 cells, {run.steps} time steps" in lines[1] and lines[1].endswith("to t = 4")
    number = r"[0-9.]+ ± [0-9.]+"
    assert re.search(f"volume      net erosion {number}$", lines[2])
    assert re.search(f"toe outflow {number} of 4 supplied$", lines[3])
    assert with_error(run.eroded_volume, run.eroded_volume_error) in lines[2]
    assert with_error(run.toe_outflow, run.toe_outflow_error) in lines[3]
    assert re.search(r" 2 at .*, 0 at .*; 0 births, 1 merge, 1 exit$", lines[4])
    assert f"mass to rounding; volume to {run.volume_budget_error:.2g} (first order in dx)" in lines[5]
    assert lines[6].endswith("all hold")
    assert lines[7] == f"  error       ‖u - u_exact‖_∞ about {run.error_estimate:.2g} (estimate)"
    assert "results/scene: profile.nc" in lines[8] and "vtk/ (13 files)" in lines[8] and "profile.png" in lines[8]

    # from the folder alone, into it or elsewhere, to the byte
    for file in ("profile.png", "factor.png", "vtk/profile_0002.vtp", "vtk/kinks.pvd"):
        Path("results/scene", file).unlink()
    code, out, err = call("plot", "results/scene")
    assert (code, err, out.split()) == (0, "", ["results/scene:", *", ".join(DRAWN).split()])
    code, out, err = call("export", "results/scene", "--vtk")
    assert (code, err) == (0, "") and out.startswith("results/scene/vtk: ")
    again = contents("results/scene")
    drawn = {name: again.pop(name) for name in DRAWN if name.endswith(".svg")}
    assert again == written
    assert call("export", "results/scene", "--vtk", "--out", "paraview")[0] == 0
    assert contents("paraview") == {name[4:]: data for name, data in written.items() if name.startswith("vtk/")}
    assert call("plot", "results/scene", "--out", "pictures")[0] == 0
    assert contents("pictures") == {name: data for name, data in (written | drawn).items() if name in DRAWN}


def test_options_override_the_case(folder, call):
    options = {"--method": "godunov", "--cells": 50, "--cfl": 0.5, "--end": 0.25, "--out": "elsewhere/deep"}
    code, out, _ = call("run", "bare.toml", *[part for pair in options.items() for part in pair])
    assert code == 0 and "godunov, 50 cells" in out and "to t = 0.25" in out
    run = load_run("elsewhere/deep")
    assert (run.method, run.cells, run.time[-1], run.time.size) == ("godunov", 50, 0.25, 5)
    assert run.case["solver"] == {"method": "godunov", "cfl": 0.5}
    assert not Path("results").exists()
    assert call("run", "bare.toml")[0] == 0  # and leave it alone
    assert (load_run("results/bare").method, load_run("results/bare").cells) == ("local-lax-friedrichs", 160)


def test_a_tolerance_is_met_and_the_estimate_told(folder, call):
    code, out, _ = call("run", "bare.toml", "--tolerance", "1e-6")
    assert (
        code == 0
        and "fronts, 160 cells" in out
        and "  chosen      fronts, which are exact" in out
        and "  error       ‖u - u_exact‖_∞ about " in out
    )
    run = load_run("results/bare")
    assert run.method == "fronts" and 0 < run.error_estimate <= 1e-6
    assert json.loads(Path("results/bare/summary.json").read_text())["error_estimate"] == run.error_estimate
    fine = solve_case(dataclasses.replace(load_case("bare.toml"), method="fronts"))  # exact for kinks
    assert np.abs(run.u - fine.u).max() <= run.error_estimate
    assert call("run", "bare.toml", "--method", "characteristics")[0] == 0
    assert np.abs(load_run("results/bare").u - fine.u).max() <= 1e-11
    assert call("run", "bare.toml")[0] == 0
    grid, stored = load_run("results/bare"), json.loads(Path("results/bare/summary.json").read_text())
    error = np.abs(grid.u - fine.u).max()
    assert error <= stored["error_estimate"] <= 1.01 * error
    error = abs(grid.toe_outflow - fine.toe_outflow)
    assert error <= stored["toe_outflow_error"] <= 1.01 * error
    assert stored["norms_start"].keys() == stored["norms_end"].keys() == {"l1", "tv", "inf", "sup"}


def test_nothing_but_data_where_the_case_says_so(folder, call):
    code, out, _ = call("run", "bare.toml")
    assert contents("results/bare").keys() == {"profile.nc", "kinks.csv", "events.csv", "norms.csv", "summary.json"}
    assert code == 0 and "written     results/bare: profile.nc, kinks.csv, events.csv, norms.csv, summary.json\n" in out


def test_a_shipped_case_by_name_and_its_survey_units(in_tmp, call):
    code, out, err = call("run", "hillslope", "--cells", "260", "--end", "0.1")
    assert (code, err) == (0, "")
    run = load_run("results/hillslope")
    unit = 200**2 * 0.257
    outflow, eroded = (
        with_error(value * unit, error * unit)
        for value, error in (
            (run.toe_outflow, run.toe_outflow_error), (abs(run.eroded_volume), run.eroded_volume_error)
        )
    )  # fmt: skip
    assert f"of 0.1 supplied ({outflow} of {0.1 * unit:.0f} m² per unit width)" in out
    assert f"({eroded} m² per unit width)" in out
    assert f"(estimate), {run.error_estimate * 200 * 0.257:.2g} m\n" in out


def test_the_account_of_a_survey_whose_unit_has_no_name():
    case = load_case("hillslope", {"domain.cells": 260, "time.supplied": 3084.0})
    run = solve_case(case)
    text = run_account(dataclasses.replace(run, units=dataclasses.replace(run.units, unit="")))
    unit = 200**2 * 0.257
    eroded = with_error(abs(run.eroded_volume) * unit, run.eroded_volume_error * unit)
    assert " of 3084 in the survey's units, per unit width)\n" in text
    assert f"({eroded} in the survey's units, per unit width)\n" in text
    assert f"(estimate), {run.error_estimate * unit / 200:.2g} in the survey's units" in text


def test_the_account_says_what_was_done_to_the_data(folder, call):
    (folder / "slope.csv").write_text("x,height\n0,0\n100,60\n200,50\n300,200\n")
    survey = {"kind": "survey", "file": "slope.csv", "critical_slope": 0.6, "length": 100.0, "repair": "isotonic"}
    write_case(folder, "survey", profile=survey, **BARE)
    _, out, _ = call("run", "survey.toml", "--end", "0.1")
    assert out.splitlines()[1].startswith("  data        survey repaired: ")
    _, out, _ = call("run", "survey.toml", "--end", "0.1", "--tolerance", "0.01")
    lines = out.splitlines()
    assert lines[1].startswith("  data        survey repaired: ") and lines[1].endswith("(r.m.s.)")
    stored = load_run("results/survey")  # once in the account, and among the warnings of the summary
    assert out.count("survey repaired") == 1 and stored.warnings[0] == lines[1][14:] not in stored.cautions
    assert json.loads(Path("results/survey/summary.json").read_text())["warnings"] == stored.warnings
    assert lines[2].startswith("  chosen      ") and "error of u about" in lines[2] and "solved" in lines[3]


def test_the_account_says_which_bounds_were_not_held(folder, call):
    code, out, _ = call("run", "bare.toml", "--method", "godunov", "--cfl", "2")
    broken = [name for name, b in load_run("results/bare").bounds.items() if not b.holds]
    assert code == 0 and broken and "  bounds      VIOLATED:\n" in out
    run = load_run("results/bare")
    assert [w.split()[0] for w in run.warnings] == broken
    assert all(f"  WARNING     {w}\n" in out for w in run.warnings)
    assert json.loads(Path("results/bare/summary.json").read_text())["warnings"] == run.warnings
    code, out, err = call("run", "bare.toml", "--method", "godunov", "--cfl", "2", "--strict")
    assert code == 1 and "stopped at t = " in err and f"{broken[0]} does not hold" in err
    lost = {"mass_budget": run.bounds["mass_budget"]._replace(holds=False)}
    assert "mass VIOLATED" in run_account(dataclasses.replace(run, bounds={**run.bounds, **lost}))


def test_stability_writes_its_table_and_picture(folder, call, monkeypatch):
    """Of two of its scans and rows for a third; tests/studies/test_stability.py has all of them."""
    monkeypatch.setattr(study, "CELLS", 60)
    monkeypatch.setattr(study, "STEPS", 300)
    for scan in ("_viscosity", "_reconstruction", "_smallness", "_exponents"):
        monkeypatch.setattr(study, scan, lambda data: iter(()))
    rows = [
        ("godunov", "cfl", value, outcome, "", 1.0)
        for value, outcome in ((0.5, study.HOLDS), (1.5, study.OSCILLATES), (3.0, study.FAILS))
    ]
    rows += [("weno5", "cfl", value, study.HOLDS, "", METHODS["weno5"].cfl_proved) for value in (0.5, 3.0)]
    monkeypatch.setattr(study, "_cfl", lambda data: iter(rows))
    code, out, err = call("stability", "bare.toml")
    assert (code, err) == (0, "") and out.splitlines()[1].split()[0] == "godunov"
    assert out.splitlines()[2].split() == ["weno5", "all", "up", "to", "3", "(none)"]  # no limit is proved
    rows = list(csv.DictReader(Path("results/bare/stability.csv").read_text().splitlines()))
    assert list(rows[0]) == ["case", "method", "parameter", "value", "outcome", "detail"]
    assert {row["outcome"] for row in rows} == {"holds", "loses_bounds", "oscillates", "fails"}
    assert {row["case"] for row in rows} == {"bare"} and "nan" not in {v for row in rows for v in row.values()}
    assert Path("results/bare/stability.png").read_bytes().startswith(b"\x89PNG")


def test_dependence_writes_its_table_and_picture(folder, call, monkeypatch):
    for name, fewer in (("CELLS", 100), ("PAIRS", 2), ("WAVES", 1), ("REFRESHES", (16, 8))):
        monkeypatch.setattr(dependence, name, fewer)
    code, out, err = call("dependence", "bare.toml")
    assert (code, err) == (0, "") and [line.split()[0] for line in out.splitlines()[1:5]] == [
        "data", "zero", "coefficient", "refresh",
    ]  # fmt: skip
    rows = list(csv.DictReader(Path("results/bare/dependence.csv").read_text().splitlines()))
    assert list(rows[0]) == ["case", "study", "member", "size", "time", "distance", "bound", "constant"]
    assert all((row["constant"] != "") == (row["study"] in ("data", "zero")) for row in rows)
    assert {row["study"] for row in rows} == {"data", "zero", "coefficient", "refresh", "refresh kinks"}
    assert Path("results/bare/dependence.png").read_bytes().startswith(b"\x89PNG")
    honest = dependence.distance_bound
    monkeypatch.setattr(dependence, "distance_bound", lambda *pair: 0.1 * honest(*pair))
    code, _, err = call("dependence", "bare.toml")
    assert code == 1 and "times its bound" in err


def once(function):
    """A function that returns its first value at every call."""
    values = []

    def first(*arguments):
        if not values:
            values.append(function(*arguments))
        return values[0]

    return first


def test_statements_writes_its_tables_and_pictures(folder, call, monkeypatch):
    monkeypatch.setattr(characteristic_statements, "TIMES", 101)
    for part in ("evolve", "freeze", "follow"):  # once for both calls
        monkeypatch.setattr(statements, part, once(getattr(statements, part)))
    code, out, err = call("statements", "bare.toml")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].startswith("bare, 160 cells: ") and len(lines) == 2 + len(statement_table.STATEMENTS) + 3
    assert lines[1].split()[0] == "H1" and re.search(r"holds  \S+ / \S+ at t = ", lines[1])
    (negative,) = [line for line in lines if "(3.6)" in line]
    assert negative.endswith("not applicable: q is nowhere negative at t = 0")
    names = ["statements.csv", "characteristics.csv", "statements.png", "invariant.png"]
    assert lines[-1].endswith("results/bare: " + ", ".join(names))
    rows = list(csv.DictReader(Path("results/bare/statements.csv").read_text().splitlines()))
    assert list(rows[0]) == ["statement", "equation", "time", "value", "bound"]
    assert {"H1", "(2.14)", "(3.24)", "(A.5)"} < {name for row in rows for name in row["equation"].split(", ")}
    rows = list(csv.DictReader(Path("results/bare/characteristics.csv").read_text().splitlines()))
    assert list(rows[0]) == ["characteristic", "time", "x", "q", "K", "F", "W", "I"]
    assert all(Path("results/bare", name).read_bytes().startswith(b"\x89PNG") for name in names[2:])
    monkeypatch.setattr(statement_table, "_domain", lambda history: (1e-3, 0.0))
    for picture in ("statements_picture", "invariant_picture"):
        monkeypatch.setattr(statement_pictures, picture, lambda *_: b"")
    code, out, err = call("statements", "bare.toml")
    assert code == 1 and "violated statements: (A.1), (A.2)" in err and len(re.findall("FAILS", out)) == 2


def test_statements_on_a_survey_and_with_a_coefficient(folder, call, monkeypatch):
    monkeypatch.setattr(statements, "CELLS", 150)
    for where, name in ((characteristic_statements, "TIMES"), (statement_runs, "MOMENTS")):
        monkeypatch.setattr(where, name, 21)
    for picture in ("statements_picture", "invariant_picture"):
        monkeypatch.setattr(statement_pictures, picture, lambda *_: b"")
    code, out, err = call("statements", "drying_channel", "--out", "channel")
    assert (code, err) == (0, "") and "drying_channel, 150 cells" in out
    assert sorted(p.name for p in Path("channel").glob("*.png")) == ["statements.png"]  # no invariant
    rows = list(csv.DictReader(Path("channel/characteristics.csv").read_text().splitlines()))
    assert rows and {row["I"] for row in rows} == {""}
    code, _, err = call("statements", "hillslope", "--out", "survey")
    assert (code, err) == (0, "")
    units = load_case("hillslope").problem.profile.units
    for name in ("statements.csv", "characteristics.csv"):
        rows = list(csv.DictReader(Path("survey", name).read_text().splitlines()))
        last = rows[-1]
        assert float(last["time_survey"]) == pytest.approx(units.volume * float(last["time"]))
    assert float(last["x_survey"]) == pytest.approx(float(units.x(float(last["x"]))))


def test_a_resumed_run_says_so(folder, call):
    code, out, _ = call("run", "bare.toml", "--resume")
    assert code == 0 and "  resumed     no: there is no checkpoint, so the run started at t = 0\n" in out
    before = Path("results/bare/profile.nc").read_bytes()
    case = load_case("bare.toml")
    keeper = Checkpoint(Path("results/bare"), 1e9, resume=False)
    with pytest.raises(hjprofile.RunError, match="interrupted at t ="):
        solve_and_keep(
            case, keeper, lambda fraction: fraction < 0.5 or keeper.asked or os.kill(os.getpid(), signal.SIGTERM)
        )
    code, out, _ = call("run", "bare.toml", "--resume")
    assert code == 0 and "  resumed     from the checkpoint at t = " in out
    assert Path("results/bare/profile.nc").read_bytes() == before
    assert not Path("results/bare", NAME).exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_help(call, command):
    code, out, err = call(command, "--help")
    assert (code, err) == (0, "") and f"hjprofile {command}" in out
    assert app[command].help.splitlines()[0].rstrip(".") in " ".join(out.split())


def test_help_names_every_option_and_command(call):
    assert all(
        option in call("run", "--help")[1]
        for option in ("--method", "--cells", "--cfl", "--tolerance", "--end", "--out")
    )
    code, out, _ = call("--help")
    assert code == 0 and re.findall(r"^│ (\w+)", out, re.MULTILINE) == sorted(COMMANDS)
    assert call()[:2] == (0, out)


def test_version(call):
    assert call("--version") == (0, f"{hjprofile.__version__}\n", "")


@pytest.mark.parametrize("arguments", [["run", "scene.toml", "--cels", "3"], ["rum", "scene.toml"], ["plot", "."]])
def test_wrong_usage(folder, call, arguments):
    code, out, err = call(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 1) and err.startswith("hjprofile: ")


def test_cases(call):
    code, out, err = call("cases")
    assert (code, err) == (0, "")
    listed = dict(line.split(maxsplit=1) for line in out.splitlines())
    files = sorted((Path(__file__).parents[2] / "cases").glob("*.toml"))
    assert listed == {f.stem: tomllib.loads(f.read_text(encoding="utf-8"))["title"] for f in files}
    assert listed.keys() == shipped_cases().keys() and len(listed) >= 5


def strict(path):
    return json.loads(Path(path).read_text(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


SHORT = {"time": {"end": 0.25, "snapshots": 2}, "title": "Kurz"}  # orders are those of longer runs


def test_check_passes(folder, call):
    write_case(folder, "short", **SHORT)
    code, out, err = call("check", "short.toml")
    assert (code, err) == (0, "")
    content = strict("results/short/check.json")
    (case,) = content["cases"]
    assert (case["case"], case["title"], case["passes"], content["passes"]) == ("short", "Kurz", True, True)
    lines = out.splitlines()
    assert lines[0] == "short: passes" and lines[-1] == "written to results/short: check.json"
    kinds = {"bounds", "identity", "independence", "kinks", "budget", "characteristics", "order"}
    kinds |= {f"saved-{what}" for what in ("times", "q", "K", "kinks", "events", "crest_lowering", "volume")}
    assert {c["name"].split(":")[0] for c in case["comparisons"]} == kinds
    for c in case["comparisons"]:
        assert c["passes"] is True and len(c["cells"]) == len(c["error"]) > 0
        assert all(isinstance(n, int) for n in c["cells"]) and all(isinstance(e, float) for e in c["error"])
        assert isinstance(c["threshold"], float) and isinstance(c["order"], float | None)
        printed = [line for line in lines if f" {c['name']} " in line]
        quiet = c["name"].startswith(("bounds:", "saved-"))  # these only where they fail
        assert len(printed) == (not quiet)
        assert all(line.startswith("  passes") for line in printed)


def test_check_fails_and_says_where(folder, call, monkeypatch):
    """One flux that is 1 % too large: of all methods only that one is to blame."""

    def faulty(*arguments):
        F, speed = TWINS["godunov"](*arguments)
        return 1.01 * F, speed

    with_fault(monkeypatch, "conservative-godunov", twin=faulty)
    write_case(folder, "short", **SHORT)
    write_case(folder, "flat", profile={"kind": "steps", "edges": [-2.0, -1.0], "values": [0.0]}, **SHORT)
    code, out, err = call("check", "short.toml", "flat.toml", "--out", "verdict")
    assert code == 1 and err.count("\n") == 1
    assert err.startswith("hjprofile: the consistency test fails on short;")
    content = strict("verdict/check.json")
    assert content["passes"] is False
    assert {case["case"]: case["passes"] for case in content["cases"]} == {"short": False, "flat": True}
    failed = {c["name"] for c in content["cases"][0]["comparisons"] if not c["passes"]}
    assert "identity:godunov" in failed and all("godunov" in name for name in failed)
    assert {line.split()[1] for line in out.splitlines() if line.startswith("  FAILS ")} == failed
    assert "short: FAILS" in out and "flat: passes" in out


@pytest.mark.parametrize(
    ("raised", "words"),
    [(KeyboardInterrupt(), "interrupted"), (MemoryError(), "memory of this machine is not sufficient")],
)
def test_what_stops_a_run_from_outside(folder, call, monkeypatch, raised, words):
    def stopped(*_):
        raise raised

    monkeypatch.setattr("hjprofile.solvers.solve.solve_and_keep", stopped)
    code, out, err = call("run", "scene.toml")
    assert (code, out, err.count("\n")) == (1, "", 1) and words in err
    assert not contents("results")


def process(*arguments, **options):
    command = [sys.executable, "-m", "hjprofile", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **options)


def test_the_process_and_the_script(folder):
    done = process("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{hjprofile.__version__}\n", "")
    script = Path(sys.executable).with_name("hjprofile")
    if script.exists():
        same = subprocess.run([script, "--version"], capture_output=True, text=True)
        assert (same.returncode, same.stdout, same.stderr) == (0, done.stdout, "")
    assert process("rum").returncode == 2


def test_a_reader_who_leaves_early(folder):
    """`hjprofile cases | head -1` is no error to speak of."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "hjprofile", "cases"], stdout=writing, stderr=subprocess.PIPE, env=environment
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")


SLOW_LAW = """
import time
import numpy as np

def f(q):
    if 100 < np.size(q) <= 161:  # the nodes, some hundreds of times
        time.sleep(0.005)
    return q / (1 + q)
"""


@pytest.fixture
def slow(folder):
    """A case that takes more than a second on every machine."""
    (folder / "slow_law.py").write_text(SLOW_LAW)
    law = {"law": "python", "file": "slow_law.py", "function": "f"}
    write_case(
        folder, "slow", erosion=law, time={"end": 1.0, "snapshots": 2}, solver={"method": "eno2"}, **BARE
    )  # fmt: skip
    return "slow.toml"


def on_a_terminal(*arguments):
    """Exit code, stdout, and what a terminal on stderr received."""
    pty = pytest.importorskip("pty", reason="needs pseudo-terminals")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "hjprofile", *arguments]
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, env=environment) as running:
        os.close(theirs)
        received = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # Linux's way to say that the other end was closed
                break
            if not piece:
                break
            received += piece
        out = running.stdout.read()
    os.close(ours)
    return running.returncode, out.decode(), received.decode()


def test_a_long_run_shows_a_bar_on_a_terminal(slow):
    code, out, err = on_a_terminal("run", slow)
    assert code == 0 and "solving" in err
    shown = [int(percent) for percent in re.findall(r"(\d+)%", err)]
    assert shown == sorted(shown) and shown[0] < shown[-1] <= 100
    assert re.search(r"\d:\d\d:\d\d", err)  # the time that is left
    assert "\x1b" not in out and out.startswith("Zwei Knicke\n") and "%" not in out


@pytest.mark.parametrize(
    ("terminal", "waited", "shown"), [(False, 10.0, False), (True, 0.0, False), (True, 1.01, True)]
)
def test_a_bar_is_for_terminals_and_after_a_second(monkeypatch, capsys, terminal, waited, shown):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with Progress("solving") as progress:
        progress.started -= waited
        progress(0.5)
        assert (progress.bar is not None) == shown
    assert ("50%" in capsys.readouterr().err) == shown


def test_help_is_quick():
    """Whatever takes long to import is not imported. This is what keeps it under 0.3 s, on any machine."""
    heavy = ["numpy", "numba", "scipy", "pyvista", "vtkmodules", "matplotlib", "llvmlite"]
    commands = [["--help"], [], ["run", "--help"], ["check", "--help"], ["--version"], ["run", "x", "--cels", "1"]]
    program = (
        f"import sys\nfrom hjprofile.cli import main\nfor arguments in {commands!r}:\n    try: main(arguments)\n"
        f"    except SystemExit: print('heavy', arguments, sorted(set(sys.modules) & set({heavy!r})))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    found = [line for line in done.stdout.splitlines() if line.startswith("heavy ")]
    assert found == [f"heavy {arguments} []" for arguments in commands]


def children_of(pid):
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(
    not Path("/proc/self/task").is_dir() or (os.cpu_count() or 1) < 2, reason="needs /proc and two processors"
)
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_the_helper_does_not_outlive_the_run(folder, how):
    """An interrupt at a terminal reaches both processes; a kill only the first."""
    write_case(folder, "long", time={"end": 4.0, "snapshots": 3}, domain={"left": -10.0, "cells": 100_000})
    command = [sys.executable, "-m", "hjprofile", "run", "long.toml"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as running:
        deadline = time.monotonic() + 60.0
        while not (helpers := children_of(running.pid)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert helpers
        time.sleep(1.0)
        (os.killpg if how == signal.SIGINT else os.kill)(running.pid, how)
        _, err = running.communicate(timeout=60)
    if how == signal.SIGINT:
        kept = r" at t = \S+; the state is saved in \S+; --resume continues from it"
        assert running.returncode == 1  # before the first step there is nothing to keep
        said = rf"hjprofile: interrupted(; no partial file was left|{kept}) \(see: hjprofile explain interrupted\)\n"
        assert re.fullmatch(said, err.decode().replace("hjprofile: compiling (once)\n", ""))
    while any(map(alive, helpers)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(map(alive, helpers))
    assert not list(folder.rglob("summary.json"))


def test_an_error_equal_to_that_of_the_reference_is_marked():
    """Errors of numpy compare to numpy's booleans."""
    point = Point("case", "fronts", 100, np.float64(1e-12), np.float64(2e-9), 0.1, 10)
    reference = Reference("characteristics", np.float64(1e-12), np.float64(1e-10), *np.zeros((2, 1, 1)))
    assert "  2.0e-09 of q  <1.0e-12 of u" in str(Chart("case", (point,), reference)).replace("100 ", "")
