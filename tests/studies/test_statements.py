"""Statements of the source paper: values and bounds against closed forms, each bound violated once, random profiles."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import random_profiles
from scipy.special import lambertw

import hjprofile as hj
from hjprofile.errors import InputError
from hjprofile.output.plots.statement_pictures import draw_invariant, draw_statements
from hjprofile.studies import characteristic_statements as along
from hjprofile.studies import statement_runs as runs
from hjprofile.studies import statement_table as table
from hjprofile.studies import statements as study

BUMPS = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5]), end=2.0)
GRID = hj.Grid(-10.0, 200)
ON_CHARACTERISTICS = list(along.WORDS)


@pytest.fixture(scope="module")
def history():
    return runs.evolve(BUMPS, GRID)


@pytest.fixture(scope="module")
def frozen():
    return runs.freeze(BUMPS, GRID)


@pytest.fixture(scope="module")
def bumps(history, frozen):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "evolve", lambda *_: history)
        patch.setattr(study, "freeze", lambda *_: frozen)
        return hj.statements(BUMPS, GRID)


def series(found, name):
    """Times, values and bounds of a statement."""
    return np.array([(row.time, row.value, row.bound) for row in found.rows if row.statement == name]).T


def judged(history, frozen):
    """Name -> result of the statements at saved times."""
    return {result.statement: result for _, result in study._on_the_slope(history, frozen)}


def test_every_statement_is_evaluated_and_holds(bumps):
    assert bumps.holds and all(result.applies and not result.reason for result in bumps.results)
    names = [result.statement for result in bumps.results]
    assert names == [statement.name for statement in table.STATEMENTS] + ON_CHARACTERISTICS
    assert len(set(names)) == len(names) and {row.statement for row in bumps.rows} == set(names)


def test_a_travelling_kink():
    """One kink q = A e^{-(x - s)}, with K/(1 + q) = c constant on its right (§5a).

    There F = c q, so that TV(F) = c (2A - q₀) with q₀ = q(0), and ‖f‖₁ = ln K(left) = ln(c (1 + A)). The kink is spread
    over some cells of 0.00625: the errors are of first order, and measured below half of the tolerances.
    """
    A, start = 0.8, -3.0
    found = hj.statements(hj.Problem(hj.rational(), hj.kinks([start], [A]), end=1.0), hj.Grid(-5.0, 800))
    assert found.holds
    t = np.linspace(0.0, 1.0, 4001)
    c = start + A * np.exp(start) + t
    s = c - lambertw(A * np.exp(c)).real  # s + A e^s = s₀ + A e^{s₀} + t
    q0 = A * np.exp(s)
    c = 1.0 / (1.0 + q0)  # K = 1 at the crest
    rate = c * (2.0 * A - q0)
    total = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))
    time, _, bound = series(found, "q_in_time")
    exact = np.interp(time, t, total) - np.interp(time - time[0], t, total)
    assert np.allclose(bound, exact, rtol=0.04)
    time, value, bound = series(found, "l1_of_f")
    assert np.allclose(value, np.interp(time, t, np.log((1.0 + A) * c)), atol=2e-3)
    assert np.allclose(bound, np.interp(time, t, A - q0), atol=2e-3)  # f'(0) ‖q‖₁
    time, value, _ = series(found, "slope_of_K")
    assert np.allclose(value, np.interp(time, t, c * A), rtol=0.05)
    known = found.characteristics.values.I[np.isfinite(found.characteristics.values.I)]
    # I = 1 + A right of the kink and 1 left of it
    assert known.size > 1000 and np.minimum(np.abs(known - 1.0 - A), np.abs(known - 1.0)).max() < 1e-3


def test_a_steady_slope():
    """F = a at all x and t, and K = 1 - a x (§5e): nothing grows, and a flux enters at the left end."""
    a = 0.5
    found = hj.statements(hj.Problem(hj.rational(), hj.steady(a), end=0.5), hj.Grid(-2.0, 400))
    assert found.holds
    _, value, _ = series(found, "flux_growth")
    assert np.allclose(value, a, atol=1e-3)  # first order: Δx = 0.005
    _, value, bound = series(found, "l1_of_f")
    assert np.allclose(value, np.log(1.0 + 2.0 * a), atol=1e-3)  # ln K at x = -2
    for name in ("q_in_time", "k_in_time", "f_in_time", "K_in_time"):
        assert np.abs(series(found, name)[1]).max() < 5e-3  # 0 but for the first order
    away = {result.statement for result in found.results if not result.applies}
    assert {"infimum_of_q", "quotients", "k_apart", "supremum", "same_k"} < away
    assert {found[name].reason for name in away} <= {table.CLOSED, table.NEGATIVE}
    assert found["invariant"].applies and found["invariant"].value < 1e-4


def test_a_coefficient_of_time_alone():
    """k = 1 + t: q is constant along characteristics, F = k f(q), so that (2.14) and (2.11) have no slack before a kink
    forms at t = 1.4.
    """
    problem = hj.Problem(hj.rational(), hj.bumps([0.5], [-4.0], [1.0]), 0.5, coefficient=hj.coefficient("1 + t"))
    found = hj.statements(problem, hj.Grid(-8.0, 1600))
    assert found.holds
    time, value, bound = series(found, "flux_growth")
    assert np.allclose(bound, (1.0 + time) / 3.0, rtol=1e-4)  # f(0.5) = 1/3; cell means
    assert np.allclose(value, bound, rtol=4e-3) and np.all(value < bound)  # the crest of q sinks by viscosity
    time, value, bound = series(found, "k_in_time")
    assert np.allclose(value, 1.0) and np.allclose(bound, 1.0)
    assert series(found, "k_x_in_time")[1].max() < 1e-9
    time, value, bound = series(found, "supremum_of_q")
    assert np.allclose(bound, bound[0]) and np.all(value <= bound)  # k_x = 0
    assert found["invariant"].reason == found["k_apart"].reason == table.NONLOCAL
    assert found["flux_on_characteristics"].value < 1e-4


def test_a_coefficient_of_x_alone(monkeypatch):
    """k = 2 e^{-x/5}: F is transported, and TV(k) and inf k = 2 in the bound of TV(q) are known."""
    monkeypatch.setattr(study, "follow", lambda *_: along._none("no characteristic is followed"))
    k = hj.coefficient("2*exp(-0.2*x)")
    problem = hj.Problem(hj.rational(), hj.bumps([0.5], [-4.0], [1.0]), 0.5, coefficient=k)
    found = hj.statements(problem, hj.Grid(-8.0, 400))
    assert found.holds
    _, value, bound = series(found, "flux_growth")
    assert np.allclose(bound, bound[0], rtol=1e-13) and np.all(value <= bound)
    assert series(found, "k_in_time")[1:].max() == 0.0  # k does not change, and L = 0
    x = np.linspace(-8.0, 0.0, 100_001)
    q = 0.5 * np.exp(-((x + 4.0) ** 2))
    k, F = 2.0 * np.exp(-0.2 * x), 2.0 * np.exp(-0.2 * x) * q / (1.0 + q)
    exact = (2.0 * F.max() / 2.0 + F.max() * (k[0] - 2.0) / 4.0) * (1.0 + 0.5) ** 2  # 1/f'(sup q) = (1 + q)²
    _, value, bound = series(found, "variation_of_q")
    assert bound[0] == pytest.approx(exact, rel=0.01) and value[0] == pytest.approx(1.0, rel=0.01)


def test_constants_of_the_local_bounds():
    """(3.5) for the data -0.3 <= q <= 0.8, with ‖q‖₁ = ∫|q| from its own quadrature."""
    x = np.linspace(-10.0, 0.0, 400_001)
    q = 0.8 * np.exp(-((x + 5.0) ** 2)) - 0.3 * np.exp(-(((x + 3.0) / 0.5) ** 2))
    norm, lowest, highest = np.trapezoid(np.abs(q), x), q.min(), q.max()
    delta, M = (1.0 + lowest) / 2.0, 2.0 * highest
    C = max(M / (1.0 + M), (1.0 - delta) / delta) * np.exp(norm / delta**2)  # f = q/(1 + q), f' = 1/(1 + q)²
    T = min(delta**3 / C, 0.5 * M / (C * M / (1.0 + M)))
    grid = hj.Grid(-10.0, 4000)
    found = runs.local_bounds(BUMPS.law, BUMPS.profile.q_means(grid, BUMPS.law), grid.dx, 2.0)
    assert found.end == pytest.approx(T, rel=1e-3)
    assert (-1.0 + delta, M) == (pytest.approx(found.low, rel=1e-5), pytest.approx(found.high, rel=1e-5))


def test_the_step_in_q_is_that_of_godunov(history):
    """The first time step, by hand: q_j -= Δt/Δx (K_{j+1} f(q_j) - K_j f(q_{j-1})), K from the sum of f."""
    stepper = runs._Stepper(BUMPS, GRID)
    stepper.at(0.0)
    q = stepper.q
    f = q / (1.0 + q)
    K = np.exp(np.append(np.cumsum(f[::-1])[::-1], 0.0) * GRID.dx)
    dt, _ = next(iter(runs._steps([stepper], 0.0, 2.0)))
    F = np.append(0.0, K[1:] * f)
    stepper.at(dt)
    assert np.allclose(stepper.q, q - dt / GRID.dx * np.diff(F), atol=1e-12)
    assert dt * (K.max() / (1.0 + q.min()) ** 2) <= 0.9 * GRID.dx * (1.0 + 1e-12)
    assert np.allclose(history.q[0], q) and np.allclose(history.k[0], K)


def variation(values):
    return sum(abs(b - a) for a, b in pairwise(values))


def f(q):
    return q / (1.0 + q)


def slope(q):
    return 1.0 / (1.0 + q) ** 2


@pytest.mark.parametrize("inflow", [0.0, 0.3])
def test_sums_over_time_steps_by_loops(inflow):
    """Every sum of two time steps with random states, from its definition; an inflow does not change with k."""
    rng, dx, m, dt = np.random.default_rng(1), 0.1, 3, 0.01
    q, p = rng.uniform(-0.5, 1.0, (2, 30))
    k, k_after, other = rng.uniform(0.5, 2.0, (3, 31))
    sums = runs._Sums(hj.rational(), inflow, dx, m, q, k)
    F = [inflow, *(k[i + 1] * f(q[i]) for i in range(30))]
    assert sums.flux_variation == pytest.approx(variation(F), rel=1e-13)
    for _ in range(2):
        sums.add_pair(dt, k, other, (q, p))
        sums.add(dt, q, k, k_after)
    size = max(abs(value) for value in F)
    change = [(b - a) / a for a, b in zip(k, k_after, strict=True)]
    change[0] = 0.0 if inflow else change[0]
    factor, more = 1.0 + max(abs(value) for value in change), size * variation(change)
    steepest = max(abs(b - a) for a, b in pairwise(k)) / dx
    moved = [0.0] * (m + 1) + [(k[i] - k[i - m]) * f(q[i - m - 1]) for i in range(m + 1, 31)]
    apart = [a - b for a, b in zip(k, other, strict=True)]
    largest = max(abs(value) for value in apart)
    E = min(
        largest * variation([0.0, *map(f, one)]) + max(abs(f(value)) for value in one) * variation(apart)
        for one in (q, p)
    )
    expected = {
        "variation": 2.0 * dt * variation(F),
        "rate": 2.0 * max(abs(np.log(b / a)) for a, b in zip(k, k_after, strict=True)),
        "k_rate": max(abs(b - a) for a, b in zip(k, k_after, strict=True)) / dt,
        "k_variation_rate": variation(k_after - k) / dt,
        "flux_variation": factor * (factor * variation(F) + more) + more,
        "deepest": -min(q) + 2.0 * dt * steepest * abs(f(min(q))),
        "highest": max(q) + 2.0 * dt * steepest * f(max(q)),
        "shifted": 2.0 * dt * variation(moved),
        "apart": 2.0 * dt * E,
    }
    assert dict(zip(sums.NAMES, sums.row(), strict=True)) == pytest.approx(expected, rel=1e-12)


def test_bounds_by_loops(history, frozen):
    """Bounds at one saved time from their definitions, with q, K and the sums of the run."""
    i, dx = 17, GRID.dx
    q, q2, k, k2 = (values[i] for values in (history.q, history.q2, history.k, history.k2))
    before, k_before = history.q[i - 1], history.k[i - 1]
    dt, spent = history.time[i] - history.time[i - 1], history.sums["variation"][i] - history.sums["variation"][i - 1]
    norm = dx * sum(abs(f(value)) for value in q)
    pair = max(k.max(), k2.max()) * slope(min(q.min(), q2.min())) * dx * sum(abs(q - q2))
    C0 = max(max(variation([0.0, *one]), dx * sum(abs(one))) for one in history.q)
    both = min(q.min(), before.min())
    own = {name: table_row for name, table_row in ((s.name, s.series(history, frozen)) for s in table.STATEMENTS)}

    def at(name):
        time, value, bound = own[name]
        j = int(np.flatnonzero(time == history.time[i])[0])
        return value[j], bound[j]

    expected = {
        "q_in_time": (dx * sum(abs(q - before)), spent),
        "k_apart": (max(abs(k - k2)), pair),
        "variation_apart": (variation(k - k2), pair * (1.0 + norm)),
        "supremum": (max(abs(q)), C0),
        "supremum_of_f": (max(abs(f(q))), max(f(C0), abs(f(history.q.min())))),
        "l1_of_f": (norm, slope(q.min()) * dx * sum(abs(q))),
        "f_in_time": (dx * sum(abs(f(q) - f(before))), slope(both) * spent),
        "K_in_time": (max(abs(k - k_before)), max(k.max(), k_before.max()) * dx * sum(abs(f(q) - f(before)))),
        "slope_of_K": (max(abs(np.diff(k))) / dx, max(max(k[j], k[j + 1]) * abs(f(q[j])) for j in range(200))),
        "variation_of_K_x": (
            variation([0.0, *np.diff(k) / dx]), variation(k) * max(abs(f(q))) + k.max() * variation([0.0, *f(q)]),
        ),
        "quotients": (
            max(sum(abs(q - [*np.zeros(m), *q[:-m]])) / m for m in (2, 8, 32)), variation([0.0, *q]),
        ),
        "growth_of_quotient": (
            sum(abs(q - [*np.zeros(3), *q[:-3]])) / 3,
            sum(abs(history.q[0] - [*np.zeros(3), *history.q[0][:-3]])) / 3 + history.sums["shifted"][i] / (3 * dx),
        ),
        "same_k": (dx * sum(abs(q - history.middle[i])), dx * sum(abs(history.q[0] - history.middle[0]))),
        "other_k": (dx * sum(abs(q2 - history.middle[i])), history.sums["apart"][i]),
    }  # fmt: skip
    for name, numbers in expected.items():
        assert at(name) == pytest.approx(numbers, rel=1e-12), name
    rates = np.diff(history.sums["variation"]) / dt
    assert at("k_in_time")[0] == pytest.approx(max(abs(k - k_before)) / dt)
    assert at("k_in_time")[1] == pytest.approx(history.k.max() * slope(history.q.min()) * rates.max())
    norms = [dx * sum(abs(f(one))) for one in history.q]
    L1 = [
        max(history.k[j].max(), history.k[j + 1].max()) * (1.0 + max(norms[j], norms[j + 1])) * rates[j]
        * slope(min(history.q[j].min(), history.q[j + 1].min()))
        for j in range(rates.size)
    ]  # fmt: skip
    assert at("k_x_in_time") == pytest.approx((variation(k - k_before) / dt, max(L1)))


def test_numbers_of_a_frozen_interval():
    """The first refresh, by hand: F before and after it, and the change of K."""
    stepper = runs._Stepper(BUMPS, GRID)
    stepper.at(0.0)
    K = stepper.k
    sizes = []
    for _, t in runs._steps([stepper], 0.0, 0.1):
        stepper.at(t, K)
        F = [0.0, *(K[1:] * f(stepper.q))]
        sizes.append((max(map(abs, F)), variation(F)))
    new = np.exp(np.append(np.cumsum(f(stepper.q)[::-1])[::-1], 0.0) * GRID.dx)
    F = [0.0, *(new[1:] * f(stepper.q))]
    first = runs.freeze(BUMPS, GRID)[0]
    expected = (
        0.0, 0.1, *(first.maximum, first.variation), *np.max(sizes, axis=0), *sizes[-1], max(map(abs, F)),
        variation(F), max(abs(new / K - 1.0)), max(abs(new - K)) / K.min(), variation(new / K - 1.0),
    )  # fmt: skip
    assert first == pytest.approx(expected, rel=1e-11)
    bound = (1.0 + first.coarse) * first.last_variation + first.last_maximum * first.relative_variation
    own = {s.name: s.series(None, [first]) for s in table.STATEMENTS if s.name in WRONG_FROZEN}
    assert own["refreshed_variation"][2][0] == pytest.approx(bound, rel=1e-14)
    assert own["refreshed_maximum"][2][0] == pytest.approx((1.0 + first.relative) * first.last_maximum, rel=1e-14)
    assert own["flux_growth_frozen"][2][0] == first.maximum == own["frozen_maximum"][2][0]
    assert own["frozen_variation"][2][0] == first.variation


def spoiled(values, row=20, factor=1.0, cell=None, value=None):
    """A copy with one state multiplied, or one value of it replaced."""
    values = values.copy()
    if cell is None:
        values[row] *= factor
    else:
        values[row, cell] = value
    return values


def steeper(law):
    """The law with a tenth of its derivative, so that every constant with f' is too small."""
    return replace(law, derivative=lambda q: 0.1 / (1.0 + q) ** 2)


def without(name, factor=0.0):
    """The history with a sum multiplied: 0 leaves the growth out, -1 gives it the wrong sign."""
    return lambda h: h._replace(sums=h.sums | {name: factor * h.sums[name]})


def frozen_with(**changes):
    return lambda steps: [step._replace(**{n: change(step) for n, change in changes.items()}) for step in steps]


NOISE = np.random.default_rng(3).uniform(1.0, 3.0, (runs.MOMENTS, GRID.cells + 1))
WRONG_HISTORY = {  # statement -> a fault in the history of a run that must violate it
    "q_in_time": lambda h: h._replace(q=spoiled(h.q, factor=1.2)),
    "k_in_time": lambda h: h._replace(k=spoiled(h.k, factor=20.0)),
    "k_x_in_time": lambda h: h._replace(k=h.k * NOISE),
    "flux_growth": without("rate", -1.0),  # the sign of k_t
    "flux_variation_growth": without("flux_variation", 0.5),
    "variation_of_q": lambda h: h._replace(law=replace(h.law, derivative=lambda q: 10.0 + 0.0 * q)),
    "local_lower_bound": lambda h: h._replace(local=h.local.seen(np.array([-0.9]))),
    "local_upper_bound": lambda h: h._replace(local=h.local.seen(np.array([1.7]))),
    "infimum_of_q": lambda h: h._replace(q=spoiled(h.q, cell=100, value=-0.5)),
    "supremum_of_q": lambda h: h._replace(q=spoiled(h.q, cell=100, value=3.0)),
    "growth_of_quotient": without("shifted"),
    "same_k": lambda h: h._replace(middle=spoiled(h.middle, factor=1.5)),
    "other_k": without("apart"),
    "k_apart": lambda h: h._replace(k2=1.0 / h.k2),  # the sign of the exponent
    "variation_apart": lambda h: h._replace(k2=1.0 / h.k2),
    "l1_of_f": lambda h: h._replace(law=steeper(h.law)),
    "f_in_time": without("variation", 0.1),
    "K_in_time": lambda h: h._replace(k=spoiled(h.k, factor=1.2)),
    "slope_of_K": lambda h: h._replace(k=h.k**2),  # twice the exponent
    "variation_of_K_x": lambda h: h._replace(k=h.k * NOISE),
}
WRONG_FROZEN = {  # the same, a fault in the intervals with a frozen coefficient
    "frozen_maximum": frozen_with(largest_maximum=lambda s: 1.001 * s.maximum),
    "frozen_variation": frozen_with(largest_variation=lambda s: 1.001 * s.variation),
    "flux_growth_frozen": frozen_with(relative=lambda s: 0.0),
    "refreshed_maximum": frozen_with(relative=lambda s: 0.0),
    "refreshed_variation": frozen_with(coarse=lambda s: 0.0, relative_variation=lambda s: 0.0),
}
WRONG_CONSTANT = {  # the same, a function of the table that returns a wrong value
    "quotients": ("_from_zero", lambda q: 0.9 * q),
    "supremum": ("_domain", lambda h: (0.1, -0.1)),
    "supremum_of_f": ("_domain", lambda h: (0.1, -0.1)),
}


def test_each_statement_has_its_fault():
    names = [*WRONG_HISTORY, *WRONG_FROZEN, *WRONG_CONSTANT]
    assert sorted(names) == sorted(statement.name for statement in table.STATEMENTS)


@pytest.mark.parametrize("name", WRONG_HISTORY)
def test_a_wrong_history_is_reported(history, frozen, name):
    result = judged(WRONG_HISTORY[name](history), frozen)[name]
    assert not result.holds and "FAILS" in str(result) and result.value > result.bound


@pytest.mark.parametrize("name", WRONG_FROZEN)
def test_a_wrong_frozen_interval_is_reported(history, frozen, name):
    assert not judged(history, WRONG_FROZEN[name](frozen))[name].holds


@pytest.mark.parametrize("name", WRONG_CONSTANT)
def test_a_wrong_constant_is_reported(history, frozen, name, monkeypatch):
    monkeypatch.setattr(table, *WRONG_CONSTANT[name])
    assert not judged(history, frozen)[name].holds


def test_time_steps_that_are_too_long_are_reported(monkeypatch):
    """With three times the default step the scheme is not monotone; F overshoots, but q stays above -1."""
    monkeypatch.setattr(runs, "DEFAULT_CFL", 3.0 * runs.DEFAULT_CFL)
    problem = replace(BUMPS, profile=hj.steps([-6.0, -4.0], [0.4]), end=1.0)
    found = judged(runs.evolve(problem, GRID), runs.freeze(problem, GRID))
    assert not found["frozen_maximum"].holds and not found["frozen_variation"].holds


def test_a_scheme_with_another_coefficient_is_reported(monkeypatch):
    """Time steps with 1/K in the place of K: q does not change by the flux that it has."""
    honest = runs._Stepper.at

    def at(self, t, k=runs.NO_CELLS):
        honest(self, t, k)
        self.scheme.factor.frozen_K = 1.0 / self.scheme.factor.frozen_K**2

    monkeypatch.setattr(runs._Stepper, "at", at)
    found = judged(runs.evolve(BUMPS, GRID), runs.freeze(BUMPS, GRID))
    assert not found["q_in_time"].holds


@pytest.fixture(scope="module")
def three_runs():
    return [along.solved(BUMPS, hj.Grid(-10.0, cells)) for cells in (600, 300, 150)]


def failing(found):
    """Names of the statements along characteristics that are violated."""
    return [name for name, d in found.defects.items() if np.nanmax(np.abs(d)) > found.allowances[name]]


@pytest.mark.parametrize(
    ("fault", "fails"),
    [
        (lambda run: run, []),
        (lambda run: replace(run, K=run.K**1.3), ON_CHARACTERISTICS),  # a wrong K
        (lambda run: replace(run, K=1.0 / run.K), ON_CHARACTERISTICS),  # the sign of the exponent
        (lambda run: replace(run, u=2.0 * run.x - run.u), ["invariant"]),  # the sign of W
    ],
)
def test_a_wrong_run_violates_the_statements_along_its_characteristics(three_runs, fault, fails):
    assert sorted(failing(along.along(BUMPS, *map(fault, three_runs)))) == sorted(fails)


def test_defects_and_allowances_decrease_with_refinement():
    """From 250 to 1000 cells the defects decrease 13- to 14-fold, their allowances 5- to 6-fold (measured)."""
    smooth = replace(BUMPS, end=0.5)  # before kinks form
    coarse, fine = (along.follow(smooth, hj.Grid(-10.0, cells)) for cells in (250, 1000))
    for name in ON_CHARACTERISTICS:
        defects = [np.nanmax(np.abs(found.defects[name])) for found in (coarse, fine)]
        assert defects[1] < defects[0] / 8.0
        assert fine.allowances[name] < coarse.allowances[name] / 4.0


def test_characteristics_are_those_of_the_equation():
    """q along a characteristic from x₀ of data with a constant coefficient 1 is constant, and x = x₀ + f'(q) t."""
    problem = hj.Problem(hj.rational(), BUMPS.profile, 0.5, coefficient=hj.coefficient("1"))
    values = along.follow(problem, hj.Grid(-10.0, 1000)).values
    for c in range(values.x.shape[1]):
        x = values.x[:, c][np.isfinite(values.x[:, c])]
        if x.size > 1 and np.isfinite(values.x[0, c]):
            q = 0.8 * np.exp(-((x[0] + 5.0) ** 2)) - 0.3 * np.exp(-(((x[0] + 3.0) / 0.5) ** 2))
            t = np.linspace(0.0, 0.5, along.TIMES)[: x.size]
            assert np.allclose(x, x[0] + t / (1.0 + q) ** 2, atol=2e-4)  # measured 5e-5; Δx = 0.005


def test_no_characteristic():
    """On 20 cells every position is near a kink; a slope on which a second-order run stops has none either."""
    problem = hj.Problem(hj.rational(), hj.kinks([-3.0, -2.0], [0.4, 1.2]), end=1.0)
    found = hj.statements(problem, hj.Grid(-4.0, 20))
    assert found.holds and "use more cells" in found["invariant"].reason
    assert found.characteristics.rows() == []


LAWS = [hj.rational(), hj.log(), hj.power(2.0), hj.power(0.6)]


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 8))])
def test_random_profiles(seed):
    """Slopes that are no shipped case, with q from -0.95 to 6, four laws, with K and with a prescribed coefficient."""
    rng = np.random.default_rng(seed)
    profile = (random_profiles.random_bumps, random_profiles.random_pieces)[seed % 2](rng)
    k = hj.coefficient("exp(-0.3*x)*(1 + 0.5*t*exp(-(x + 1.5)**2))") if seed % 4 == 3 else None
    problem = hj.Problem(LAWS[seed % 3], profile, float(rng.choice([0.1, 0.5])), coefficient=k)
    found = hj.statements(problem, hj.Grid(-12.0, 120))
    assert [str(result) for result in found.results if not result.holds] == []


@pytest.mark.parametrize(
    ("name", "words"),
    [("thin_layer", "rolling layer"), ("vertical_step", "growth = 'linear'"), ("travelling_wave", "line = 'whole'")],
)
def test_other_models_are_refused(name, words):
    case = hj.load_case(name)
    with pytest.raises(InputError, match=f"the study of the statements does not take .*{words}"):
        hj.statements(case.problem, case.grid)


def test_a_run_without_length_is_refused():
    with pytest.raises(InputError, match="end = 0; the study of the statements"):
        hj.statements(replace(BUMPS, end=0.0), GRID)


def test_a_coefficient_that_vanishes_stops_the_study():
    problem = replace(BUMPS, coefficient=hj.coefficient("(t - 1)**2 - 0.01"))
    with pytest.raises(hj.RunError, match="is not a positive number"):
        hj.statements(problem, GRID)


def test_rounding_is_no_violation():
    row = study.StatementRow("", "", 0.0, 1.0 + 5e-11, 1.0)
    assert row.holds and not row._replace(value=1.0 + 5e-10).holds
    assert row._replace(value=5e-11, bound=0.0).share == 0.0 and row._replace(value=1.0, bound=0.0).share == np.inf


def test_a_violation_is_reported_before_a_larger_share_of_rounding():
    series = np.array([1.0, 2.0]), np.array([1.5e-10, 1.2]), np.array([1e-10, 1.0])
    rows, result = study.judge("", "", "", series, "")
    assert rows[0].holds and rows[0].share > rows[1].share
    assert not result.holds and result.time == 2.0


def test_integrals_along_characteristics_are_of_second_order(monkeypatch):
    """21 saved times on a steady slope: measured 3e-6, and 2.3e-4 by the rule of rectangles."""
    monkeypatch.setattr(along, "TIMES", 21)
    found = along.follow(hj.Problem(hj.rational(), hj.steady(0.5), 0.5), hj.Grid(-2.0, 2000))
    assert max(np.nanmax(np.abs(defect)) for defect in found.defects.values()) < 2e-5


def test_progress_runs_from_0_to_1():
    seen = []
    hj.statements(replace(BUMPS, end=0.2), hj.Grid(-10.0, 60), seen.append)
    assert np.all(np.diff(seen) >= 0.0) and seen[0] >= 0.0 and seen[-1] == pytest.approx(1.0)


def test_pictures(bumps):
    drawn = draw_statements("bumps", bumps)
    shown = [axes for axes in drawn.axes if axes.axison]
    assert len(shown) == len(bumps.results)
    assert all(len(axes.lines) == 3 for axes in shown)  # bound, value, violations
    left, right, _ = draw_invariant("bumps", bumps.characteristics).axes
    followed = (np.isfinite(bumps.characteristics.values.x).sum(axis=0) > 1).sum()
    assert len(left.collections) == len(right.lines) == followed
