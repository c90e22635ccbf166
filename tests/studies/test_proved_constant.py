"""The Lipschitz constant of the proof: every step of it, on random pairs of slopes that no number was tuned on."""

import numpy as np
import pytest
from random_profiles import from_means, random_pair

import hjprofile as hj
from hjprofile.studies.dependence import Distance, observed_constant, solve_together
from hjprofile.studies.proved_constant import proof

LAWS = {
    "rational": hj.rational(),
    "log": hj.log(),
    "power 2": hj.power(2.0),
    "slow": hj.expression("0.3*(sqrt(1+q) - 1/sqrt(1+q))"),
}
GRID = hj.Grid(-10.0, 400)


def variation(values):
    return np.abs(np.diff(values, axis=1)).sum(axis=1)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("seed", range(6))
def test_every_step_of_the_proof_holds_on_random_pairs(name, seed):
    """Without an allowance: godunov is monotone, and the two solutions take the same time steps.

    Two bounds need one of first order: R(q) and TV(f(p)) on cells, where the discrete I varies a little more.
    """
    rng, law = np.random.default_rng([seed, *name.encode()]), LAWS[name]
    q, p = random_pair(rng, law, GRID)
    first, second = solve_together(from_means(law, GRID, q, 2.0), from_means(law, GRID, p, 2.0), GRID)
    bounds = proof(law, first.q[0], second.q[0], GRID.dx)
    distance = GRID.dx * np.abs(first.q - second.q).sum(axis=1)
    assert np.all(np.log(distance / distance[0]) <= bounds.constant * first.time + 1e-12)
    apart = first.K - second.K
    assert np.all(np.abs(apart).max(axis=1) <= bounds.coefficient * distance * (1.0 + 1e-9))
    assert np.all(variation(apart) <= bounds.coefficient * (1.0 + bounds.norm) * distance * (1.0 + 1e-9))
    found = []
    for path in (first, second):  # the proof uses the one with the smaller constant
        f = law.f(path.q)
        holds = np.all(GRID.dx * np.abs(f).sum(axis=1) <= bounds.norm * (1.0 + 1e-9))
        holds &= np.all(np.abs(f).max(axis=1) <= bounds.size * (1.0 + 5.0 * GRID.dx))
        found.append(bool(holds & np.all(variation(f) <= bounds.variation * (1.0 + 5.0 * GRID.dx))))
    assert any(found)
    observed = observed_constant(
        [
            Distance("", "data", 1, float(distance[0]), float(t), float(d), 0.0)
            for t, d in zip(first.time, distance, strict=True)
        ]
    )
    assert -np.inf < observed <= bounds.constant < np.inf


def test_the_constant_of_one_kink_by_hand():
    """For the rational law and q = A e^{-(x-s)} right of s: M = e^A, κ = 0, C = 1, TV(I) = ‖q‖₁ = A, f <= A/(1+A).

    I is constant right of s. Both roles count, and the neutral slope has the bounds 0: the flow towards it contracts.
    """
    law, A, grid = hj.rational(), 0.7, hj.Grid(-30.0, 20_000)
    q = hj.kinks([-20.0], [A]).q_means(grid, law)
    assert proof(law, q, 0.0 * q, grid.dx).constant <= 1e-14
    bounds = proof(law, q, q, grid.dx)
    assert bounds.coefficient == pytest.approx(np.exp(A), rel=1e-6)
    assert (bounds.norm, bounds.size) == pytest.approx((A, A / (1 + A)), rel=1e-3)
    assert bounds.variation == pytest.approx(2.0 * A, rel=1e-3)
    assert bounds.constant == pytest.approx(np.exp(A) * (2 * A + A), rel=2e-3)


def test_a_hollow_by_hand():
    """q = -b on an interval of length 1: M = 1, κ = -b, f' = (1-b)^-2, I runs from 1 to 1-b-b and returns to 1-b."""
    law, b, grid = hj.rational(), 0.4, hj.Grid(-4.0, 4000)
    q = hj.steps([-3.0, -2.0], [-b]).q_means(grid, law)
    bounds = proof(law, q, q, grid.dx)
    steepest = (1 - b) ** -2
    assert bounds.coefficient == pytest.approx(steepest, rel=1e-9)
    assert bounds.norm == pytest.approx(steepest * b, rel=1e-6)
    highest = b  # R(q) <= sup(R + W) + ‖q‖₁ = 1 + b, so q <= b; then f is largest in size at -b
    assert bounds.size == pytest.approx(max(highest / (1 + highest), b / (1 - b)), rel=1e-6)
    assert bounds.variation == pytest.approx(steepest * ((b + b + b) + b), rel=2e-3)  # falls by b, by b, rises by b


def test_a_hollow_below_a_steep_piece_by_hand():
    """q = -b and then c, each of length 1: sup I = 1 + c - b + c at the end, and the hollow adds b: q <= 2c."""
    law, b, c, grid = hj.rational(), 0.2, 1.0, hj.Grid(-4.0, 4000)
    q = hj.steps([-3.0, -2.0, -1.0], [-b, c]).q_means(grid, law)
    bounds = proof(law, q, q, grid.dx)
    assert bounds.size == pytest.approx(2 * c / (1 + 2 * c), rel=1e-3)
    assert bounds.norm == pytest.approx(c + b * (1 - b) ** -2, rel=1e-6)


def test_units_of_the_law_scale_the_constant():
    """With the law γf, u(γx, γ²t)/γ solves the same problem, so L is γ² times as large."""
    law, gamma = hj.rational(), 4.0
    q = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5]).q_means(GRID, law)
    other = hj.expression(f"{gamma}*q/(1+q)")
    one, two = proof(law, q, 0.9 * q, GRID.dx), proof(other, q, 0.9 * q, GRID.dx / gamma)
    assert two.constant == pytest.approx(gamma**2 * one.constant, rel=1e-6)
