"""Grain flux K in the schemes: computed from q, or prescribed; refreshed in every step, or frozen for an interval."""

from __future__ import annotations

from typing import Any

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.grids.kernels.sweep_law import LANES
from hjprofile.solvers.grids.kernels.wavefront import Given, Nonlocal
from hjprofile.solvers.run import Array, Breakdown, Halt
from hjprofile.solvers.stop import Reason, Stop

NOTHING = np.empty(0)
EVERYWHERE = slice(None)
MOST_VALUES = 1 << 22  # largest number of values of a coefficient that are evaluated at once: 32 MiB


class Factor:
    """The coefficient of f(q) in the schemes, at the current time `t`, which time stepping sets.

    Attributes:
        coefficient: k(t, x), or None for the nonlocal K.
        refresh: refresh interval of a frozen K (§8); None if K is computed in every step.
        frozen_K: the frozen K at the nodes, shape (cells + 1,); empty if none is frozen.
    """

    def __init__(self, grid: Grid, coefficient: Coefficient | None = None, refresh: float | None = None):
        self.grid, self.coefficient, self.refresh = grid, coefficient, refresh
        self.t, self.frozen_K = 0.0, NOTHING
        if coefficient is not None and coefficient.steady:
            self.frozen_K = coefficient.values(0.0, grid.nodes)

    @property
    def checkpoint_fields(self) -> tuple[str, ...]:
        """The checkpoint fields."""
        return ("frozen_K",) if self.refresh else ()

    @property
    def steps(self) -> int:
        """The most steps that may be taken at once."""
        varies = self.coefficient is not None and not self.frozen_K.size
        return min(LANES, max(1, MOST_VALUES // self.grid.cells)) if varies else LANES

    def given(self, after: Any = 0.0, nodes: slice = EVERYWHERE) -> Array | None:
        """Return the prescribed or frozen K at these nodes at times `after` from now; None if q determines K.

        The shape is (times, nodes), or (1, nodes) if K is the same at all times. Raise Halt if K is not a positive
        number.
        """
        if self.frozen_K.size:
            return self.frozen_K[None, nodes]
        if self.coefficient is None:
            return None
        try:
            return self.coefficient.values(self.t + np.atleast_1d(after)[:, None], self.grid.nodes[nodes])
        except RunError as error:
            raise Halt(Stop(Reason.BAD_COEFFICIENT, "{said}", values={"said": error})) from None

    def window(self, law: GridLaw, after: Array, first: int, last: int) -> tuple[Nonlocal | Given, float]:
        """Return K at the nodes first..last for compiled loops, and the largest K f' outside of them.

        The nonlocal K is nowhere larger outside than inside the window; a prescribed one can be.
        """
        k = self.given(after)
        if k is None:
            return Nonlocal(), 0.0
        speed_outside = max(float(k[:, : first + 1].max()), float(k[:, last + 1 :].max(initial=0.0)))
        speed = speed_outside * float(law.derivative(np.zeros(1))[0])
        return Given(np.ascontiguousarray(k[:, first : last + 1])), speed

    def fill(self, law: GridLaw, q: Array, K: Array) -> tuple[GridLaw, float]:
        """Fill K at the nodes, from q by the midpoint rule if it is not prescribed (§12).

        Return the law for slopes as large as q, and the largest K f'. Raise Breakdown if q is not above -1 everywhere,
        or if K f' is not a finite number.
        """
        if not q.min() > -1.0:  # excludes NaN
            raise Breakdown(q, K)
        law = law.covering(q)
        k = self.given()
        if k is None:
            law.fill_K(q, self.grid.dx, K)
        else:
            K[:] = k[0]
        speed = law.fastest(q, K)
        if not 0.0 < speed < np.inf:
            raise Breakdown(q, K)
        return law, speed
