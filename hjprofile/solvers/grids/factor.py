"""The factor of the flux: K of q itself, or a prescribed coefficient; anew in every step, or kept for a while."""

from __future__ import annotations

from typing import Any

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.grids.kernels import grid_loops as kernels
from hjprofile.solvers.grids.kernels.sweep_law import LANES
from hjprofile.solvers.grids.kernels.wavefront import Given, Nonlocal
from hjprofile.solvers.run import Array, Breakdown, Halt
from hjprofile.solvers.stop import Reason, Stop

NOTHING = np.empty(0)
EVERYWHERE = slice(None)
MOST_VALUES = 1 << 22  # of a coefficient that are asked for at once: 32 MiB


class Factor:
    """What the schemes multiply f(q) by, at present time `t`, which whoever marches sets.

    Attributes:
        coefficient: k(t, x), or None for the nonlocal factor.
        refresh: how long a factor is kept before it is taken anew (theory, §10); None for anew in every step.
        held: the factor at the nodes as it is kept, shape (cells + 1,); empty where none is.
    """

    def __init__(self, grid: Grid, coefficient: Coefficient | None = None, refresh: float | None = None):
        self.grid, self.coefficient, self.refresh = grid, coefficient, refresh
        self.t, self.held = 0.0, NOTHING
        if coefficient is not None and coefficient.steady:
            self.held = coefficient.values(0.0, grid.nodes)

    @property
    def memory(self) -> tuple[str, ...]:
        """What a checkpoint has to keep."""
        return ("held",) if self.refresh else ()

    @property
    def steps(self) -> int:
        """The most steps that may be taken at once."""
        varies = self.coefficient is not None and not self.held.size
        return min(LANES, max(1, MOST_VALUES // self.grid.cells)) if varies else LANES

    def given(self, after: Any = 0.0, nodes: slice = EVERYWHERE) -> Array | None:
        """The factor at these nodes at times `after` from now, if q does not decide it; else None.

        Shape (times, nodes), or (1, nodes) if it is the same at all of them. Raises Halt if it is no positive number.
        """
        if self.held.size:
            return self.held[None, nodes]
        if self.coefficient is None:
            return None
        try:
            return self.coefficient.values(self.t + np.atleast_1d(after)[:, None], self.grid.nodes[nodes])
        except RunError as error:
            raise Halt(Stop(Reason.BAD_COEFFICIENT, "{said}", values={"said": error})) from None

    def window(self, law: GridLaw, after: Array, first: int, last: int) -> tuple[Nonlocal | Given, float]:
        """The factor at the nodes first..last for compiled loops, and what K f' comes to where nothing happens.

        K of q is nowhere larger there than in what is looked at; what is given can be.
        """
        k = self.given(after)
        if k is None:
            return Nonlocal(), 0.0
        idle = max(float(k[:, : first + 1].max()), float(k[:, last + 1 :].max(initial=0.0)))
        speed = idle * float(law.derivative(np.zeros(1))[0])
        return Given(np.ascontiguousarray(k[:, first : last + 1])), speed

    def fill(self, law: GridLaw, q: Array, K: Array) -> tuple[GridLaw, float]:
        """Fills K at the nodes, from q by the midpoint rule if need be (theory, §2).

        Returns the law for slopes as large as q, and the largest K f'. Raises Breakdown where q is not above -1, or
        K f' not a finite number.
        """
        if not np.min(q) > -1.0:  # nor NaN
            raise Breakdown(q, K)
        law = law.covering(q)
        k = self.given()
        if k is None:
            kernels.exponent(law.f(q), self.grid.dx, K)
            with np.errstate(over="ignore"):  # the speed is looked at below
                np.exp(K, out=K)
        else:
            K[:] = k[0]
        speed = float(kernels.fastest(K, law.derivative(q)))
        if not 0.0 < speed < np.inf:
            raise Breakdown(q, K)
        return law, speed
