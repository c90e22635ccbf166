"""Norms of a run against closed forms and an independent evaluation; their bounds; the uniform bound on random data."""

import csv
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from random_steps import ROUNDING, increases, random_problem, variation_of

import hjprofile as hj
from hjprofile.solvers.norms import inverse_of_R

LAWS = {  # f and R = q/f(q) again, by formulas of their own
    "rational": (hj.rational(), lambda q: q / (1 + q), lambda q: 1 + q),
    "log": (hj.log(), np.log1p, lambda q: np.divide(q, np.log1p(q), out=1 + q / 2, where=np.abs(q) > 1e-8)),
    "power": (hj.power(2.0), lambda q: (1 - (1 + q) ** -2) / 2, lambda q: 2 * (1 + q) ** 2 / (2 + q)),
}
SLOPE = {"x": [-6.0, -4.0, -4.0, -2.0, -1.0], "q": [0.0, 0.5, -0.4, 0.8, 0.0]}


def columns_of(file):
    with open(file, newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def independent(folder, f, R):
    """The table again from profile.nc, cell by cell in plain Python."""
    from scipy.io import netcdf_file

    with netcdf_file(folder / "profile.nc", mmap=False) as file:
        time, x, u, q, K = (file.variables[n][:].astype(float) for n in ("time", "x", "u", "q", "K"))
    found = {n: [] for n in ("time", "l1", "tv", "inf_q", "sup_q", "sup_F", "tv_F", "tv_I", "K_left")}
    for n, t in enumerate(time):
        before_q = before_F = 0.0
        before_I = float(R(np.zeros(1))[0]) + u[n, 0] - x[0]
        l1 = tv = tv_F = tv_I = sup_F = 0.0
        for i in range(q.shape[1]):
            value = q[n, i]
            F = 0.5 * (K[n, i] + K[n, i + 1]) * float(f(value))
            I = float(R(np.array([value]))[0]) + 0.5 * (u[n, i] - x[i] + u[n, i + 1] - x[i + 1])
            l1 += abs(value) * (x[i + 1] - x[i])
            tv, tv_F, tv_I = tv + abs(value - before_q), tv_F + abs(F - before_F), tv_I + abs(I - before_I)
            sup_F = max(sup_F, abs(F))
            before_q, before_F, before_I = value, F, I
        row = (t, l1, tv, q[n].min(), q[n].max(), sup_F, tv_F, tv_I, K[n, 0])
        for name, value in zip(found, row, strict=True):
            found[name].append(value)
    return {name: np.array(values) for name, values in found.items()}


@pytest.mark.parametrize("method", ["godunov", "conservative", "fronts", "characteristics"])
@pytest.mark.parametrize("law", LAWS)
def test_the_table_agrees_with_an_independent_evaluation(law, method, tmp_path):
    law, f, R = LAWS[law]
    problem = hj.Problem(law, hj.points(**SLOPE), end=1.5, snapshots=4)
    grid = hj.Grid(-7.0, 300)
    if method in ("fronts", "characteristics"):
        run = (hj.track_fronts if method == "fronts" else hj.solve_characteristics)(problem, grid)
    else:
        run = (hj.solve_conservative if method == "conservative" else hj.solve_hj)(problem, grid, method)
    hj.write_run(run, tmp_path, vtk=False, plots=False)
    stored, again = columns_of(tmp_path / "norms.csv"), independent(tmp_path, f, R)
    assert list(stored) == list(again)
    for name, values in again.items():
        # rounding of sums; u and x are stored to 1e-16, and W is their difference
        assert stored[name] == pytest.approx(values, rel=1e-10, abs=1e-10), name
    summary = json.loads((tmp_path / "summary.json").read_text())
    for key, index in (("norms_start", 0), ("norms_end", -1)):
        of_q = {"l1": "l1", "tv": "tv", "inf": "inf_q", "sup": "sup_q"}
        assert summary[key] == {short: stored[name][index] for short, name in of_q.items()}
    assert hj.load_run(tmp_path).norms.tv_I == pytest.approx(stored["tv_I"], rel=1e-12)


def test_norms_of_a_travelling_kink():
    """§5a: q = A e^{-(x-s)} right of s, so every norm is known; first order in dx, because a cell has one value."""
    A, s0 = 1.5, -3.0
    errors = []
    for cells in (250, 1000, 4000):
        problem = hj.Problem(hj.rational(), hj.kinks([s0], [A]), end=1.0, snapshots=3)
        run = hj.track_fronts(problem, hj.Grid(-5.0, cells))
        s = np.array([k.x for k in run.kinks])
        crest = A * np.exp(s)
        exact = {
            "l1": A - crest,
            "tv": A + (A - crest),
            "inf_q": 0.0 * s,
            "sup_q": A + 0.0 * s,
            "sup_F": A / (1.0 + crest),  # K = (1 + q)/(1 + q(0)), so F = q/(1 + q(0))
            "tv_F": (2.0 * A - crest) / (1.0 + crest),
            "tv_I": A + 0.0 * s,
            "K_left": 1.0 / (1.0 + crest),
        }
        K_at_kink = (1.0 + A) / (1.0 + crest)
        exact["K_left"] = K_at_kink  # q = 0 left of the kink, so K is that at the kink
        errors.append(max(float(np.abs(getattr(run.norms, n) - v).max()) for n, v in exact.items()))
    assert 0.8 < np.log(errors[0] / errors[2]) / np.log(16.0) < 1.3
    assert errors[2] < 6.0 / 4000 * 5.0  # a cell times the largest slope of F


def test_the_bounds_of_the_norms():
    """Three kinks become one, whose amplitude 2.5511 is the bound; two kinks: TV(q) <= 3.084, and 12 by growth."""
    problem = hj.Problem(hj.rational(), hj.kinks([-9.0, -8.5, -8.0], [0.3, 0.8, 1.6]), end=8.0, snapshots=9)
    run = hj.track_fronts(problem, hj.Grid(-10.0, 4000))
    (limit,) = run.norm_limits["sup_q"]
    assert limit.values[0] == pytest.approx(run.norms.sup_q.max(), abs=0.01)  # a cell is 0.0025 wide
    case = hj.load_case("two_kinks")
    run = hj.track_fronts(case.problem, case.grid)
    uniform, growing = run.norm_limits["tv"]
    assert uniform.values[-1] == pytest.approx(3.084, abs=2e-3) and growing.values[-1] == pytest.approx(12.1, abs=0.2)
    assert np.all(run.norms.tv <= uniform.values) and np.all(run.norms.tv <= growing.values)
    assert inverse_of_R(hj.log(), float(hj.log().R(7.0))) == pytest.approx(7.0, rel=1e-12)
    assert inverse_of_R(hj.log(), 0.5) == 0.0


def test_the_hillslope_has_a_bound_that_does_not_grow():
    """The measured variation, the uniform bound and the growing one until the slope is straight: 10.2, 21.2, 29.5."""
    case = hj.load_case("hillslope", {"time.end": 31.0, "time.snapshots": 400})
    run = hj.solve_hj(case.problem, case.grid, "godunov")
    uniform, growing = run.norm_limits["tv"]
    assert run.norms.tv.max() == pytest.approx(10.2, abs=0.1)
    assert uniform.values[-1] == pytest.approx(21.2, abs=0.1)
    assert growing.values[-1] == pytest.approx(29.5, abs=0.5)
    assert run.bounds["uniform_tv"].holds


LAYER = {"layer": {"supply_flux": 0.05}}
MODELS = {  # a case -> the norms that have a bound in it
    "plain": ({}, {"l1", "inf_q", "sup_q", "K_left", "tv", "tv_I"}),
    "inflow": ({"profile": {"kind": "steady", "flux": 0.4}}, {"inf_q"}),
    "coefficient": ({"coefficient": {"kind": "expression", "expression": "exp(-0.1*x)"}}, {"l1"}),
    "refresh": ({"solver": {"method": "godunov", "refresh": 0.1}}, {"l1"}),
    "layer": (LAYER | {"solver": {"method": "conservative-telescoping"}}, {"l1"}),
    "linear growth": (
        {"erosion": {"law": "expression", "expression": "q/2 + q/(2*(1+q))", "growth": "linear"},
         "solver": {"method": "telescoping"}},
        {"l1", "inf_q", "K_left"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_bounds_are_stated_only_where_they_are_proved(name):
    from hjprofile.problem.case import parse_case
    from hjprofile.solvers.solve import solve_case

    changes, known = MODELS[name]
    base = {
        "erosion": {"law": "rational"}, "profile": {"kind": "points", **SLOPE}, "domain": {"left": -7.0, "cells": 140},
        "time": {"end": 0.5, "snapshots": 6}, "solver": {"method": "godunov"},
    }  # fmt: skip
    run = solve_case(parse_case(base | changes, name, name, Path()))
    assert run.done and set(run.norm_limits) == known
    assert all(np.isfinite(values).all() for values in run.norms)
    slack = 1e-9 + 0.1 * (7.0 / 140)  # of first order: a tenth of a cell's width
    for column, bounds in run.norm_limits.items():
        value = getattr(run.norms, column)
        for bound in bounds:
            below = column == "inf_q" or bound.name.startswith("exp(-")
            assert np.all(value >= bound.values - slack if below else value <= bound.values + slack), (column, bound)


def test_a_run_sent_to_another_process_keeps_its_norms():
    def f(q):
        return q / (1.0 + q)

    problem = hj.Problem(hj.erosion_law(f), hj.points(**SLOPE), end=0.5, snapshots=3)
    run = hj.solve_hj(problem, hj.Grid(-7.0, 100), "godunov")
    sent = pickle.loads(pickle.dumps(run))
    assert all(np.array_equal(a, b) for a, b in zip(sent.norms, run.norms, strict=True))
    assert sent.norm_limits.keys() == run.norm_limits.keys() and "sup_q" in sent.norm_limits


def test_norms_of_a_stored_run_with_a_law_in_a_python_file(tmp_path):
    case = hj.load_case("user_law", {"domain.cells": 100})
    run = hj.solve_case(case)
    assert np.isfinite(run.norms.tv_I).all()
    hj.write_run(run, tmp_path, vtk=False, plots=False)
    stored = hj.load_run(tmp_path)
    assert np.array_equal(stored.norms.l1, run.norms.l1) and np.isnan(stored.norms.tv_I).all()
    assert columns_of(tmp_path / "norms.csv")["tv_I"] == pytest.approx(run.norms.tv_I)


UNIFORM = "godunov", "telescoping", "local-lax-friedrichs", "lax-friedrichs", "eno2"


@pytest.mark.parametrize("method", UNIFORM[:3])
def test_the_variation_of_I_never_exceeds_its_start_on_random_data(method):
    seeds = range(2000, 2015)
    above, _, held = increases(method, seeds).T
    assert above.size == len(seeds) and above.max() <= ROUNDING and held.all()


@pytest.mark.slow
@pytest.mark.parametrize("method", UNIFORM)
def test_the_variation_of_I_on_1000_random_data(method):
    """Godunov and telescoping decrease it from one time to the next too, in 999 of 1000 cases."""
    above, between, held = increases(method, range(1000)).T
    assert above.size == 1000 and above.max() <= ROUNDING and held.all()
    if method in ("godunov", "telescoping"):
        assert np.count_nonzero(between > ROUNDING) == 1


def test_upwind_with_K_summed_by_rectangles_transports_I_exactly():
    """Theorem 4 of docs/theory.md, on 300 random profiles: no time step raises TV(I), except by rounding."""
    rng = np.random.default_rng(5)
    for _ in range(300):
        n, dx = int(rng.integers(5, 80)), 10.0 ** rng.uniform(-3.0, -0.5)
        q = np.append(0.0, np.exp(rng.uniform(np.log(0.05), np.log(20.0), n)) - 1.0)  # q in (-0.95, 19)
        W = np.append(0.0, np.cumsum(dx * q))
        for _ in range(12):
            f = q / (1.0 + q)
            if np.any(1.0 + dx * f <= 0.0):  # a cell too wide for the rectangle rule
                break
            K = np.append(np.cumprod((1.0 + dx * f)[::-1])[::-1], 1.0)  # K_{i-1} = K_i (1 + dx f(q_i))
            I = W[1:] + 1.0 + q
            right = np.append(q[1:], q[-1])
            dt = dx / np.max(K[1:] * np.maximum(1.0 / ((1.0 + q) * (1.0 + np.roll(q, 1))), 1.0 / (1.0 + q) ** 2))
            dt = min(dt, dx / np.max(K[1:] / ((1.0 + q) * (1.0 + right))))
            W = W - dt * np.append(0.0, K[1:] * f)
            q = np.diff(W) / dx
            after = W[1:] + 1.0 + q
            before, later = (np.abs(np.diff(values, prepend=1.0)).sum() for values in (I, after))
            assert later <= before * (1.0 + 1e-12), (before, later)


@pytest.mark.parametrize("method", ["godunov", "telescoping"])
def test_a_deposit_of_constant_I(method):
    """The worst data: nothing but a fan and constant I. Godunov exceeds TV(I(0)) by its error, telescoping does not."""
    law, left, start, s = hj.rational(), -8.0, -0.55, -5.28  # s is a node of all grids
    for cells in (100, 400, 1600):
        grid = hj.Grid(left, cells)
        x = grid.nodes[grid.nodes > s + 1e-9]
        profile = hj.points(np.append(s, x), np.append(start, start * np.exp(s - x)))  # R'(q) q_x = -q
        run = hj.solve_hj(hj.Problem(law, profile, end=1.0, snapshots=50), grid, method)
        tv = variation_of(run, law)
        assert tv[0] == pytest.approx(-start, abs=grid.dx)
        excess = float((tv - tv[0]).max())
        assert run.bounds["uniform_tv"].holds
        if method == "telescoping":
            assert excess <= 1e-12
        else:  # measured: 0.02 to 0.16 of the allowance, dx (TV(q(0)) + TV(q(t)))
            assert 0.0 < excess <= 0.2 * 2.0 * grid.dx * run.norms.tv.max()


def test_fronts_and_characteristics_satisfy_the_uniform_bound():
    for seed in range(3000, 3025):
        problem, grid = random_problem(np.random.default_rng(seed), list(LAWS)[seed % 3])
        run = hj.track_fronts(problem, grid, fronts=400)
        assert run.bounds["uniform_tv"].holds, seed
        again = run.bounds["uniform_tv"]
        assert again.allowance == "first order in dx"
