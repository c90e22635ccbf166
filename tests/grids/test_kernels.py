"""Sweeps over many time levels against obvious loops; tables of laws; reconstructions; the active window."""

import math
import os
import subprocess
import sys

import numpy as np
import oracles
import pytest
from grid_methods import FLUXES, solve_by
from hypothesis import given, settings
from hypothesis import strategies as st

import hjprofile as hj
from hjprofile.solvers.grids import conservation
from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.grid_law import grid_law
from hjprofile.solvers.grids.high_order import ssp_rk2, ssp_rk4
from hjprofile.solvers.grids.kernels import grid_loops as kernels
from hjprofile.solvers.grids.kernels import hancock, wavefront
from hjprofile.solvers.grids.kernels.sweep_law import SHIFT
from hjprofile.solvers.grids.march import march

LAWS = {"rational": hj.rational(), "log": hj.log(), "power": hj.power(2.0), "expression": hj.expression("q/(1+q)")}
NONLOCAL = wavefront.Nonlocal()
means = st.lists(st.floats(-0.9, 6.0), min_size=5, max_size=90)


def factors(grid, levels, seed):
    """For each kind of factor: what the plain scheme takes, and the kernels, for levels dt apart."""
    rng = np.random.default_rng(seed)
    # from node to node no more than K changes where f is 2: a rougher one would carry edge values below -1
    walk = np.cumsum(rng.uniform(-0.04, 0.04, (levels, grid.nodes.size)), axis=1)
    k = np.exp(np.clip(walk, -1.0, 1.0))
    steady, varying = Factor(grid), Factor(grid)
    steady.frozen_K = k[0]
    varying.given = lambda after=0.0, nodes=None: k[round(float(after) * 1e9) % levels][None]
    return {
        "nonlocal": (Factor(grid), NONLOCAL),
        "kept": (steady, wavefront.Given(k[:1].copy())),
        "given": (varying, wavefront.Given(k)),
    }


@settings(max_examples=45, deadline=None)
@given(
    data=means,
    law=st.sampled_from(sorted(LAWS)),
    flux=st.sampled_from(sorted(FLUXES)),
    factor=st.sampled_from(["nonlocal", "kept", "given"]),
    levels=st.integers(1, wavefront.LANES),
    inflow=st.sampled_from([0.0, 0.3]),
)
def test_a_sweep_is_as_many_single_steps(data, law, flux, factor, levels, inflow):
    """Against plain numpy in the other form, a step at a time."""
    q = np.array([0.0, 0.0, *data])
    grid, law = hj.Grid(-0.02 * q.size, q.size), grid_law(LAWS[law], q)
    W = np.concatenate([[0.0], np.cumsum(q) * grid.dx])
    plain = conservation.FirstOrder(law, grid, q, 0.0, inflow, FLUXES[flux])
    plain.factor, kernel = factors(grid, levels, q.size)[factor]
    # k is at most e, and what it can grow to on the way
    bound = 1.5 * plain.evaluate() * (1.0 if factor == "nonlocal" else np.e**2)
    dt = grid.dx / bound
    if factor == "given":  # each level by its number, told from the time
        given = plain.factor.given
        plain.factor.given = lambda after=0.0: given(round(after / dt) * 1e-9)
    speed = plain.advance(dt, levels, bound)
    swept = W.copy()
    met, grown = wavefront.hj_pass(swept, grid.dx, dt, levels, inflow, law.kernel, FLUXES[flux].kernel(bound), kernel)
    # 64 steps of rounding of W up to 12; a viscosity reads f' to 1e-7 where a table's pieces are told apart by rounding
    assert np.abs(swept - plain.W).max() <= 1e-12
    # the plain scheme looks at the left end, too
    assert met <= speed * (1.0 + 1e-6)
    assert met == pytest.approx(speed, rel=1e-6) or factor != "nonlocal"
    assert grown == pytest.approx(plain.toe_gain, rel=1e-11, abs=1e-14)


@settings(max_examples=30, deadline=None)
@given(
    data=means, law=st.sampled_from(sorted(LAWS)), factor=st.sampled_from(["nonlocal", "kept", "given"]),
    levels=st.integers(1, wavefront.LANES),
)  # fmt: skip
def test_a_second_order_sweep_is_as_many_single_steps(data, law, factor, levels):
    """Against the scheme written down cell by cell with the law itself."""
    q, law, dx = np.array([0.0, 0.0, *data]), LAWS[law], 0.02
    table = grid_law(law, q)
    kernel = factors(hj.Grid(-dx * q.size, q.size), levels, q.size)[factor][1]
    k = [None] * levels if factor == "nonlocal" else np.broadcast_to(kernel.k, (levels, q.size + 1))
    K = np.exp(dx * np.cumsum(law.f(q)[::-1])[::-1]) if factor == "nonlocal" else kernel.k
    dt = 0.3 * dx / float(max(np.max(K), 1.0) * np.max(law.derivative(q)))
    swept, plain, grown, crest_lowering = q.copy(), q.copy(), 0.0, 0.0
    for level in range(levels):
        plain, foot, top = oracles.muscl_hancock(plain, law, dx, dt, kernels.FLOOR_SHARE, k[level])
        grown, crest_lowering = grown + dt * (foot - 1.0), crest_lowering + dt * top
    _, found_grown, found_lowering = hancock.hancock_pass(swept, dx, dt, levels, 0.0, table.kernel, kernel)
    # rounding; with a table f to 1e-11 of its size and, in the step to the half time, f' to 1e-8, dt times
    allowed = 1e-11 if law.name == "rational" else 1e-7
    assert np.abs(swept - plain).max() <= allowed * (1.0 + np.abs(plain).max())
    assert found_grown == pytest.approx(grown, rel=allowed, abs=allowed)
    assert found_lowering == pytest.approx(crest_lowering, rel=allowed, abs=allowed)


def test_lanes_beyond_the_levels_do_nothing():
    """One level at a time or all at once, bit for bit."""
    W = np.cumsum(np.abs(np.sin(np.arange(301)))) * 0.01
    for flux in (flux.kernel for flux in FLUXES.values()):
        together, apart = W.copy(), W.copy()
        law = grid_law(hj.rational(), W).kernel
        wavefront.hj_pass(together, 0.01, 0.002, 37, 0.0, law, flux(2.0), NONLOCAL)
        for _ in range(37):
            wavefront.hj_pass(apart, 0.01, 0.002, 1, 0.0, law, flux(2.0), NONLOCAL)
        assert np.array_equal(together, apart)


@pytest.mark.parametrize("law", ["log", "power", "expression"])
def test_a_table_is_the_law(law):
    law = LAWS[law]
    table = grid_law(law, np.array([-0.95, 3.0]))
    q = np.random.default_rng(1).uniform(-0.95, 40.0, 20000)
    p = 1.0 + q
    # a cubic with the values and slopes of f at both ends of a piece is h⁴ f''''/384 off, and its slope h³ f''''/125,
    # with h = p/512; f'''' p⁴ <= 120 f' p for these laws
    assert np.all(np.abs(table.f(q) - law.f(q)) <= 1e-11 * law.derivative(q) * p + 1e-15 * np.abs(law.f(q)).max())
    assert np.all(np.abs(table.derivative(q) / law.derivative(q) - 1.0) <= 1e-8)
    assert table.f(np.zeros(1)) == 0.0  # a critical slope stays
    # continuous, f' too: at a joint it makes no difference on which side rounding puts a slope
    joints = table.kernel.c.size // 8 + np.arange(50)
    bits = (table.kernel.first + joints) << SHIFT
    at = bits.view(np.float64)
    for function in (table.f, table.derivative):
        assert np.abs(function(np.nextafter(at, 0) - 1.0) - function(at - 1.0)).max() <= 1e-13


def test_a_table_grows_with_the_slopes():
    table = grid_law(hj.log(), np.array([0.0, 1.0]))
    assert table.covering(np.array([0.2 * table.q_most])) is table
    wider = table.covering(np.array([-0.5, 0.3 * table.q_most]))
    assert wider.q_most > 2 * table.q_most
    q = np.linspace(0.0, 5.0, 1001)
    assert np.array_equal(wider.f(q), table.f(q))


def test_a_run_goes_on_where_slopes_outgrow_the_table(monkeypatch):
    """q grows from 0.9 to 12, and the table ends at 3 at first."""
    problem = hj.Problem(hj.log(), hj.steps([-6.0, -0.5], [0.9]), end=1.5, snapshots=2)
    grid = hj.Grid(-6.5, 400)
    wide = hj.solve_hj(problem, grid)
    monkeypatch.setattr("hjprofile.solvers.grids.grid_law.HEADROOM", 1)
    assert wide.q.max() > 10.0 and grid_law(hj.log(), wide.q[0]).q_most == 3.0
    assert np.abs(hj.solve_hj(problem, grid).u - wide.u).max() <= 1e-13
    monkeypatch.setattr("hjprofile.solvers.grids.grid_law.GridLaw.covering", lambda law, q: law)
    assert np.abs(hj.solve_hj(problem, grid).u - wide.u).max() > 0.1  # so that the test can fail


def test_the_law_that_is_edited_is_the_law_that_runs(tmp_path):
    """Nothing of a user's law is kept from one run to the next."""
    case, law = tmp_path / "case.toml", tmp_path / "law.py"
    case.write_text(
        '[erosion]\nlaw = "python"\nfile = "law.py"\nfunction = "f"\n[profile]\nkind = "kinks"\npositions = [-1.0]\n'
        "amplitudes = [0.5]\n[domain]\nleft = -2.0\ncells = 100\n[time]\nend = 0.2\nsnapshots = 2\n"
    )
    found = []
    for formula in ("q / (1 + q)", "2 * q / (1 + q)"):
        law.write_text(f"def f(q):\n    return {formula}\n")
        found.append(hj.solve_case(hj.load_case(case)).eroded_volume)
    law_of = hj.expression("2*q/(1+q)")
    problem = hj.Problem(law_of, hj.kinks([-1.0], [0.5]), end=0.2, snapshots=2)
    assert found[0] != found[1]
    assert found[1] == pytest.approx(hj.solve_hj(problem, hj.Grid(-2.0, 100)).eroded_volume, rel=1e-9)


WINDOWED = ("local-lax-friedrichs", "lax-friedrichs", "godunov", "telescoping", "eno2", "weno5", "conservative")
NARROW = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-6.0, -5.8], [0.1, 0.05]), end=0.4, snapshots=3)


@pytest.mark.parametrize("method", [*WINDOWED, "conservative-weno5"])
def test_what_is_left_out_changes_nothing(method, monkeypatch):
    """Waves on a twentieth of the slope: the run on the whole of it is the same, bit for bit."""
    solve = solve_by
    part = solve(NARROW, hj.Grid(-10.0, 1500), method)

    def everywhere(y, first, last, left, right):
        sound(y, 0, y.size - 1, left, right)
        return 0, y.size - 1

    sound = kernels.flat_ends
    monkeypatch.setattr(kernels, "flat_ends", everywhere)
    whole = solve(NARROW, hj.Grid(-10.0, 1500), method)
    assert whole.steps == part.steps
    assert np.array_equal(whole.u, part.u) and np.array_equal(whole.q, part.q) and np.array_equal(whole.K, part.K)


@pytest.mark.parametrize("method", WINDOWED)
def test_no_denormals(method):
    """The tails that decay for ever end where they no longer count."""
    solve = hj.solve_conservative if method == "conservative" else hj.solve_hj
    run = solve(NARROW, hj.Grid(-10.0, 1500), method)
    for values in (run.q, run.u - run.x):
        small = np.abs(values[values != 0.0])
        assert small.min() > np.finfo(float).tiny


class Rising:
    """A scheme whose speed doubles half way, to see what the march makes of it."""

    cfl_limit = 1.0

    def __init__(self):
        self.t, self.taken, self.redone = 0.0, [], 0
        self.W, self.q, self.K = np.zeros(1001), np.zeros(1000), np.ones(1001)
        self.law, self.factor = grid_law(hj.rational(), self.q), Factor(hj.Grid(-1.0, 1000))
        self.toe_gain = self.crest_lowering = 0.0

    def means(self):
        return 0, self.q

    def speed(self):
        return 1.0 if self.t < 0.5 else 2.0

    def evaluate(self):
        return self.speed()

    def advance(self, dt, steps, bound):
        self.before = self.t
        met = 0.0
        for _ in range(steps):
            met = max(met, self.speed())
            self.t += dt
        self.taken.append((dt, steps, met))
        return met

    def roll_back(self):
        self.t, self.redone = self.before, self.redone + 1
        self.taken.pop()

    def volume(self):
        return 0.0


def test_steps_are_taken_anew_where_the_speed_outgrew_them():
    scheme = Rising()
    grid = hj.Grid(-10.0, 1000)
    problem = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.4]), end=1.0, snapshots=[0.0, 0.3, 1.0])
    record = march(scheme, problem, grid, 0.9)
    assert 1 <= scheme.redone <= 6  # the change is met with ever shorter leaps
    assert all(dt * met <= 0.9 * grid.dx * (1 + 1e-12) for dt, _, met in scheme.taken)
    assert scheme.t == pytest.approx(1.0, abs=1e-12)
    assert record.steps == sum(steps for _, steps, _ in scheme.taken[1:])
    # no shorter than the margin asks for: 50 steps to the change, 100 after it, the rest at snapshots
    assert record.steps <= 220


def test_reconstructions_are_exact_for_what_they_were_made_for():
    """Cell means of polynomials: a line for ENO2, a parabola through each of WENO5's parts."""
    edges_at = np.arange(41) * 0.1 - 2.0
    grid_edges = np.arange(-3, 44) * 0.1 - 2.0
    found = np.empty(41)
    for degree, kernel in ((1, kernels.edges_eno2), (2, kernels.edges_weno5)):
        primitive = np.polynomial.Polynomial([5.0, 1.0, 0.3][: degree + 1]).integ()
        padded = np.diff(primitive(grid_edges)) / 0.1
        kernel(padded, found)
        assert np.abs(found - primitive.deriv()(edges_at)).max() <= 1e-13
    # the ghosts, too, continue a parabola where that stays within the last cells' range
    q = padded[3:-3].copy()
    again = np.concatenate([np.zeros(3), q, np.zeros(3)])
    kernels.ghosts(again)
    assert np.abs(again[-4:-1] - padded[-4:-1]).max() <= 1e-12 and np.array_equal(again[3:-3], q)


def test_weno5_agrees_with_its_weights():
    """Its linear weights where q is smooth: fifth order at a point; across a jump the smooth side alone."""
    errors = []
    for n in (40, 80, 160):
        h = 1.0 / n
        x = np.arange(-3, n + 4) * h
        padded = np.diff(-np.cos(3.0 * x)) / (3.0 * h)
        found = np.empty(n + 1)
        kernels.edges_weno5(padded, found)
        errors.append(np.abs(found - np.sin(3.0 * np.arange(n + 1) * h)).max())
    assert 4.7 <= hj.observed_order([40, 80, 160], errors) <= 5.5
    padded = np.where(np.arange(47) < 20, 0.2, 1.0)
    found = np.empty(41)
    kernels.edges_weno5(padded, found)
    assert found.min() >= 0.2 - 1e-6 and found.max() <= 1.0 + 1e-6


def test_edges_keep_above_minus_one():
    padded = np.concatenate([np.full(10, 3.0), np.full(10, -0.999), np.full(10, 2.0)])
    found = np.empty(25)
    for kernel in (kernels.edges_eno2, kernels.edges_weno5):
        kernel(padded, found)
        assert np.all(1.0 + found >= (1.0 - kernels.FLOOR_SHARE) * (1.0 + padded[2:27]) - 1e-15)


def test_the_quadrature_of_K():
    """∫ f over a cell: exact for a quintic inside, for a quartic in the two cells at an end."""
    x = np.linspace(-1.0, 0.0, 21)
    for degree, places in ((5, slice(2, -3)), (4, slice(0, None))):
        f = np.polynomial.Polynomial([0.3, -0.5, 0.2, 0.7, -0.4, 0.6][: degree + 1])
        E = np.empty(21)
        kernels.exponent_from_nodes(f(x), 0.05, True, E)
        found = -np.diff(E)
        assert np.abs(found - np.diff(f.integ()(x)))[places].max() <= 1e-15


@pytest.mark.parametrize(("step", "order"), [(ssp_rk2, 2), (ssp_rk4, 4)])
def test_runge_kutta_orders(step, order):
    """y' = -y² + y from 0.1: the logistic curve."""
    errors, counts = [], (8, 16, 32, 64)
    for n in counts:
        y = np.array([0.1])
        for _ in range(n):
            y = step(y, lambda y: y - y * y, 2.0 / n)
        errors.append(abs(float(y[0]) - 1.0 / (1.0 + 9.0 * math.exp(-2.0))))
    assert order - 0.1 <= hj.observed_order(counts, errors) <= order + 0.15


def test_nothing_is_compiled_twice(tmp_path):
    """A second process finds what the first has compiled, for a formula and for a table; one step needs few loops."""
    script = (
        "import hjprofile as hj\n"
        "from hjprofile.solvers.methods import METHODS\n"
        "from hjprofile.solvers.grids.kernels.wavefront import hj_pass\n"
        "for law in (hj.rational(), hj.log(), hj.power(2.0), hj.expression('q/(1+q)')):\n"
        "    problem, grid = hj.Problem(law, hj.kinks([-1.0], [0.5]), end=0.1), hj.Grid(-2.0, 50)\n"
        "    form = METHODS['godunov'].setup.scheme(problem, grid, None)\n"
        "    bound = form.evaluate()\n"
        "    form.advance(0.01 / bound, 1, bound)\n"
        "print(sum(hj_pass.stats.cache_hits.values()), sum(hj_pass.stats.cache_misses.values()))\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    counts = [
        subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert [c.stdout.split() for c in counts] == [["0", "2"], ["2", "0"]]


@pytest.mark.parametrize("cells", [5, 6, 7, 40])
def test_integrals_from_six_cells_on_are_exact_for_quartics(cells):
    """The integral of a quartic to the right end, by nodes; on fewer than six cells it is the trapezoidal sum."""
    f, x = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0, 1.5]), np.linspace(-1.0, 0.0, cells + 1)
    E = np.empty(cells + 1)
    kernels.exponent_from_nodes(f(x), 1.0 / cells, True, E)
    exact = f.integ()(0.0) - f.integ()(x)
    if cells < 6:
        exact = np.append(np.cumsum((0.5 * (f(x[1:]) + f(x[:-1])) / cells)[::-1])[::-1], 0.0)
    assert np.abs(E - exact).max() <= 1e-13
