"""What a user holds is the user's: no array, list or function that is handed in or out can change what is solved."""

import pickle

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.problem.case import parse_case
from hjprofile.solvers.run_tables import FIELDS

GRID = hj.Grid(-6.0, 60)
X = np.array([-4.0, -3.0, -2.0])
Q = np.array([0.2, 0.4, 1.2])


def problem(profile=None, law=None, **named):
    named = {"end": 0.5, "snapshots": 3} | named
    return hj.Problem(law or hj.rational(), profile or hj.kinks([-3.0, -2.0], [0.4, 1.2]), **named)


SOLVERS = {
    "grid": lambda p: hj.solve_hj(p, GRID, "godunov"),
    "conservative": lambda p: hj.solve_conservative(p, GRID),
    "weno5": lambda p: hj.solve_hj(p, GRID, "weno5"),
    "fronts": lambda p: hj.track_fronts(p, GRID),
    "characteristics": lambda p: hj.solve_characteristics(p, GRID),
    "auto": lambda p: hj.solve(p, 1e-3, GRID),
    "whole line": lambda p: hj.solve_hj(problem(line="whole"), hj.Grid(-6.0, 60, 1.0)),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_the_arrays_of_a_run_are_read_only(name, tmp_path):
    run = SOLVERS[name](problem())
    hj.write_run(run, tmp_path, vtk=False, plots=False)
    for held in (run, hj.load_run(tmp_path)):
        for field in FIELDS:
            with pytest.raises(ValueError, match="read-only"):
                getattr(held, field)[...] *= 200.0


def test_the_arrays_of_a_grid_are_read_only_and_no_copy_takes_them_along():
    """Wrong by a factor of 40 before: x = run.x; x *= 200 moved the nodes of the grid for the next run."""
    for array in (GRID.nodes, GRID.centres):
        with pytest.raises(ValueError, match="read-only"):
            array *= 200.0
    copy = pickle.loads(pickle.dumps(GRID))
    assert copy == GRID and "nodes" not in vars(copy)
    with pytest.raises(ValueError, match="read-only"):
        copy.nodes[0] = 0.0


def test_what_xarray_gets_is_read_only():
    pytest.importorskip("xarray")
    data = SOLVERS["grid"](problem()).to_xarray()
    with pytest.raises(ValueError, match="read-only"):
        data["u"].values[...] = 0.0
    data.copy(deep=True)["u"].values[...] = 0.0


def height(x):
    return x + 0.3 * np.tanh(4.0 * (x + 3.0))


def height_in_place(x):
    u = x + 0.3 * np.tanh(4.0 * (x + 3.0))
    x *= 7.0
    return u


def law_in_place(q):
    f = q / (1.0 + q)
    q += 1.0
    return f


def derivative_in_place(q):
    q += 1.0
    return 1.0 / q**2


def inverse_in_place(y):
    q = y / (1.0 - y)
    y += 1.0
    return q


def k_in_place(t, x):
    k = 1.0 + t - 0.1 * x
    t *= 2.0
    x *= 2.0
    return k


def test_a_function_may_write_into_what_it_is_given():
    """Of a profile, a law, its derivative, its inverse and a coefficient: the numbers of those that do not write."""
    plain = hj.erosion_law(lambda q: q / (1.0 + q), lambda q: 1.0 / (1.0 + q) ** 2, lambda y: y / (1.0 - y))
    writing = hj.erosion_law(law_in_place, derivative_in_place, inverse_in_place)
    y = np.array([0.1, 0.2])
    assert np.array_equal(writing.inverse(y), plain.inverse(y)) and y[0] == 0.1
    right = {
        "profile": hj.Problem(hj.rational(), hj.profile(height), 0.5, 3),
        "law": problem(law=plain),
        "coefficient": problem(coefficient=hj.coefficient(lambda t, x: 1.0 + t - 0.1 * x)),
    }
    wrong = {
        "profile": hj.Problem(hj.rational(), hj.profile(height_in_place), 0.5, 3),
        "law": problem(law=writing),
        "coefficient": problem(coefficient=hj.coefficient(k_in_place)),
    }
    for name in right:
        expected, found = (hj.solve_hj(case[name], GRID, "godunov") for case in (right, wrong))
        assert np.array_equal(found.u, expected.u), name
    assert np.array_equal(GRID.nodes, hj.Grid(-6.0, 60).nodes)


PROFILES = {
    "kinks": lambda x, q: hj.kinks(x, q),
    "bumps": lambda x, q: hj.bumps(q, x, np.abs(x)),
    "points": lambda x, q: hj.points(x, q),
    "steps": lambda x, q: hj.steps(x, q[1:]),
}


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("kind", [np.array, list])
def test_a_profile_keeps_its_numbers(name, kind):
    x, q = kind(X), kind(Q)
    profile, law = PROFILES[name](x, q), hj.log()
    before, table = profile.W(GRID.nodes, law), dict(profile.table)
    for i in range(3):
        x[i] *= 1.5
        q[i] *= 1.5
    assert np.array_equal(profile.W(GRID.nodes, law), before) and profile.table == table
    held = [v for v in vars(profile).values() if isinstance(v, np.ndarray)]
    assert held and not any(v.flags.writeable for v in held)


def test_amplitudes_that_grow_make_three_profiles():
    """One array in a loop: its last values came out three times before."""
    amplitudes, largest = np.array([0.4, 1.2]), []
    profiles = []
    for _ in range(3):
        profiles.append(hj.kinks([-3.0, -2.0], amplitudes))
        amplitudes *= 1.5
    for profile in profiles:
        largest.append(float(profile.excess(np.array([-2.0]), hj.rational())[0]))
    assert largest == pytest.approx([1.2, 1.8, 2.7], rel=1e-15)


@pytest.mark.parametrize("kind", [np.array, list])
def test_saved_times_stay(kind):
    times = kind([0.0, 0.25, 0.5])
    slope = problem(snapshots=times)
    times[2] = 5.0
    assert slope.times.tolist() == [0.0, 0.25, 0.5] and SOLVERS["grid"](slope).time[-1] == 0.5
    slope.times[0] = 3.0
    assert slope.times[0] == 0.0


def test_the_case_of_a_run_is_its_own(tmp_path):
    content = {
        "erosion": {"law": "rational"},
        "profile": {"kind": "steps", "edges": [-3.0, -2.0], "values": [0.5]},
        "domain": {"left": -6.0, "cells": 60},
        "time": {"end": 0.1, "snapshots": [0.0, 0.1]},
    }
    case = parse_case(content, "case", "case.toml", tmp_path)
    first = hj.solve_case(case)
    first.case["profile"]["edges"][0] = -5.0
    content["profile"]["edges"][0] = content["time"]["snapshots"][1] = -5.0
    again = hj.solve_case(case).case
    assert again["profile"]["edges"] == [-3.0, -2.0] and again["time"]["snapshots"] == [0.0, 0.1]


def test_overrides_and_swept_values_are_copied(tmp_path):
    edges = [-3.0, -2.0]
    case = hj.load_case("two_kinks", {"profile": {"kind": "steps", "edges": edges, "values": [0.5]}})
    edges[0] = -4.0
    assert case.problem.profile.table["edges"] == [-3.0, -2.0]
