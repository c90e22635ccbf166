"""Pickles, short texts, equality and calls of the objects of the Python interface."""

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import hjprofile as hj

X = np.linspace(-6.0, 0.0, 13)
Q = np.array([-0.5, 0.0, 0.3, 4.0])
GRID = hj.Grid(left=-8.0, cells=50)


def of_arrays(q):
    return np.log1p(q)


def of_numbers(q):
    return float(np.log1p(q)) if q > -1 else -np.inf


def height(x):
    return x + np.exp(-((x + 3.0) ** 2)) / 4.0


def medium(t, x):
    return 1.0 + t - 0.1 * x


def medium_of_place(x):
    return 1.0 - 0.1 * x


def supply(t):
    return 1.0 + t


LAWS = {
    "rational()": hj.rational(),
    "log()": hj.log(),
    "power(m=2)": hj.power(2.0),
    "expression(expression='log1p(q)')": hj.expression("log1p(q)"),
    "erosion_law(of_arrays)": hj.erosion_law(of_arrays, inverse=np.expm1),
    "erosion_law(of_numbers)": hj.erosion_law(of_numbers),
    "erosion_law(log1p)": hj.erosion_law(np.log1p, derivative=lambda q: 1.0 / (1.0 + q)),
}
PROFILES = {
    "kinks(positions=[-7, -5], amplitudes=[0.4, 1.2])": hj.kinks([-7.0, -5.0], [0.4, 1.2]),
    "bumps(amplitudes=[1], centres=[-4], widths=[0.7])": hj.bumps([1.0], [-4.0], [0.7]),
    "steps(edges=[-4, -3, -2], values=[0.8, 0.3])": hj.steps([-4.0, -3.0, -2.0], [0.8, 0.3]),
    "points(x=[-6, -5], q=[0, 0.5])": hj.points([-6.0, -5.0], [0.0, 0.5]),
    "steady(flux=0.5, kink=-1)": hj.steady(0.5, -1.0),
    "profile(height)": hj.profile(height),
    "steps(edges=[-4, -2, 0], values=[0.25, -0.25])": hj.profile(x=[-4.0, -2.0, 0.0], u=[-4.0, -1.5, 0.0]),
    "survey(critical_slope=0.3, length=5, x=[0, ..., 90 (10 numbers)], height=[0, ..., 27 (10 numbers)])": hj.survey(
        x=10.0 * np.arange(10), height=3.0 * np.arange(10), critical_slope=0.3, length=5.0
    ),
}
COEFFICIENTS = {
    "coefficient('1 + t')": hj.coefficient("1 + t"),
    "coefficient(medium)": hj.coefficient(medium),
    "coefficient(medium_of_place)": hj.coefficient(medium_of_place),
}


def sent(thing):
    return pickle.loads(pickle.dumps(thing))


@pytest.mark.parametrize("text", [text for text in LAWS if text != "erosion_law(log1p)"])
def test_laws_are_sent(text):
    law, again = LAWS[text], sent(LAWS[text])
    for name in ("f", "derivative", "R", "inverse"):
        at = law.f(Q) if name == "inverse" else Q
        assert np.array_equal(getattr(again, name)(at), getattr(law, name)(at)), name
    assert again.table == law.table and again.eta0 == law.eta0


@pytest.mark.parametrize("text", PROFILES)
def test_profiles_are_sent(text):
    profile, again = PROFILES[text], sent(PROFILES[text])
    assert np.array_equal(again.W(X, hj.log()), profile.W(X, hj.log()))
    assert again.table == profile.table and again.units == profile.units and again.account == profile.account
    assert not any(v.flags.writeable for v in vars(again).values() if isinstance(v, np.ndarray))


@pytest.mark.parametrize("text", COEFFICIENTS)
def test_coefficients_are_sent(text):
    given, again = COEFFICIENTS[text], sent(COEFFICIENTS[text])
    assert np.array_equal(again.values([[0.5], [1.0]], X), given.values([[0.5], [1.0]], X))
    assert (again.table, again.steady, again.left) == (given.table, given.steady, given.left)


def test_a_stored_coefficient_and_supply_fluxes_are_sent(tmp_path):
    run = hj.solve_hj(hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=0.1, snapshots=3), GRID)
    hj.write_run(run, tmp_path / "run", vtk=False, plots=False)
    stored = hj.stored_coefficient(tmp_path / "run")
    assert np.array_equal(sent(stored).values(0.05, X), stored.values(0.05, X)) and "stored_coefficient(" in repr(
        stored
    )
    for flux in ("1 + t", supply):
        problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=0.1, supply_flux=flux)
        assert sent(problem).supply.values(0.3) == 1.3


def test_functions_of_a_file_are_sent(tmp_path, monkeypatch):
    """Another process runs the file again, and refuses one that has changed."""
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text("import numpy as np\ndef f(q):\n    return np.log1p(q)\ndef u(x):\n    return x\n")
    case = hj.load_case(
        {
            "erosion": {"law": "python", "file": "mine.py", "function": "f"},
            "profile": {"kind": "python", "file": "mine.py", "function": "u"},
            "domain": {"left": -2.0, "cells": 20},
            "time": {"end": 0.1},
        }
    )
    data = pickle.dumps(case)
    monkeypatch.chdir("/")
    again = pickle.loads(data)
    assert np.array_equal(again.problem.law.f(Q), np.log1p(Q)) and np.array_equal(again.problem.profile.u(X), X)
    assert hj.solve_case(again).done
    (tmp_path / "mine.py").write_text(
        "import numpy as np\ndef f(q):\n    return 2*np.log1p(q)\ndef u(x):\n    return x\n"
    )
    with pytest.raises(hj.InputError, match="has changed"):
        pickle.loads(data)


LAMBDAS = {
    "law": lambda: hj.erosion_law(lambda q: np.log1p(q)),
    "law of single numbers": lambda: hj.erosion_law(lambda q: float(np.log1p(q)) if q > -1 else -np.inf),
    "derivative": lambda: LAWS["erosion_law(log1p)"],
    "profile": lambda: hj.profile(lambda x: x),
    "coefficient": lambda: hj.coefficient(lambda x: 1.0 + 0.0 * x),
    "supply": lambda: hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), 0.1, supply_flux=lambda t: 1.0 + t),
}


@pytest.mark.parametrize("what", LAMBDAS)
def test_a_lambda_is_refused_with_a_remedy(what):
    with pytest.raises(pickle.PicklingError, match="define it with def outside of other functions"):
        pickle.dumps(LAMBDAS[what]())


def solved(problem):
    return hj.solve_hj(problem, GRID)


def test_problems_and_runs_cross_processes():
    problem = hj.Problem(LAWS["power(m=2)"], hj.bumps([1.0], [-4.0], [0.7]), end=0.5, snapshots=3)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(solved, problem).result()
    here = solved(problem)
    for name in ("time", "x", "u", "q", "K"):
        assert np.array_equal(getattr(there, name), getattr(here, name))
        assert not getattr(there, name).flags.writeable
    assert np.array_equal(there.norms.l1, here.norms.l1) and repr(there.kinks) == repr(here.kinks)


@pytest.mark.parametrize("name", hj.shipped_cases())
def test_cases_are_sent_and_shown(name):
    case = hj.load_case(name)
    again = sent(case)
    assert again.grid == case.grid and repr(again) == repr(case)
    W = case.problem.profile.W(case.grid.nodes, case.problem.law)
    assert np.array_equal(again.problem.profile.W(again.grid.nodes, again.problem.law), W)
    lines = repr(case).splitlines()
    assert len(lines) == 3 and max(map(len, lines)) < 300


@pytest.mark.parametrize(("text", "thing"), [*LAWS.items(), *PROFILES.items(), *COEFFICIENTS.items()])
def test_short_texts(text, thing):
    assert repr(thing) == text


def test_the_text_of_a_run():
    problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, title="<b>One</b>" * 20)
    run = hj.solve_hj(problem, GRID, callback=lambda t, state: t >= 0.5)
    lines = repr(run).splitlines()
    assert len(lines) <= 6 and max(map(len, lines)) <= 160
    assert "done (<lambda> returned True" in lines[0] and "50 cells on [-8, 0]" in lines[1]
    html = run._repr_html_()
    assert html.startswith("<table>") and "<b>" not in html and "eroded volume" in html
    assert len(repr(problem)) < 400


def test_equality_and_hashes():
    """Objects with arrays and functions are equal to themselves only; a problem is compared by its parts."""
    problem = hj.Problem(LAWS["log()"], PROFILES["profile(height)"], end=0.1)
    run, case = solved(problem), hj.load_case("two_kinks")
    for thing in (run, case, problem.law, problem.profile, COEFFICIENTS["coefficient('1 + t')"], problem, GRID):
        assert thing == thing and len({thing, thing}) == 1 and thing != 1
    assert run != solved(problem) and run not in [case, problem]
    assert problem == hj.Problem(problem.law, problem.profile, 0.1) != hj.Problem(problem.law, problem.profile, 0.2)


def test_copies_of_a_run():
    run = solved(hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=0.1))
    for again in (copy.copy(run), copy.deepcopy(run)):
        assert np.array_equal(again.u, run.u) and not again.u.flags.writeable


@pytest.mark.parametrize("text", LAWS)
def test_laws_are_functions(text):
    law = LAWS[text]
    assert np.array_equal(law(Q), law.f(Q)) and law(0.3) == law.f(np.array([0.3]))[0]
    assert law([0.0, 0.3]).shape == (2,) and isinstance(law(1), float)
    for wrong in ("one", None, [1, [2]]):
        with pytest.raises(hj.InputError, match=r"^q = "):
            law(wrong)


SIGNATURES = {"patience", "helper", "base", "table", "content", "keeper"}


def test_no_internal_arguments():
    import inspect

    for name in hj.__all__:
        thing = getattr(hj, name)
        if callable(thing):
            assert not SIGNATURES & set(inspect.signature(thing).parameters), name


TABLES = {
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": (-3.0, -2.0), "amplitudes": np.array([0.5, 1.0])},
    "domain": {"left": -5.0, "cells": np.int64(40)},
    "time": {"end": 0.2, "snapshots": 3},
}


def test_all_forms_of_a_case(tmp_path):
    """A path, a `Case` and the tables of a file give the same runs, sweeps and changed cases."""
    path = tmp_path / "case.toml"
    path.write_text(
        '[erosion]\nlaw = "rational"\n[profile]\nkind = "kinks"\npositions = [-3.0, -2.0]\namplitudes = [0.5, 1.0]\n'
        "[domain]\nleft = -5.0\ncells = 40\n[time]\nend = 0.2\nsnapshots = 3\n"
    )
    runs = [hj.solve_case(case) for case in (path, TABLES, hj.load_case(path), hj.load_case(TABLES))]
    assert all(np.array_equal(run.u, runs[0].u) for run in runs)
    for case in (path, TABLES, hj.load_case(path)):
        assert hj.load_case(case, {"time.end": 0.1}).problem.end == 0.1
        found = hj.sweep(case, {"domain.cells": [20, 30]}, folder=tmp_path / "swept")
        assert [outcome.status for outcome in found.outcomes] == ["done", "done"]
    assert isinstance(TABLES["profile"]["positions"], tuple)  # the tables are not changed


def test_a_survey_keeps_its_supplied_volume():
    """A `Case` with `supplied` states it again when it is changed."""
    case = hj.load_case("hillslope", {"time.supplied": 10_000.0})
    changed = hj.load_case(case, {"profile.length": 100.0, "domain.left": -26.0})
    assert changed.supplied == 10_000.0 and changed.problem.end == pytest.approx(4.0 * case.problem.end)


@pytest.mark.parametrize("case", [3, None, [1], {}, {"a": 1}, {3: 4}, {"erosion": {4: 1}}, "no such case"])
def test_what_is_no_case(case):
    for use in (hj.solve_case, hj.load_case, hj.check, lambda case: hj.sweep(case, {"domain.cells": [20]})):
        with pytest.raises(hj.InputError):
            use(case)
