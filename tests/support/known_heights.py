"""Heights of a problem and how well they are known, without the method `auto`."""

import numpy as np

import hjprofile as hj
from hjprofile.errors import RunError
from hjprofile.solvers.closed_forms import closed_form


def truth(problem, grid):
    """u at the saved times and how well it is known: closed form, characteristics at their finest, or many fronts."""
    form = closed_form(problem)
    if form is not None and problem.law.name == "rational":
        return np.array([form.u(t, grid.nodes) for t in problem.times]), 1e-13
    try:
        run = hj.solve_characteristics(problem, grid, 1e-13)
        if run.done:
            return run.u, run.error_estimate
    except RunError:
        pass
    coarse, fine = (hj.track_fronts(problem, grid, n) for n in (6400, 12800))
    if not (coarse.done and fine.done):
        return None, np.inf
    return fine.u + (fine.u - coarse.u) / 3.0, float(np.abs(fine.u - coarse.u).max())
