"""Norms of q at the saved times of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.run import Run


class Norms(NamedTuple):
    """Norms of the cell means of q at one time: ∫|q| dx, the total variation, and the smallest and largest value."""

    l1: float
    tv: float
    inf: float
    sup: float


def norms(run: Run, index: int) -> Norms:
    """Return the norms of q at the saved time `run.time[index]`.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.steps([-2.0, -1.0], [0.5]), end=0.0)
    >>> norms(hj.solve_hj(problem, hj.Grid(left=-4.0, cells=8)), 0)
    Norms(l1=0.5, tv=1.0, inf=0.0, sup=0.5)
    """
    q = run.q[index]
    dx = float(np.ptp(run.x)) / run.cells
    return Norms(dx * float(np.abs(q).sum()), float(np.abs(np.diff(q)).sum()), float(q.min()), float(q.max()))
