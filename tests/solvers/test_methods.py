"""The table of methods: what a row says of a method is what the method does."""

import dataclasses
import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.method import Feature, Form, requirements
from hjprofile.solvers.methods import FLUXES, METHODS, find_method, named
from hjprofile.solvers.solve import check, check_case, solve_with

KINK = hj.kinks([-3.0], [0.5])
GRID, WINDOW = hj.Grid(-5.0, 60), hj.Grid(-5.0, 60, 1.0)
LINEAR = hj.expression("2 + q/2 - 2/(1+q)**0.25", growth="linear")
ASKING = {  # a problem that asks for one feature, its grid, and the refresh interval
    Feature.INFLOW: (hj.Problem(hj.rational(), hj.steady(0.3), end=0.1), GRID, None),
    Feature.COEFFICIENT: (hj.Problem(hj.rational(), KINK, end=0.1, coefficient=hj.coefficient("1 - x")), GRID, None),
    Feature.REFRESH: (hj.Problem(hj.rational(), KINK, end=0.1), GRID, 0.05),
    Feature.LAYER: (hj.Problem(hj.rational(), KINK, end=0.1, supply_flux=0.1), GRID, None),
    Feature.WHOLE_LINE: (hj.Problem(hj.rational(), KINK, end=0.1, line="whole"), WINDOW, None),
    Feature.LINEAR_GROWTH: (hj.Problem(LINEAR, KINK, end=0.1), GRID, None),
}


@pytest.mark.parametrize("feature", Feature)
def test_a_problem_asks_for_what_it_needs(feature):
    problem, _, refresh = ASKING[feature]
    assert requirements(problem, refresh) == {feature}
    assert requirements(hj.Problem(hj.rational(), KINK, end=0.1)) == frozenset()


@pytest.mark.parametrize("feature", Feature)
@pytest.mark.parametrize("method", METHODS)
def test_what_a_method_supports_it_solves_and_the_rest_it_refuses(method, feature):
    (problem, grid, refresh), row = ASKING[feature], METHODS[method]
    if feature not in row.supports:
        able = ", ".join(name for name, other in METHODS.items() if feature in other.supports)
        words = f"the method {method} does not take {feature.words}; methods that do: {able}"
        with pytest.raises(hj.InputError) as error:
            check(row, problem, grid, refresh)
        assert str(error.value) == words
        return
    if row.on_grid:
        run = solve_with(row, problem, grid, refresh=refresh)
    else:
        check(row, problem, grid, refresh)
        run = row.solve(problem, grid, 1e-3 if row.needs_tolerance else None, None)
    assert run.done and np.isfinite(run.u).all()


def test_a_refresh_goes_with_the_nonlocal_factor_on_the_half_line_only():
    for feature in (Feature.LAYER, Feature.WHOLE_LINE, Feature.LINEAR_GROWTH):
        problem = ASKING[feature][0]
        with pytest.raises(hj.InputError, match=r"refresh = 0\.05 cannot be combined with") as error:
            requirements(problem, 0.05)
        assert feature.words in str(error.value)


def test_rows_agree_with_each_other():
    assert [*named(Form.HEIGHT), *named(Form.SLOPE), *named(Form.OFF_GRID)] == [*METHODS]
    for name, row in METHODS.items():
        assert row.name == name and row.on_grid == (row.setup is not None) == (row.solve is None)
        assert set(row.variants) <= row.supports
        assert row.form is Form.SLOPE if row.carries else True
        if row.carries:
            assert METHODS[row.carries].form is Form.HEIGHT and METHODS[row.carries].flux is row.flux
        if row.flux:  # no proof allows more than the scheme takes
            assert row.cfl_proved <= row.flux.cfl_limit and row.flux is FLUXES[row.flux.name]
    with pytest.raises(dataclasses.FrozenInstanceError):
        METHODS["conservative"].name = "another"


@pytest.mark.parametrize("method", ["godunov", "fronts", "characteristics", "auto"])
def test_a_case_whose_profile_does_not_fit_its_grid_is_refused_by_every_method(method):
    tolerance = {"solver.tolerance": 1e-3} if METHODS[method].needs_tolerance else {}
    case = hj.load_case("travelling_kink", {"solver.method": method} | tolerance)
    with pytest.raises(hj.InputError, match="the profile reaches left to x = -6 but the domain begins at left = -2"):
        hj.solve_case(dataclasses.replace(case, grid=hj.Grid(-2.0, 100)))


@pytest.mark.parametrize("method", ["characteristics", "auto"])
def test_a_tolerance_may_be_the_least_and_the_largest_that_a_method_takes(method):
    least, most = METHODS[method].tolerance
    for tolerance, good in ((least, True), (most, True), (0.99 * least, False), (1.01 * most, False)):
        with nullcontext() if good else pytest.raises(hj.InputError, match=f"between {least:g} and {most:g}"):
            check_case(hj.load_case("travelling_kink", {"solver.method": method, "solver.tolerance": tolerance}))


def test_an_unknown_name_is_met_with_the_nearest():
    with pytest.raises(hj.InputError, match=r"'gudonov' is not known; did you mean 'godunov'\? \(allowed: lax"):
        find_method("gudonov")
    with pytest.raises(hj.InputError, match=r"method = 'weno5' is not known.*allowed: conservative, "):
        find_method("weno5", named(Form.SLOPE))


def test_a_flux_is_named_where_it_is_written_and_in_its_row():
    """Its twin, its row, and the method that sentences recommend: the kernel has a type of that name."""
    library = Path(hj.__file__).parent
    code = {path.name: re.sub(r'""".*?"""', "", path.read_text("utf-8"), flags=re.S) for path in library.rglob("*.py")}
    spelled = sorted(name for name, text in code.items() if "godunov" in text)
    assert spelled == ["conservation.py", "methods.py", "stop.py"]


def test_the_table_for_a_reader_has_the_orders_of_the_page_on_methods():
    """docs/methods.md states the order on smooth data; weno5 has 5 in space and 4 in time."""
    page = (Path(__file__).parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
    stated = dict(re.findall(r"^\| `([\w-]+)`(?: \(default\))? \| (?:height|slope) \| (?:4 to )?(\d) \|", page, re.M))
    rows = {row.name: row for row in hj.methods()}
    assert list(rows) == list(METHODS) and len(stated) >= 7
    assert {name: rows[name].order for name in stated} == {name: float(order) for name, order in stated.items()}
    assert all(rows[f"conservative-{name}"].order == rows[name].order for name in ("godunov", "eno2", "weno5"))
    head, *lines = repr(hj.methods()).splitlines()
    assert [line.split()[0] for line in lines] == list(METHODS) and head.split()[:2] == ["method", "form"]


def test_a_row_supports_what_the_method_accepts():
    problem = hj.Problem(hj.rational(), hj.steady(0.4), end=0.05, snapshots=2)  # a flux enters
    grid = hj.Grid(-1.0, 20)
    for row in hj.methods():
        if row.form == "height":
            assert "inflow" in row.supports and hj.solve_hj(problem, grid, row.name).done
    assert "inflow" not in {r.name: r for r in hj.methods()}["fronts"].supports
    with pytest.raises(hj.InputError, match="does not take"):
        hj.track_fronts(problem, grid)
