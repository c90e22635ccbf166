"""The 2x2 model with a rolling layer (1.6) and its limit: exact solutions, a resolved solution, rates, positivity."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from bad_cases import changed
from grid_methods import LAYER_METHOD, scheme_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracles import resolved_layer

import hjprofile as hj
from hjprofile.problem.case import load_case, parse_case, resolved_case
from hjprofile.problem.identity import identity
from hjprofile.solvers.closed_forms import kink_into_steady_slope, steady_slope
from hjprofile.solvers.grids.march import march
from hjprofile.solvers.layer.layer_scheme import WithLayer
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.solve import solve_case

T2 = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5])
KINK = hj.kinks([-6.0], [1.0])
SMALL = hj.bumps([0.8, -0.4], [-2.4, -1.2], [0.4, 0.3])
FLUX = 0.5


def below_layer(profile, supply_flux, end, cells, left):
    problem = hj.Problem(hj.rational(), profile, end=end, snapshots=2, supply_flux=supply_flux)
    return hj.solve_conservative(problem, hj.Grid(left, cells), LAYER_METHOD)


def with_steady_layer(kink, supply_flux, cells):
    """Errors of u and q on the steady slope at t = 0.5; the layer is that of the exact solution from the start.

    H = 1 - a - a x there. Left of the kink it may be anything, for at the critical slope nothing is exchanged.
    """
    grid = hj.Grid(-2.0, cells)
    problem = hj.Problem(hj.rational(), hj.steady(FLUX, kink), end=0.5, snapshots=2, supply_flux=supply_flux)
    scheme = scheme_of(problem, grid, LAYER_METHOD)
    scheme.H[:] = np.where(grid.centres < (kink or -np.inf), 0.3, 1.0 - FLUX - FLUX * grid.centres)
    record = march(scheme, problem, grid, 0.9)
    assert record.stop is None
    exact = kink_into_steady_slope(problem.law, FLUX, kink) if kink else steady_slope(problem.law, FLUX)
    off = np.abs(record.W[-1] + grid.nodes - exact.u(0.5, grid.nodes)).max()
    return off, grid.dx * np.abs(record.q[-1] - exact.q_means(0.5, grid)).sum()


@pytest.mark.parametrize("supply_flux", [2.0, 0.5, 0.05])
def test_the_steady_slope_is_steady_below_any_layer(supply_flux):
    """p = (1 - a x)/(1 - a - a x), H = 1 - a - a x solves (1.6) for every supply flux; the scheme is first order."""
    cells = (250, 500, 1000)
    u, q = zip(*(with_steady_layer(None, supply_flux, n) for n in cells), strict=True)
    assert 0.9 <= hj.observed_order(cells, u) <= 1.1 and 0.9 <= hj.observed_order(cells, q) <= 1.1
    assert u[-1] <= 1.5e-4 and q[-1] <= 2.5e-4  # measured 1.1e-4 and 1.8e-4 at most


@pytest.mark.parametrize("supply_flux", [2.0, 0.5, 0.05, 0.001])
def test_the_kink_into_the_steady_slope_takes_the_same_path_below_any_layer(supply_flux):
    """Rankine-Hugoniot for p with p = 1 on the left: s' = H(s⁺), the same path for every supply flux (§5f)."""
    cells = (250, 500, 1000, 2000)
    u, q = zip(*(with_steady_layer(-1.0, supply_flux, n) for n in cells), strict=True)
    # 0.96 to 1.09 measured: the place of the kink in its cell makes the error of q jitter
    assert 0.9 <= hj.observed_order(cells, u) <= 1.15 and 0.9 <= hj.observed_order(cells, q) <= 1.15
    assert u[-1] <= 5e-4 and q[-1] <= 1e-3  # measured 3.2e-4 and 6.3e-4 at most


SUPPLIES = {  # a case, and the same as a function of floats
    "constant": (0.2, lambda t: 0.2),
    "thin": (0.05, lambda t: 0.05),
    "waves": ("0.2*(1 + 0.9*sin(8*t))", lambda t: 0.2 * (1 + 0.9 * math.sin(8 * t))),
    "dries up": (lambda t: 0.3 * np.exp(-3.0 * t), lambda t: 0.3 * math.exp(-3.0 * t)),
}


SLOW = [pytest.param(*case, marks=pytest.mark.slow) for case in (("constant", 2.0), ("thin", 0.6), ("dries up", 1.0))]


@pytest.mark.parametrize(("supply", "end"), [("waves", 1.0), *SLOW])
def test_the_resolved_model_is_approached(supply, end):
    """Against second-order steps that resolve the fast time of (1.6), in its own variables."""
    supply_flux, of_mass = SUPPLIES[supply]
    left, cells, fine = -4.0, (100, 200, 400), 800
    q, h = resolved_layer(SMALL.q_means(hj.Grid(left, fine), hj.rational()), left, of_mass, end)
    off, layers = [], []
    for n in cells:
        run = below_layer(SMALL, supply_flux, end, n, left)
        off.append(-left / n * np.abs(run.q[-1] - q.reshape(n, -1).mean(axis=1)).sum())
        layer = of_mass(end) * run.K[-1, :-1] / (1 + run.q[-1])
        layers.append(np.abs(layer - h.reshape(n, -1).mean(axis=1)).sum() / np.abs(h).sum() * fine / n)
    assert 0.88 <= hj.observed_order(cells, off) <= 1.1  # measured 0.99, 0.94, 0.92 and 1.01
    assert 0.9 <= hj.observed_order(cells, layers) <= 1.15  # measured 1.01, 1.10, 0.98 and 0.93
    # measured 0.013 of ∫|q| = 0.78, and 0.0056 of ∫h; waves of the layer are damped on the grid, 0.019
    assert off[-1] <= 0.015 and layers[-1] <= (0.025 if supply == "waves" else 0.007)


def test_a_changing_supply_runs_down_a_neutral_slope():
    """Grains move with the speed 1 in the physical time T, dT = dt/ε(t), so K(t, x) = ε(t')/ε(t) with T(t') = T(t) + x.

    With ε = a/(1 + t), T = (t + t²/2)/a, and the sum of the lengths of all time steps is T to rounding.
    """
    a, t, cells, off = 0.3, 2.0, (200, 400, 800), []
    supply = hj.Problem(hj.rational(), KINK, t, supply_flux=f"{a}/(1 + t)").supply
    assert np.sum(0.02 / supply.means(0.0, 0.02, 100)) == pytest.approx((t + 0.5 * t**2) / a, rel=1e-14)
    for n in cells:
        run = below_layer(hj.profile(lambda x: x), f"{a}/(1 + t)", t, n, -3.0)
        off.append(np.abs(run.K[-1] - (1 + t) / np.sqrt((1 + t) ** 2 + 2 * a * run.x)).max())
        assert np.all(run.q == 0.0)
    assert 0.9 <= hj.observed_order(cells, off) <= 1.6 and off[-1] <= 5e-4  # measured 1.4 and 3.4e-4, of K = 1.1


HISTORIES = {  # of a similar size: constant, in pulses, most of it early
    "constant": "{e}",
    "pulses": "{e}*(1 + 0.9*sin(6*t))",
    "early": "{e}*2*exp(-t)",
}


@pytest.mark.parametrize(("profile", "end"), [(T2, 2.0), (KINK, 3.0)], ids=["births", "kink"])
def test_the_limit_depends_on_the_supplied_mass_and_not_on_its_history(profile, end):
    """Amadori and Shen (2011). All histories have the distance O(ε) from one limit, and so have two from each other."""
    sizes, grid = [0.02, 0.01, 0.005, 0.0025], hj.Grid(-10.0, 500)
    problem = hj.Problem(hj.rational(), profile, end=end, snapshots=1)
    slopes = {}
    for name, text in HISTORIES.items():
        fluxes = [text.format(e=e) for e in sizes]
        _, *thin = hj.slow_erosion(problem, grid, fluxes)
        assert [str(d.supply_flux) for d in thin] == [repr(flux) for flux in fluxes]
        for found in ("slope_l1", "height_sup"):
            distances = [getattr(d, found) for d in thin]
            assert 0.93 <= hj.observed_order([1 / e for e in sizes], distances) <= 1.1  # measured 0.96 to 1.08
        slopes[name] = [below_layer(profile, flux, end, 500, -10.0).q[-1] for flux in fluxes]
    for one, other in (("constant", "pulses"), ("pulses", "early"), ("early", "constant")):
        apart = [grid.dx * np.abs(a - b).sum() for a, b in zip(slopes[one], slopes[other], strict=True)]
        # eightfold thinner layers; measured a 4.9th to an 8.4th. Pulses of period 1 are not short of the lag at first
        assert apart[-1] <= apart[0] / 4.5 and apart[-1] <= 0.02


@pytest.mark.parametrize(("profile", "end"), [(T2, 0.5), (KINK, 3.0), (T2, 2.0)], ids=["smooth", "kink", "births"])
def test_slow_erosion_is_approached_at_first_order(profile, end):
    """p - 1 tends to q as the layer gets thin: from 0.05 to 0.005, order 1 on each grid, with the same distances."""
    supply_fluxes = [0.05, 0.02, 0.01, 0.005]
    problem, last = hj.Problem(hj.rational(), profile, end=end, snapshots=1), []
    for cells in (500, 1000):
        limit, *thin = hj.slow_erosion(problem, hj.Grid(-10.0, cells), supply_fluxes)
        for name in ("slope_l1", "height_sup"):
            order = hj.observed_order([1 / d.supply_flux for d in thin], [getattr(d, name) for d in thin])
            assert 0.95 <= order <= 1.05  # measured 0.969 to 1.004
        last.append(thin[-1].slope_l1)
        # the slow CFL number alone decides: 0.98 to 1.17 times as many steps, however thin the layer
        assert max(d.steps for d in thin) <= 1.2 * limit.steps
    assert last[1] == pytest.approx(last[0], rel=0.03)  # measured 0.2 to 2.6 %: the distance is not the grid's


def test_the_departure_is_that_of_all_saved_times():
    """At the end the kink has left below either, and both slopes are critical."""
    problem = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=4.0, snapshots=9)
    limit, thin = hj.slow_erosion(problem, hj.Grid(-2.0, 100), [0.1])
    assert limit.slope_l1 == 0.0 and thin.slope_l1 > 0.02


@pytest.mark.parametrize("profile", [T2, KINK], ids=["smooth", "kink"])
def test_a_vanishing_layer_is_the_limit_step_for_step(profile):
    """With ε = 1e-14 each step is that of the telescoping scheme for (1.1); with 1e-300 too, as nothing is divided."""
    grid, problem = hj.Grid(-10.0, 400), hj.Problem(hj.rational(), profile, end=1.0)
    limit = scheme_of(problem, grid, LAYER_METHOD)
    thin = [scheme_of(replace(problem, supply_flux=e), grid, LAYER_METHOD) for e in (1e-14, 1e-300)]
    dt = 0.5 * grid.dx / limit.evaluate()
    for scheme in (limit, *thin):
        scheme.advance(dt, 64, np.inf)
        scheme.evaluate()
    assert not isinstance(limit, WithLayer)
    for scheme in thin:
        assert np.abs(scheme.q - limit.q).max() <= 1e-12
        # K is that of the last step in the one and of q now in the other: a kink has moved by half a cell, and the
        # exponential differs from its second-order factor (measured 0.011)
        assert np.abs(scheme.K - limit.K).max() <= 0.02
        assert abs(scheme.toe_gain - limit.toe_gain) <= 1e-11


def test_a_critical_slope_stays_critical():
    flat = below_layer(hj.profile(lambda x: x), 0.3, 2.0, 100, -3.0)
    assert np.all(flat.q == 0.0) and np.all(flat.u == flat.u[0])
    # the layer runs in at the speed p = 1, in the fast time: it is there, and 1 thick, at t = 0.3 * 3
    assert np.abs(flat.K[-1] - 1.0).max() <= 1e-4


def profiles(least):
    values = st.lists(st.floats(least, 6.0), min_size=1, max_size=6)
    return values.map(lambda q: hj.steps(np.linspace(-4.0, -0.3, len(q) + 1), q))


def fluxes():
    """Numbers, pulses of any period, and supplies that grow or fall a thousandfold, at once or not."""
    sizes = st.floats(-3.0, 0.6).map(lambda decades: 10.0**decades)
    pulses = st.tuples(sizes, st.floats(0.0, 0.99), st.floats(0.1, 200.0)).map(
        lambda p: f"{p[0]!r}*(1 + {p[1]!r}*sin({p[2]!r}*t))"
    )
    falls = st.tuples(sizes, st.floats(-5.0, 5.0)).map(lambda p: f"{p[0]!r}*exp({p[1]!r}*t)")
    jumps = st.tuples(sizes, sizes).map(lambda p: lambda t: np.where(t < 0.7, *p))
    return st.one_of(sizes, pulses, falls, jumps)


@settings(max_examples=40, deadline=None)
@given(profiles(-0.9), fluxes(), st.floats(0.2, 1.0))
@example(hj.steps([-4.0, -0.3], [-0.00390625]), "1.0*exp(-3.0*t)", 1.0)
def test_layer_and_slope_stay_positive_and_grains_are_kept(profile, supply_flux, cfl):
    """h > 0 and p > 0 for any supply flux; mass and grains to rounding, signs and the L1 norm as they should."""
    problem = hj.Problem(hj.rational(), profile, end=1.5, snapshots=4, supply_flux=supply_flux)
    run = hj.solve_conservative(problem, hj.Grid(-4.5, 90), LAYER_METHOD, cfl)
    assert run.done and run.broken_bounds == []
    assert np.all(run.q > -1.0) and np.all(run.K[1:] > 0.0)
    # not a theorem for (1.6), but with a constant or rising supply no slope ever fell below the least. With a falling
    # one the scheme falls below it, by 2 % at most in 3664 random scenes; in the four worst by less on finer grids, and
    # in the worst of all the resolved model does not
    flux, least = problem.supply_flux, min(run.q[0].min(), 0.0)
    rises = isinstance(flux, float) or np.all(np.diff(flux.values(np.linspace(0.0, problem.end, 301))) >= 0.0)
    assert run.q.min() >= least - 1e-12 - (0.0 if rises else 0.05 * abs(least))
    grains = run.eroded_volume + problem.end
    assert run.volume_budget_error <= 1e-11 * (1.0 + grains)


def test_only_what_is_true_of_the_2x2_model_is_watched():
    run = below_layer(SMALL, 0.1, 0.5, 100, -4.0)
    assert set(run.bounds) == {"mass_budget", "volume_budget", "l1_decay"}
    assert set(below_layer(KINK, 0.1, 0.5, 100, -8.0).bounds) == {*run.bounds, "signs"}


@pytest.mark.parametrize("method", [m for m in METHODS if m != LAYER_METHOD])
def test_other_methods_refuse_a_layer(method, tmp_path):
    content = changed({"layer": {"supply_flux": 0.1}, "solver": {"method": method}})
    if method == "auto":
        content["solver"]["tolerance"] = 1e-3
    case = parse_case(content, "scene", "scene.toml", tmp_path)
    with pytest.raises(
        hj.InputError, match=r"^scene.toml: \[solver\] .* a rolling layer; methods that do: conservative-telescoping"
    ):
        solve_case(case)


def test_evidence_about_the_limit_refuses_a_layer_in_a_sentence():
    problem, grid = hj.Problem(hj.rational(), KINK, end=1.0, supply_flux=0.1), hj.Grid(-8.0, 100)
    from hjprofile.studies.chart import chart_of
    from hjprofile.studies.stability import scan

    for call in (hj.check_consistency, lambda p, g: chart_of("one", p, g), lambda p, g: scan("one", p, g)):
        with pytest.raises(hj.InputError, match="does not take a rolling layer"):
            call(problem, grid)


def test_bad_layers():
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(hj.InputError, match=r"supply_flux = .* must be a number, 0 or more"):
            hj.Problem(hj.rational(), KINK, end=1.0, supply_flux=wrong)
    with pytest.raises(hj.InputError, match=r"supply_flux = 0.1 needs the law 'rational', not 'log'"):
        hj.Problem(hj.log(), KINK, end=1.0, supply_flux=0.1)


def test_in_a_case_file(tmp_path):
    content = changed({"layer": {"supply_flux": 0.1 + 0.2}, "solver.method": LAYER_METHOD})
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(content))
    case = load_case(tmp_path / "scene.toml")
    assert case.problem.supply_flux == 0.1 + 0.2
    resolved = resolved_case(case.problem, case.grid, case.method)
    assert parse_case(resolved, "again", "again", tmp_path).problem.supply_flux == 0.1 + 0.2
    assert solve_case(case).case == resolved
    assert "layer" not in resolved_case(replace(case.problem, supply_flux=0.0), case.grid, "godunov")
    for wrong, words in (
        ({"supply_flux": "thin"}, "supply_flux = 'thin' contains 'thin'; allowed are numbers, t, "),
        ({"supply_flux": True}, "must be a finite number or an expression in t"),
        ({"supply_flux": "0.1 - t"}, r"supply_flux = -0.9 at t = 1 is not a positive number from 1e-100 to 1e\+06"),
        ({"supply_flux": "0"}, "supply_flux = 0 at t = 0 is not a positive number"),
        ({"height": 1.0}, "not a known key"),
    ):
        with pytest.raises(hj.InputError, match=rf"scene: \[layer\] .*{words}"):
            parse_case(content | {"layer": wrong}, "scene", "scene", tmp_path)
    with pytest.raises(hj.InputError, match=r"scene: \[layer\] supply_flux = 0.3 needs the law 'rational'"):
        parse_case(content | {"erosion": {"law": "log"}}, "scene", "scene", tmp_path)


def test_the_first_grains_run_down_the_slope_as_it_was():
    """With the speed p/ε, p = 1 + e^-(x+6): they reach -6 at ε ln((1 + e⁶)/2). A grid smears them by about √dx."""
    supply_flux = 0.5
    exact = supply_flux * np.log(0.5 * (1.0 + np.exp(6.0)))
    early = []
    for cells in (1000, 4000):
        problem = hj.Problem(
            hj.rational(), KINK, 1.1 * exact, np.linspace(0.5, 1.1, 61) * exact, supply_flux=supply_flux
        )
        run = hj.solve_conservative(problem, hj.Grid(-10.0, cells), LAYER_METHOD)
        flux = run.K[:, np.searchsorted(run.x, -6.0)]
        early.append(exact - np.interp(0.05, flux, run.time))
    assert 0.0 < early[1] < 0.6 * early[0] < 0.1 * exact  # measured 0.17 and 0.34, of 2.65


def test_a_constant_expression_is_the_number():
    number, text = (below_layer(T2, flux, 1.0, 200, -10.0) for flux in (0.1, "0.1 + 0*t"))
    assert np.abs(number.u - text.u).max() <= 1e-12 and np.abs(number.K - text.K).max() <= 1e-12


PYTHON = "import numpy as np\ndef supply(t):\n    return 0.1*(1 + 0.9*np.sin(20*t))\n"


def test_a_function_of_the_supplied_mass(tmp_path):
    """As text, as a function, and in a file: the same run, and the case that is stored makes it again."""
    (tmp_path / "supply.py").write_text(PYTHON)
    of_file = {"file": "supply.py", "function": "supply"}
    content = changed({"layer": of_file, "solver.method": LAYER_METHOD})
    case = parse_case(content, "scene", "scene.toml", tmp_path)
    run = solve_case(case)
    assert run.done and run.case["layer"] == of_file
    text = "0.1*(1 + 0.9*sin(20*t))"
    written = parse_case(content | {"layer": {"supply_flux": f" {text} "}}, "scene", "scene.toml", tmp_path)
    assert resolved_case(written.problem, written.grid, LAYER_METHOD)["layer"] == {"supply_flux": text}
    single = replace(case.problem, supply_flux=lambda t: 0.1 * (1 + 0.9 * math.sin(20 * t)))  # of single numbers
    for other in (written.problem, single):
        assert np.abs(hj.solve_conservative(other, case.grid, LAYER_METHOD).u - run.u).max() <= 1e-13
    for wrong in ({"file": "supply.py"}, {"function": "supply"}, of_file | {"supply_flux": 0.1}):
        with pytest.raises(hj.InputError, match=r"\[layer\] a supply flux is either supply_flux, or file and function"):
            parse_case(content | {"layer": wrong}, "scene", "scene.toml", tmp_path)
    with pytest.raises(hj.InputError, match=r"\[layer\] function = 'flood' is not defined in supply.py"):
        parse_case(content | {"layer": of_file | {"function": "flood"}}, "scene", "scene.toml", tmp_path)


def test_a_changed_file_is_another_case(tmp_path):
    """A checkpoint of a run under one history is not continued under another."""
    (tmp_path / "supply.py").write_text(PYTHON)
    content = changed({"layer": {"file": "supply.py", "function": "supply"}, "solver.method": LAYER_METHOD})
    before = identity(parse_case(content, "scene", "scene.toml", tmp_path))
    assert before == identity(parse_case(content, "scene", "scene.toml", tmp_path))
    (tmp_path / "supply.py").write_text(PYTHON.replace("0.9", "0.8"))
    assert before["data"] != identity(parse_case(content, "scene", "scene.toml", tmp_path))["data"]
    of_data = "import numpy as np\ndef supply(t):\n    return np.interp(t, *np.loadtxt(NAME))\n"
    of_data = of_data.replace("NAME", repr(str(tmp_path / "flux.txt")))
    (tmp_path / "supply.py").write_text(of_data)
    found = []
    for flux in ("0.1 0.2", "0.1 0.3"):
        (tmp_path / "flux.txt").write_text(f"0 2\n{flux}\n")
        found.append(identity(parse_case(content, "scene", "scene.toml", tmp_path))["data"])
    assert found[0] != found[1]


def test_a_supply_that_fails_on_the_way_stops_the_run():
    """It is positive at both ends; the states before are returned."""
    problem = hj.Problem(hj.rational(), KINK, 2.0, 5, supply_flux="(t - 1)**2 - 0.01")
    run = hj.solve_conservative(problem, hj.Grid(-8.0, 100), LAYER_METHOD)
    assert not run.done and 0.85 < run.time[-1] < 0.9 and run.broken_bounds == []
    assert re.search(r"supply_flux = \S+ at t = 0\.9\S* is not a positive number", run.status)
    assert run.status.startswith("stopped at t = 0.8")

    def broken(t):
        raise KeyError("rain")

    problem = replace(problem, supply_flux=broken)
    with pytest.raises(hj.InputError, match="the supply flux cannot be evaluated: KeyError: 'rain'"):
        hj.solve_conservative(problem, hj.Grid(-8.0, 100), LAYER_METHOD)


def test_a_sweep_over_histories():
    found = hj.sweep("thin_layer", {"layer.supply_flux": [0.05, "0.05*(1 + 0.9*sin(6*t))"], "domain.cells": [100]})
    assert [outcome.status for outcome in found.outcomes] == ["done", "done"]
    volumes = [outcome.quantities["eroded_volume"] for outcome in found.outcomes]
    assert 1e-3 < abs(volumes[0] - volumes[1]) < 0.2
