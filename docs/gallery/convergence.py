"""
Which order of convergence does each method have?
=================================================

The error of a method on a grid is proportional to a power of the cell width. This power is
the order of the method. Two problems with a known exact solution are solved on five grids:
a steady slope, which is smooth, and a travelling kink.
"""

import matplotlib.pyplot as plt
import numpy as np

import hjprofile as hj

law = hj.rational()
problems = {
    "smooth: steady slope": hj.Problem(law, hj.steady(0.4), end=1.0),
    "kink: travelling kink": hj.Problem(law, hj.kinks([-3.0], [1.0]), end=1.0),
}
methods = ["godunov", "conservative", "weno5"]
cells = [50, 100, 200, 400, 800]


def error(problem, method, grid):
    """Return ∫ |q - q_exact| dx, the mean over the saved times after the start."""
    solver = hj.solve_conservative if method == "conservative" else hj.solve_hj
    run, exact = solver(problem, grid, method), hj.exact(problem)
    q_exact = np.array([exact.q_means(t, grid) for t in run.time])
    return np.abs(run.q - q_exact)[1:].sum(axis=1).mean() * grid.dx


# %%
# ``hj.exact`` returns the closed form of a problem, and ``hj.observed_order`` the slope of
# the line through the errors.

errors, orders = {}, {}
for title, problem in problems.items():
    for method in methods:
        found = [error(problem, method, hj.Grid(left=-5.0, cells=n)) for n in cells]
        order = hj.observed_order(cells, found)
        print(f"{title:22} {method:13} order {order:.2f}, smallest error {found[-1]:.1e}")
        errors[title, method], orders[title, method] = found, order

# %%
# On the smooth slope the orders are close to 1, 2 and 4. The method ``weno5`` reconstructs q
# to fifth order, but most of its error here is in the five cells at the crest. With a kink
# every method on a fixed grid is of first order, because the kink lies inside a cell.

fig, axes = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
for ax, title in zip(axes, problems, strict=True):
    for method in methods:
        label = f"{method}, order {orders[title, method]:.1f}"
        ax.loglog(cells, errors[title, method], "o-", label=label)
    ax.set_xticks(cells, cells)
    ax.minorticks_off()
    ax.set_title(title)
    ax.set_xlabel("number of cells")
    ax.set_ylabel("error of q, integrated over x")
    ax.legend()
plt.show()
