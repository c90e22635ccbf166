"""Random steps as rough as the theory admits, and the measured variation of the invariant in runs from them."""

import numpy as np
from grid_methods import solve_by

import hjprofile as hj
from hjprofile.problem.profiles import steps
from hjprofile.solvers.norms import invariant_variation

LAWS = {"rational": hj.rational(), "log": hj.log(), "power": hj.power(2.0)}
TIMES = 15  # number of saved times at which TV(I) is measured
ROUNDING = 1e-12  # of sums over a hundred cells, as a fraction of TV(I)


def random_problem(rng, law):
    """Steps of total variation up to some 400 with q in [-0.95, 20], where K spans at most e^12, on 20 to 120 cells."""
    while True:
        cells, dx = int(rng.integers(20, 120)), 10.0 ** rng.uniform(-2.5, -0.7)
        n = int(rng.integers(1, min(cells // 2, 25)))
        q = np.exp(rng.uniform(np.log(0.05), np.log(21.0), n)) - 1.0
        kind = rng.integers(5)
        if kind == 0:
            q = np.abs(q)
        elif kind == 1:
            q = -np.abs(np.minimum(q, 0.0)) + 0.0
        elif kind == 2:
            q = np.sort(q)[:: rng.choice([-1, 1])]
        elif kind == 3:
            q = np.where(rng.random(n) < 0.5, 0.0, q)
        edges = -cells * dx * np.sort(rng.uniform(0.0, 0.9, n + 1))[::-1]
        ln_K = np.cumsum((LAWS[law].f(q) * np.diff(edges))[::-1])
        if np.abs(ln_K).max() > 12.0 or np.diff(edges).min() < 1e-3 * dx:
            continue
        speed = float(np.max(LAWS[law].derivative(np.append(q, 0.0)))) * np.exp(max(float(ln_K.max()), 0.0))
        end = float(cells * dx / speed * rng.uniform(0.1, 20.0))
        return hj.Problem(LAWS[law], steps(edges, q), end=end, snapshots=2), hj.Grid(-cells * dx, cells)


def variation_of(run, law):
    """TV(I) at the saved times."""
    return invariant_variation(law.R(run.q), run.u - run.x, float(law.R(0.0)))


def increases(method, seeds):
    """Of runs from random steps: TV(I) above its start, and its increase between saved times, as parts of TV(I(0))."""
    found = []
    for seed in seeds:
        problem, grid = random_problem(np.random.default_rng(seed), list(LAWS)[seed % 3])
        problem = hj.Problem(problem.law, problem.profile, problem.end, snapshots=TIMES)
        run = solve_by(
            problem, grid, method, cfl=1.0 if method.endswith(("godunov", "friedrichs", "telescoping")) else 0.9
        )
        if not run.done:
            continue
        tv = variation_of(run, problem.law)
        held = run.bounds["uniform_tv"].holds if "uniform_tv" in run.bounds else True
        found.append(((tv - tv[0]).max() / (tv[0] + 1e-9), np.diff(tv).max() / (tv[0] + 1e-9), held))
    return np.array(found, dtype=float)
