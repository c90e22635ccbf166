"""Numbers at the edge of the range, everywhere where one is given: a result, or one sentence, and at once."""

import re
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from bad_cases import PROFILES, VALID, with_files

import hjprofile as hj
from hjprofile.output.plots.animation import animation
from hjprofile.output.store import write_run
from hjprofile.problem.case import parse_case
from hjprofile.problem.ranges import RANGES, as_number
from hjprofile.studies.fractional import fractional_steps

NUMBERS = [1e308, -1e308, 5e-324, -0.0, float("inf"), float("nan"), 10**400, -(10**400), 1e-16, 1e16]
OTHERS = [True, "1", None, [], 1j, np.array([0.5]), np.datetime64("2024-05-01"), {}]
LONGEST = 5.0  # seconds of this process for one call; the slowest takes half a second when it is compiled

LAW, GRID = hj.rational(), hj.Grid(-6.0, 200)
SLOPE, BUMP = hj.kinks([-3.0, -2.0], [0.4, 1.2]), hj.bumps([0.5], [-3.0], [0.5])


def problem(profile=SLOPE, end=0.1, **named):
    return hj.Problem(LAW, profile, end=end, snapshots=2, **named)


def on_grid(profile, **named):
    return hj.solve_hj(problem(profile, **named), GRID, "godunov")


def solved(problem, grid=GRID, **named):
    return hj.solve_hj(problem, grid, "godunov", **named)


PROFILE_OF = {
    "kinks.positions": lambda v: hj.kinks([v], [0.4]),
    "kinks.amplitudes": lambda v: hj.kinks([-3.0], [v]),
    "bumps.amplitudes": lambda v: hj.bumps([v], [-3.0], [0.5]),
    "bumps.centres": lambda v: hj.bumps([0.5], [v], [0.5]),
    "bumps.widths": lambda v: hj.bumps([0.5], [-3.0], [v]),
    "steps.edges": lambda v: hj.steps([v, -2.0], [0.5]),
    "steps.values": lambda v: hj.steps([-3.0, -2.0], [v]),
    "points.x": lambda v: hj.points([-3.0, v], [0.5, 0.5]),
    "points.q": lambda v: hj.points([-3.0, -2.0], [0.5, v]),
    "steady.flux": lambda v: hj.steady(v, -2.0),
    "steady.kink": lambda v: hj.steady(0.3, v),
    "profile, its value": lambda v: hj.profile(lambda x: x + np.where(x > -3.0, 1.0, 0.0) * v),
    "survey.critical_slope": lambda v: hj.survey("survey.csv", v, 2.0, "isotonic"),
    "survey.length": lambda v: hj.survey("survey.csv", 0.5, v, "isotonic"),
}
SOLVERS = {
    "on a grid": on_grid,
    "by fronts": lambda profile: hj.track_fronts(problem(profile), GRID, 40),
    "by characteristics": lambda profile: hj.solve_characteristics(problem(profile), GRID, 1e-8),
    "to a tolerance": lambda profile: hj.solve(problem(profile), 1e-3, GRID),
}
CALLS = {
    f"{name} {how}": (lambda v, make=make, solve=solve: solve(make(v)))
    for name, make in PROFILE_OF.items()
    for how, solve in SOLVERS.items()
}
CALLS |= {
    "profile": hj.profile,
    "Problem.law": lambda v: hj.Problem(v, SLOPE, 1.0),
    "Problem.profile": lambda v: hj.Problem(LAW, v, 1.0),
    "Problem.end": lambda v: solved(problem(end=v)),
    "Problem.end, conservative": lambda v: hj.solve_conservative(problem(end=v), GRID),
    "Problem.end, kinks by fronts": lambda v: hj.track_fronts(problem(end=v), GRID),
    "Problem.end, fronts": lambda v: hj.track_fronts(problem(BUMP, end=v), GRID, 40),
    "Problem.end, characteristics": lambda v: hj.solve_characteristics(problem(BUMP, end=v), GRID, 1e-8),
    "Problem.end, tolerance": lambda v: hj.solve(problem(BUMP, end=v), 1e-3, GRID),
    "Problem.end, whole line": lambda v: solved(problem(end=v, line="whole"), hj.Grid(-6.0, 200, 1.0)),
    "Problem.snapshots": lambda v: solved(hj.Problem(LAW, SLOPE, 0.1, snapshots=v)) if v != 10**16 else None,
    "Problem.snapshots, a time": lambda v: solved(hj.Problem(LAW, SLOPE, 0.1, snapshots=[v])),
    "Problem.title": lambda v: hj.Problem(LAW, SLOPE, 0.1, title=v),
    "Problem.coefficient": lambda v: hj.Problem(LAW, SLOPE, 0.1, coefficient=v),
    "Problem.line": lambda v: hj.Problem(LAW, SLOPE, 0.1, line=v),
    "Problem.supply_flux": lambda v: hj.solve_conservative(problem(supply_flux=v), GRID, "conservative-telescoping"),
    "Grid.left": lambda v: solved(problem(), hj.Grid(v, 200)),
    "Grid.left, fronts": lambda v: hj.track_fronts(problem(BUMP), hj.Grid(v, 200), 40),
    "Grid.left, characteristics": lambda v: hj.solve_characteristics(problem(BUMP), hj.Grid(v, 200), 1e-8),
    "Grid.left, python": lambda v: solved(problem(hj.profile(lambda x: x)), hj.Grid(v, 200)),
    "Grid.cells": lambda v: hj.Grid(-6.0, v),
    "Grid.right": lambda v: solved(problem(line="whole"), hj.Grid(-6.0, 200, v)),
    "power": lambda v: solved(hj.Problem(hj.power(v), SLOPE, 0.1)),
    "expression": hj.expression,
    "expression, a factor": lambda v: solved(hj.Problem(hj.expression(f"{as_number(v)}*q/(1+q)"), SLOPE, 0.1)),
    "erosion_law": hj.erosion_law,
    "erosion_law.derivative": lambda v: hj.erosion_law(np.log1p, derivative=v),
    "erosion_law.inverse": lambda v: hj.erosion_law(np.log1p, inverse=v),
    "erosion_law.growth": lambda v: hj.erosion_law(np.log1p, growth=v),
    "coefficient": hj.coefficient,
    "coefficient, its value": lambda v: solved(problem(coefficient=hj.coefficient(lambda t, x: v + 0.0 * x * t))),
    "stored_coefficient": hj.stored_coefficient,
    "solve.problem": lambda v: hj.solve(v, 1e-3),
    "solve.tolerance": lambda v: hj.solve(problem(), v, GRID),
    "solve.grid": lambda v: hj.solve(problem(), 1e-3, v),
    "solve_hj.problem": lambda v: hj.solve_hj(v, GRID),
    "solve_hj.grid": lambda v: hj.solve_hj(problem(), v),
    "solve_hj.method": lambda v: hj.solve_hj(problem(), GRID, v),
    "solve_hj.cfl": lambda v: solved(problem(), cfl=v),
    "solve_hj.refresh": lambda v: solved(problem(), refresh=v),
    "solve_conservative.problem": lambda v: hj.solve_conservative(v, GRID),
    "solve_conservative.grid": lambda v: hj.solve_conservative(problem(), v),
    "solve_conservative.cfl": lambda v: hj.solve_conservative(problem(), GRID, cfl=v),
    "solve_case": hj.solve_case,
    "track_fronts.problem": hj.track_fronts,
    "track_fronts.grid": lambda v: hj.track_fronts(problem(), v),
    "track_fronts.fronts": lambda v: hj.track_fronts(problem(BUMP), GRID, v),
    "solve_characteristics.problem": hj.solve_characteristics,
    "solve_characteristics.tolerance": lambda v: hj.solve_characteristics(problem(), GRID, v),
    "survey.file": lambda v: hj.survey(v, 0.5, 2.0),
    "survey.repair": lambda v: hj.survey("survey.csv", 0.5, 2.0, v),
    "read_survey": hj.read_survey,
    "load_case": hj.load_case,
    "load_case.overrides": lambda v: hj.load_case("two_kinks", v),
    "load_case.overrides, a value": lambda v: hj.load_case("two_kinks", {"domain.cells": v, "time.end": v}),
    "load_run": hj.load_run,
    "write_run": lambda v: hj.write_run(v, "out", False, False),
    "compare": lambda v: hj.compare(v, v),
    "observed_order": lambda v: hj.observed_order([1.0, v], [2.0, v]),
    "check": hj.check,
    "check_consistency": lambda v: hj.check_consistency(v, GRID),
    "check_consistency.grid": lambda v: hj.check_consistency(problem(), v),
    "check_consistency.cfl": lambda v: hj.check_consistency(problem(), GRID, v),
    "chart": hj.chart,
    "slow_erosion": lambda v: hj.slow_erosion(problem(), GRID, v),
    "slow_erosion, a supply_flux": lambda v: hj.slow_erosion(problem(), GRID, [v]),
    "sweep": lambda v: hj.sweep(v, {"time.end": [0.1]}),
    "sweep.vary": lambda v: hj.sweep("two_kinks", v),
    "sweep.vary, values": lambda v: hj.sweep("two_kinks", {"time.end": v}),
    "sweep.vary, a value": lambda v: hj.sweep("two_kinks", {"domain.left": [v]}),
    "fit": lambda v: hj.fit(v, [0.0, 1.0, 2.0], [0.0, 1.0, 2.0], ["time.end"]),
    "fit.x": lambda v: hj.fit("hillslope", [0.0, v], [0.0, 1.0], ["time.end"]),
    "fit.height": lambda v: hj.fit("hillslope", [0.0, 1.0], v, ["time.end"]),
    "fit.vary": lambda v: hj.fit("hillslope", [0.0, 1.0, 2.0], [0.0, 1.0, 2.0], v),
    "fit.sigma": lambda v: hj.fit("hillslope", [0.0], [0.0], ["time.end"], v),
    "stability": lambda v: hj.stability(v),
    "dependence": lambda v: hj.dependence(v, GRID),
    "dependence.grid": lambda v: hj.dependence(problem(), v),
    "statements": lambda v: hj.statements(v, GRID),
    "fractional_steps": lambda v: fractional_steps(problem(), GRID, "godunov", [v]),
    "animation": lambda v: animation(None, ".gif", v),
}


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    """A working directory with the files that cases name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(with_files(tmp_path_factory.mktemp("numbers")))
        yield Path.cwd()


def in_order(name, call, value):
    started = time.process_time()
    with np.errstate(all="warn", under="ignore"), warnings.catch_warnings():  # as a user has it
        warnings.simplefilter("error")
        try:
            call(value)
        except (hj.InputError, hj.RunError) as error:
            assert all("\n" not in str(fault) for fault in getattr(error, "faults", [error]))
        except BaseException as error:
            raise AssertionError(f"{name} of {value!r:.30}: {type(error).__name__}: {error}") from error
    assert time.process_time() - started < LONGEST, f"{name} of {value!r:.30}"


@pytest.mark.parametrize("name", CALLS)
def test_every_argument_is_taken_or_refused(name):
    for value in NUMBERS + OTHERS:
        in_order(name, CALLS[name], value)


TABLES = {
    "erosion": {"law": "power", "m": 2.0},
    "layer": {"supply_flux": 0.0},
    "domain": {"left": -6.0, "cells": 200},
    "time": {"end": 0.1, "snapshots": 2},
    "solver": {"method": "godunov", "cfl": 0.9, "refresh": 0.05},
    "output": {"checkpoint": 60.0},
}
KEYS = [(section, table, key) for section, table in TABLES.items() for key in table]
KEYS += [("profile", {"kind": kind} | table, key) for kind, table in PROFILES.items() for key in table]
KEYS += [("solver", {"method": method, "tolerance": 1e-4}, "tolerance") for method in ("auto", "characteristics")]
KEYS += [("domain", {"line": "whole", "left": -6.0, "right": 1.0, "cells": 200}, key) for key in ("left", "right")]


@pytest.mark.parametrize(("section", "table", "key"), KEYS, ids=[f"{s}.{t.get('kind', '')}.{k}" for s, t, k in KEYS])
def test_every_key_is_taken_or_refused(section, table, key, folder):
    """Numbers of lists as well; a case that is taken can be solved."""
    base = VALID | {"domain": TABLES["domain"], "time": {"end": 0.1, "snapshots": 2}}

    def solve(value):
        content = base | {section: table | {key: [value, *table[key][1:]] if isinstance(table[key], list) else value}}
        hj.solve_case(parse_case(content, "case", "case.toml", folder))

    for value in [*NUMBERS, True, "1", []]:
        in_order(f"{section}.{key}", solve, value)


OPTIONS = [
    *(("run", option) for option in ("--cells", "--cfl", "--tolerance", "--end")),
    *(("sweep", option) for option in ("--workers", "--vary=time.end")),
    ("fit", "--sigma"),
    ("animate", "--fps"),
]
TEXTS = ["1e308", "-1e308", "5e-324", "-0.0", "inf", "nan", "9" * 400, "-1", "1e400", "true", "one", "''"]


@pytest.mark.parametrize(("command", "option"), OPTIONS, ids=[" ".join(o) for o in OPTIONS])
def test_every_option_is_taken_or_refused(command, option, folder, call):
    (folder / "scene.toml").write_text(tomli_w.dumps(VALID | {"time": {"end": 0.1, "snapshots": 2}}))
    write_run(on_grid(SLOPE), folder / "result", vtk=False, plots=False)
    where = {"animate": ["result", "--out", "film.gif"], "fit": ["scene.toml", "survey.csv", "--vary", "time.end"]}
    for text in TEXTS:
        if command == "sweep" and text == "-0.0":
            continue  # that is 0, and begins two processes, which take seconds
        arguments = [command, *where.get(command, ["scene.toml"]), f"{option}={text}"]
        if option == "--workers":
            arguments += ["--vary", "time.end=0.1"]
        code, _, err = call(*arguments)
        assert code in (0, 1, 2) and "Traceback" not in err and err.count("\n") == (code != 0), (arguments, err)


def test_the_table_of_the_documentation_is_that_of_the_code():
    text = (Path(__file__).parents[2] / "docs" / "cases.md").read_text(encoding="utf-8")
    part = text.partition("### The range of each number")[2].partition("\n#")[0]
    told = {}
    for names, zero, least, most in re.findall(r"^\| (.+?) \| (0, or )?from (\S+) to (\S+) \|$", part, flags=re.M):
        for name in re.findall(r"`(.+?)`", names):
            told[name] = (float(least), float(most), bool(zero))
    assert told == {name: (r.least, r.most, r.zero) for name, r in RANGES.items()}


@pytest.mark.parametrize("name", ["cfl", "end", "m", "left", "amplitudes"])
def test_both_ends_of_a_range_belong_to_it(name):
    for end in RANGES[name][:2]:
        assert RANGES[name].holds(end)
        assert not RANGES[name].holds(np.nextafter(end, np.inf if end == RANGES[name].most else -np.inf))
    assert RANGES[name].holds(0.0) == (name in ("end", "amplitudes"))


def test_numbers_of_numpy_are_numbers():
    """Scalars, arrays without a dimension, tuples and arrays; also where a case is changed and swept."""
    cells, left, end = np.int64(60), np.float32(-6.0), np.array(0.5)
    grid = hj.Grid(left, cells)
    assert (grid.left, grid.cells) == (-6.0, 60) and type(grid.cells) is int and type(grid.left) is float
    slope = hj.kinks((np.float64(-3.0), -2), np.array([0.4, 1.2]))
    same = hj.Problem(LAW, slope, end, snapshots=np.int64(3))
    assert same.times.tolist() == [0.0, 0.25, 0.5] and type(same.end) is float
    changes = {"domain.cells": cells, "time.end": end, "time.snapshots": (0.0, np.float32(0.5)), "title": "x"}
    changes |= {"profile.positions": (-3.0, -2.0), "profile.amplitudes": np.array([0.4, 1.2]), "output.vtk": np.True_}
    case = hj.load_case("two_kinks", changes)
    assert (case.grid.cells, case.problem.end, case.problem.title) == (60, 0.5, "x")
    assert case.problem.times.tolist() == [0.0, 0.5] and case.vtk is True
    assert case.problem.profile.table["amplitudes"] == [0.4, 1.2]
    vary = {"domain.cells": np.array([60, 80]), "profile.positions": ((-7.0, -5.0), np.array([-6.0, -5.0]))}
    swept = hj.sweep("two_kinks", vary | {"time.end": (np.float64(0.1),)})
    assert [outcome.status for outcome in swept.outcomes] == ["done"] * 4
    assert swept.values[-1] == (80, [-6.0, -5.0], 0.1)
    run = hj.solve(same, np.float32(1e-3), grid)
    write_run(run, "scalars", vtk=False, plots=False)
    assert hj.load_run("scalars").case["solver"]["tolerance"] == pytest.approx(1e-3)


@pytest.mark.parametrize("key", ["", "a.b.c", ".cells", "domain.", 3])
def test_what_is_no_key_of_a_case(key):
    with pytest.raises(hj.InputError, match="is not a key of a case; it is written section"):
        hj.load_case("two_kinks", {key: 1.0})


def test_a_small_cfl_is_told_by_its_name():
    """Steps that are short by the user's choice: fewer cells would not help."""
    slow = hj.Problem(LAW, hj.kinks([-30.0], [1e3]), 1e6, 2)
    run = hj.solve_hj(slow, hj.Grid(-31.0, 4000), "godunov", cfl=1e-4)
    assert re.search(r"and cfl = 0\.0001; use a larger cfl, fewer cells or an earlier end$", run.status)


@pytest.mark.parametrize("times", [np.arange(0.0, 0.31, 0.1), [-1e-17, 0.1, 0.3 * (1 + 1e-15)]])
def test_times_within_rounding_of_the_ends_are_the_ends(times):
    """0.30000000000000004 was refused: "snapshots holds 0.3; times must lie between 0 and end = 0.3"."""
    slope = hj.Problem(LAW, SLOPE, 0.3, snapshots=times)
    assert slope.times[0] == 0.0 and slope.times[-1] == 0.3
    assert solved(slope).time.tolist() == slope.times.tolist()
    for outside in ([0.0, 0.3 * (1 + 1e-6)], [-1e-6, 0.3]):
        with pytest.raises(hj.InputError, match=r"snapshots holds .*; times must lie between 0 and end = 0\.3"):
            hj.Problem(LAW, SLOPE, 0.3, snapshots=outside)
