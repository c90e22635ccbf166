"""K from q by the midpoint rule, as it is saved and watched, with the checks that go with it."""

from __future__ import annotations

import numpy as np

from hjprofile.solvers.grid_law import GridLaw
from hjprofile.solvers.kernels import grid as kernels
from hjprofile.solvers.march import Breakdown
from hjprofile.solvers.run import Array


def fill_factor(law: GridLaw, q: Array, dx: float, K: Array) -> tuple[GridLaw, float]:
    """Fills K at the nodes (theory, §2); returns the law for slopes as large as q, and the largest K f'.

    Raises Breakdown where q is not above -1, or K f' not a finite number.
    """
    if not np.min(q) > -1.0:  # nor NaN
        raise Breakdown(q, K)
    law = law.covering(q)
    kernels.exponent(law.f(q), dx, K)
    np.exp(K, out=K)
    speed = float(kernels.fastest(K, law.derivative(q)))
    if not 0.0 < speed < np.inf:
        raise Breakdown(q, K)
    return law, speed
