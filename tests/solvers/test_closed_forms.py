"""The closed forms against the equation itself: heights, K, paths, exit times and the eroded volume agree."""

from functools import cache

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.closed_forms import kink_into_steady_slope, steady_slope, travelling_kink

LAWS = {"rational": hj.rational(), "log": hj.log(), "power": hj.power(3.0)}
# The user's own f' is a difference formula, good to 1e-11.
LAWS["user"] = hj.expression("sqrt(1+q) - 1/sqrt(1+q)")
GRID = hj.Grid(-4.0, 4000)


@cache
def forms(name):
    law = LAWS[name]
    return {
        "travelling kink": travelling_kink(law, 1.5, -2.0),
        "kink into the steady slope": kink_into_steady_slope(law, 0.25, -2.0),
        "steady slope": steady_slope(law, 0.2),
    }


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("form", ["travelling kink", "kink into the steady slope", "steady slope"])
def test_satisfies_the_equation(law, form):
    """u_t = -K f(u_x - 1) at the midpoints of cells away from the kink, K = exp ∫f, s' = K [f]/[q]."""
    exact, law, t, dt = forms(law)[form], LAWS[law], 0.7, 1e-4
    x, q = GRID.centres, exact.q_means(t, GRID)
    K = np.exp(np.append(np.cumsum((law.f(q) * GRID.dx)[::-1])[::-1], 0.0))
    assert np.abs(exact.K(t, GRID.nodes) - K).max() <= 1e-3  # ∫f over the cell of the kink is first order
    right = GRID.nodes > np.nan_to_num(exact.kink(t), nan=-np.inf) + GRID.dx
    assert np.abs(exact.K(t, GRID.nodes) - K)[right].max() <= 1e-6  # the midpoint rule is second order
    rate = (exact.u(t + dt, GRID.nodes) - exact.u(t - dt, GRID.nodes)) / (2 * dt)
    rate = 0.5 * (rate[1:] + rate[:-1])
    away = ~(np.abs(x - exact.kink(t)) < 3 * GRID.dx)
    assert np.abs(rate + exact.K(t, x) * law.f(q))[away].max() <= 2e-6  # dx², dt²
    assert np.allclose(np.diff(exact.u(t, GRID.nodes)) / GRID.dx - 1.0, q, atol=1e-12)
    if np.isfinite(exact.kink(t)):
        s = exact.kink(t)
        speed = (exact.kink(t + dt) - exact.kink(t - dt)) / (2 * dt)
        jump = float(np.diff(exact.u(t, np.array([s, s + 1e-6]))).item() / 1e-6 - 1.0)
        assert abs(speed - float(exact.K(t, np.array([s]))[0] * law.f(jump) / jump)) <= 1e-5


# the other laws take the same quadratures as the law of a user
@pytest.mark.parametrize(
    "law", [n if n in ("rational", "user") else pytest.param(n, marks=pytest.mark.slow) for n in LAWS]
)
@pytest.mark.parametrize("form", ["travelling kink", "kink into the steady slope"])
def test_volume_and_exit(law, form):
    exact = forms(law)[form]
    grid = hj.Grid(-4.0, 8000)

    def volume(u, x):
        u = u[grid.nodes >= x - 1e-12]
        return grid.dx * (u.sum() - 0.5 * (u[0] + u[-1]))

    start = exact.u(0.0, grid.nodes)
    for t in (0.5, 0.9 * exact.exit_time, exact.exit_time + 1.0):
        u = exact.u(t, grid.nodes)
        for x in (-4.0, -1.0):
            assert abs(volume(start, x) - volume(u, x) - exact.eroded(t, x)) <= 2.5e-6  # the trapezoidal sum's dx²
    assert abs(exact.kink(exact.exit_time * (1 - 1e-9))) <= 1e-7
    assert np.isnan(exact.kink(exact.exit_time + 1e-9))
    assert np.all(exact.u(exact.exit_time, grid.nodes) == grid.nodes)


def test_the_eroded_volume_of_a_strong_kink_is_that_of_its_heights():
    """∫W dx right of a kink with q = a, at a distance L from the crest, is a (L - 1 + e^-L)."""
    exact = travelling_kink(hj.rational(), 20.0, -15.0)

    def volume(t):
        s = exact.kink(t)
        return 20.0 * (-s - 1.0 + np.exp(s))

    for t in (0.1, 0.5, 0.9, 0.99):
        t *= exact.exit_time
        assert exact.eroded(t, -15.0) == pytest.approx(volume(0.0) - volume(t), rel=1e-11)
