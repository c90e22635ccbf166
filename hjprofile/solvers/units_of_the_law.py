"""Problems in units in which f'(0) is near 1, so that thresholds of the solvers need no scale.

If u solves the equation with the law f, then u(λx, λ²t)/λ solves it with λf; q and K are unchanged. The length λ is the
power of 2 nearest to R(0) = 1/f'(0), so all numbers change without rounding, and most laws have λ = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from typing import Any

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.erosion import ErosionLaw, Function
from hjprofile.problem.grid import Grid
from hjprofile.problem.line import stretched
from hjprofile.problem.schema import with_origin
from hjprofile.solvers.run import Run
from hjprofile.solvers.stop import Stop, Stopped


@dataclass(frozen=True)
class Units:
    """Units of length λ and of time λ² for a problem on the half line."""

    length: float

    @classmethod
    def of(cls, law: ErosionLaw) -> Units:
        """Return the units in which R(0) lies between 1/√2 and √2."""
        return cls(float(np.exp2(np.round(np.log2(float(law.R(0.0)))))))

    @property
    def time(self) -> float:
        return self.length**2

    @property
    def inverse(self) -> Units:
        """The inverse units."""
        return Units(1.0 / self.length)

    def problem(self, problem: Problem) -> Problem:
        """Return the problem in these units."""
        if self.length == 1.0:
            return problem
        law = problem.law
        return replace(
            problem,
            law=_stretched_law(law.f, law.derivative, law.closed_inverse, law.eta0, self.length),
            profile=stretched(problem.profile, 1.0 / self.length),
            end=problem.end / self.time,
            snapshots=(problem.times / self.time).tolist(),
        )

    def grid(self, grid: Grid) -> Grid:
        """Return the grid in these units."""
        if self.length == 1.0:
            return grid  # with its nodes, which are computed once
        return replace(grid, left=grid.left / self.length, right=grid.right / self.length)

    def stop(self, stop: Stop) -> Stop:
        """Return the reason of a stop with its times and positions in the units of the problem."""
        return stop.mapped(lambda t: t * self.time, lambda x: x * self.length)

    def run(self, run: Run, problem: Problem, grid: Grid) -> Run:
        """Return a run of `self.problem(problem)` on `self.grid(grid)` as one of the problem on the grid."""
        if self.length == 1.0:
            return run
        length, time = self.length, self.time
        case = resolved_case(problem, grid, run.method)
        at = dict(zip((problem.times / time).tolist(), problem.times.tolist(), strict=True))
        return replace(
            run,
            case={**run.case, **{name: case[name] for name in ("erosion", "profile", "domain", "time")}},
            time=problem.times[: len(run.time)],
            x=grid.nodes,
            x_cell=grid.centres,
            u=run.u * length,
            stop=run.stop and self.stop(run.stop),
            step_range=(run.step_range[0] * time, run.step_range[1] * time),
            kinks=[
                k._replace(
                    time=at.get(k.time, k.time * time), x=k.x * length, speed=k.speed / length,
                    rankine_hugoniot_speed=k.rankine_hugoniot_speed / length,
                ) for k in run.kinks
            ],
            events=[e._replace(time=e.time * time, x=e.x * length) for e in run.events],
            vertical_steps=None if run.vertical_steps is None else [
                s._replace(
                    time=at.get(s.time, s.time * time), x=s.x * length, height=s.height * length, speed=s.speed / length
                ) for s in run.vertical_steps
            ],
            bounds={n: b._replace(time=b.time * time, x=b.x * length) for n, b in run.bounds.items()},
            eroded_volume=run.eroded_volume * length**2,
            toe_outflow=run.toe_outflow * time,
            crest_lowering=run.crest_lowering * length,
            volume_budget_error=run.volume_budget_error * length**2,
            error_estimate=None if run.error_estimate is None else run.error_estimate * length,
            units=problem.profile.units,
            surveyed=problem.profile.surveyed,
            account=problem.profile.account,
        )  # fmt: skip


def in_units_of_the_law(solver: Callable[..., Run]) -> Callable[..., Run]:
    """Return a solver of problems on the half line and their grids that works in `Units`."""

    def solve(problem: Problem, grid: Grid, *args: Any, **kwargs: Any) -> Run:
        units = Units.of(problem.law)
        if units.length == 1.0:
            return solver(problem, grid, *args, **kwargs)
        try:
            return units.run(solver(units.problem(problem), units.grid(grid), *args, **kwargs), problem, grid)
        except Stopped as error:
            raise Stopped(units.stop(error.stop)) from None

    return wraps(solver)(solve)


@lru_cache(maxsize=8)  # tables of a law are cached by the identity of its f
def _stretched_law(
    f: Function, derivative: Function, inverse: Function | None, eta0: float, length: float
) -> ErosionLaw:
    """Return the law λf."""
    law = ErosionLaw(
        lambda q: length * f(q),
        lambda q: length * derivative(q),
        None if inverse is None else lambda y: inverse(np.asarray(y, dtype=float) / length),
        length * eta0,
    )
    return with_origin(law, table={"law": "stretched"})
