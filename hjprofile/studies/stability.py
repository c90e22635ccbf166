"""Scan of the stability limits of the methods, compared with theory (§3).

A trial uses steps of a stated CFL number Δt max(K f')/Δx, without repetition or adaptation. Its data contain a sawtooth
of negligible amplitude, so that an instability develops within the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.case import AnyCase, as_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import instance
from hjprofile.solvers.grids.bounds_monitor import HIGHER_ORDER, LOCAL, MONOTONE, BoundsMonitor, Guarantees
from hjprofile.solvers.grids.conservation import FirstOrder, SecondOrder
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import GridLaw, grid_law
from hjprofile.solvers.grids.hamilton_jacobi import HamiltonJacobi, HighOrderHamiltonJacobi
from hjprofile.solvers.grids.high_order import ssp_rk2
from hjprofile.solvers.grids.scheme import Scheme
from hjprofile.solvers.method import Form, Method, require, requirements
from hjprofile.solvers.methods import FLUXES, METHODS
from hjprofile.solvers.run import Array, Breakdown, State
from hjprofile.solvers.stop import ROBUST_METHOD

CELLS = 400
STEPS = 6000  # largest number of steps in a trial
SAWTOOTH = 1e-8  # amplitude: well above rounding, and below the resolution of any bound or plot
OSCILLATION = 0.02  # growth of TV(q) beyond that of the equation, as a fraction of 1 + TV(q)
CFL = (0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.4, 1.6, 1.8, 2.0, 2.25, 2.5, 2.75, 3.0)
VISCOSITY = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1, 1.2, 1.4, 1.6, 1.8, 2.0)  # of max K f'
VISCOSITY_AT = (0.45, 0.7, 0.9)  # CFL numbers
REFRESH = (1, 4, 16, 64, 256, 1024)  # number of steps with the same K
SMALLEST = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4)  # 1 + q in a hollow
EXPONENTS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 600.0, 800.0)  # largest |ln K|
CUTS = (-0.2, -0.1, 0.0, 0.1, 0.2, 0.4)  # fractions of the support that the grid omits on the left
BISECTIONS = 6
SAFE = 0.6  # CFL number below the limits of all methods
HIGHEST_EXPONENT = float(np.log(np.finfo(float).max))

HOLDS, LOSES, OSCILLATES, FAILS = "holds", "loses_bounds", "oscillates", "fails"


class Trial(NamedTuple):
    """One point of the scan.

    Attributes:
        theory: the theoretical limit of the parameter, NaN if there is none.
        cfl: the CFL number at which another parameter was varied, NaN if that is the same for all.
    """

    case: str
    method: str
    parameter: str
    value: float | str
    outcome: str
    detail: str
    theory: float
    cfl: float = np.nan


@dataclass(frozen=True)
class _Data:
    """Cell means on a grid, and the duration of the trial."""

    problem: Problem
    grid: Grid
    q: Array
    end: float

    @property
    def law(self) -> GridLaw:
        return grid_law(self.problem.law, self.q)

    @property
    def W(self) -> Array:
        return np.concatenate([[0.0], np.cumsum(self.q) * self.grid.dx])


class _Laboratory(FirstOrder):
    """The plain schemes for q with unsafe options: any viscosity, an outdated K, reconstructions without a limiter."""

    def __init__(
        self, data: _Data, flux: str = ROBUST_METHOD, viscosity: float = 1.0, refresh: int = 1, edges: str = "monotone"
    ):
        super().__init__(data.law, data.grid, data.q, 0.0, 0.0, FLUXES[flux])
        self.viscosity, self.refresh, self.edges = viscosity, refresh, edges
        self.taken = 0
        self.stale = self.K

    def advance(self, dt: float, steps: int, bound: float) -> float:
        if self.taken % self.refresh == 0:
            self.stale = self.K
        self.taken += 1
        rate = partial(self._rate, bound=bound)
        # with forward Euler steps all edges except the monotone ones are unstable
        q = self.q + dt * rate(self.q) if self.edges == "monotone" else ssp_rk2(self.q, rate, dt)
        self.toe_gain += dt * (float(self.K[0]) - 1.0)  # by the current K
        self.crest_lowering += self.grid.dx * float(np.sum(self.q) - np.sum(q))
        self.q = q
        return bound

    def _rate(self, q: Array, bound: float) -> Array:
        """Return dq/dt with the chosen reconstruction."""
        if not np.min(q) > -1.0:
            raise Breakdown(q, self.K)
        K, dx, left, right = self.stale, self.grid.dx, q, np.append(q[1:], q[-1])
        if self.edges != "monotone":
            K = np.exp(np.append(np.cumsum(dx * self.law.f(q)[::-1])[::-1], 0.0))  # K of the stage
            back, ahead = np.diff(q, prepend=q[0]), np.diff(q, append=q[-1])
            if self.edges == "central":
                left = 0.5 * (left + right)
            elif self.edges == "unlimited":  # Fromm's
                left = q + 0.25 * (back + ahead)
            else:  # limited by minmod
                least = np.sign(back) * np.minimum(np.abs(back), np.abs(ahead))
                left = q + 0.5 * np.where(back * ahead > 0.0, least, 0.0)
            right = left
            if not np.min(left) > -1.0:
                raise Breakdown(left, self.K)
        F, _ = self.flux.twin(self.law, dx, left, right, K, self.viscosity * bound)
        return -np.diff(F, prepend=0.0) / dx


@dataclass(frozen=True)
class Stability:
    """Results of the scan.

    Attributes:
        case: the name of the case.
        rows: the trials.
    """

    case: str
    rows: tuple[Trial, ...]

    @property
    def limits(self) -> dict[str, tuple[float, float, float]]:
        """Method -> the last CFL number with all bounds, the first without (inf: none), and the proved limit or NaN."""
        proved = {t.method: t.theory for t in self.rows if t.parameter == "cfl"}
        return {method: (*measured_limit(self.rows, method), theory) for method, theory in proved.items()}

    def __str__(self) -> str:
        """Return the account: the limits of the CFL number for each method."""
        lines = [f"{self.case}: {len(self.rows)} trials. Largest stable CFL number, measured (proved):"]
        for method, (low, high, theory) in self.limits.items():
            limit = f"{low:.4g} to {high:.4g}" if high < float("inf") else f"all up to {low:.4g}"
            lines.append(f"  {method:22} {limit:18} ({f'{theory:.4g}' if theory == theory else 'none'})")
        return "\n".join(lines)


def stability(case: AnyCase, progress: Callable[[float], None] | None = None) -> Stability:
    """Scan the limits of stability of each method on a grid, on one case.

    The scan varies the CFL number, viscosity, age of K, reconstruction, smallness of 1 + q, size of ∫f and truncation,
    on a grid of 400 cells. It takes about a minute.

    Args:
        case: a `Case`, the path of a case file, the name of a shipped case, or the tables of a case file.
        progress: a function that is called with the completed fraction in [0, 1].

    Returns:
        The trials and the limits. Printed, they are a table of the limits.

    Raises:
        InputError: for invalid input, if a flux enters, if the end is 0, if the slope is neutral everywhere, or for
            another model than slow erosion on the half line.

    >>> import hjprofile as hj
    >>> hj.stability("travelling_kink").limits["godunov"][2]  # doctest: +SKIP
    1.0
    """
    case = as_case(case)
    return Stability(case.name, tuple(scan(case.name, case.problem, case.grid, progress)))


def scan(case: str, problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None) -> list[Trial]:
    """Scan CFL number, viscosity, age of K, reconstruction, smallness of 1 + q, size of ∫f and truncation.

    The grid has CELLS cells. Raise InputError if a flux enters, if the end is 0, if the slope is neutral everywhere, or
    if a coefficient is prescribed.
    """
    instance("problem", problem, Problem)
    instance("grid", grid, Grid)
    require(f"{case}: the scan of stability", (), requirements(problem))
    grid = Grid(grid.left, CELLS)
    q = np.diff(problem.profile.W(grid.nodes, problem.law)) / grid.dx
    if not problem.end > 0.0 or not np.abs(q).max() > 0.0:
        raise InputError(
            f"{case}: the profile does not change; a scan needs an end above 0 and a slope that is not neutral"
        )
    data = _Data(problem, grid, q, problem.end)
    points: list[Trial] = []
    scans = (_cfl, _viscosity, _refresh, _reconstruction, _smallness, _exponents, _truncation)
    for i, part in enumerate(scans):
        points += (Trial(case, *row) for row in part(data))
        if progress:
            progress((i + 1) / len(scans))
    return points


Limits = tuple[str, str, float | str, str, str, float]
Row = Limits | tuple[str, str, float | str, str, str, float, float]  # a Trial without its case


def _cfl(data: _Data) -> Iterator[Row]:
    """Scan CFL numbers for every method, with bisection for the limit of the monotone ones."""
    for method, guarantees in _methods():

        def attempt(number: float) -> tuple[str, str]:
            return _attempt(_scheme(method, data), data, number, guarantees, _judged_by(method))  # noqa: B023

        tried = {number: attempt(number) for number in CFL}
        broken = [n for n in CFL if tried[n][0] != HOLDS]
        if guarantees is not HIGHER_ORDER and broken:
            low = max([n for n in CFL if n < broken[0]], default=0.0)
            high = broken[0]
            for _ in range(BISECTIONS):
                middle = round(0.5 * (low + high), 4)
                tried[middle] = attempt(middle)
                low, high = (middle, high) if tried[middle][0] == HOLDS else (low, middle)
        for number in sorted(tried):
            yield method.name, "cfl", number, *tried[number], method.cfl_proved


def _viscosity(data: _Data) -> Iterator[Row]:
    """Scan viscosity and CFL number of Lax-Friedrichs: monotone between α = max K f' and α = Δx/Δt."""
    for number in VISCOSITY_AT:
        for share in VISCOSITY:
            scheme = _Laboratory(data, "lax-friedrichs", viscosity=share)
            outcome, detail = _attempt(scheme, data, number, MONOTONE, FLUXES["lax-friedrichs"], share)
            yield "lax-friedrichs", f"viscosity at cfl {number:g}", share, outcome, detail, 1.0, number


def _refresh(data: _Data) -> Iterator[Row]:
    """Scan the age of K: the scheme stays monotone, kinks move at a wrong speed, and the eroded volume is wrong."""
    for steps in REFRESH:
        scheme = _Laboratory(data, refresh=steps)
        before = scheme.volume()
        outcome, detail = _attempt(scheme, data, SAFE, MONOTONE)
        off = abs(before - scheme.volume() - scheme.toe_gain)
        yield ROBUST_METHOD, "refresh", float(steps), outcome, f"{detail}; volume off by {off:.3g}", np.nan


def _reconstruction(data: _Data) -> Iterator[Row]:
    """Scan the reconstructions."""
    for edges in ("monotone", "limited", "unlimited", "central"):
        scheme = _Laboratory(data, edges=edges)
        guarantees = MONOTONE if edges == "monotone" else HIGHER_ORDER
        yield ROBUST_METHOD, "reconstruction", edges, *_attempt(scheme, data, 0.5 * SAFE, guarantees), np.nan


def _smallness(data: _Data) -> Iterator[Row]:
    """Scan the depth of a hollow, a twentieth of the domain wide, for each method."""
    n = data.q.size
    for method, guarantees in _methods():
        for p in SMALLEST:
            q = data.q.copy()
            q[n // 2 : n // 2 + n // 20] = p - 1.0
            hollow = _Data(data.problem, data.grid, q, data.end)
            # MUSCL-Hancock advances K by half a cell by 1 + ½ f dx, which must stay positive
            limit = np.nan
            if method.name == "conservative":
                tries = np.geomspace(1e-6, 1.0, 400)
                limit = float(tries[np.searchsorted(data.problem.law.f(tries - 1.0) * data.grid.dx, -2.0)])
            yield method.name, "least 1 + q", p, *_attempt(_scheme(method, hollow), hollow, SAFE, guarantees), limit


def _exponents(data: _Data) -> Iterator[Row]:
    """Scan the length of the grid with the same slopes, which is proportional to ln K."""
    exponent = np.abs(np.cumsum(data.law.f(data.q)[::-1])).max() * data.grid.dx
    for method, guarantees in _methods():
        for most in EXPONENTS:
            stretch = float(most / exponent)
            grid = Grid(stretch * data.grid.left, CELLS)
            # until the first kink has crossed a few cells, which is a short time if K is large
            longer = _Data(data.problem, grid, data.q, 20.0 * stretch * data.grid.dx * float(np.exp(-min(most, 700.0))))
            outcome, detail = _attempt(_scheme(method, longer), longer, SAFE, guarantees)
            yield method.name, "largest |ln K|", most, outcome, detail, HIGHEST_EXPONENT


def _truncation(data: _Data) -> Iterator[Row]:
    """Scan left ends inside the support of q: the result right of them is compared with a run on the whole grid."""
    support = np.flatnonzero(np.abs(data.q) > 1e-9)
    start, width = int(support[0]), int(support[-1] - support[0]) + 1
    whole = _Laboratory(data)
    same = partial(_attempt, number=SAFE, guarantees=MONOTONE, saw=0.0, steps=60, speed=2.0 * whole.evaluate())
    same(whole, data)
    for cut in CUTS:
        first = max(start + round(cut * width), 0)
        x = float(data.grid.nodes[first])
        part = _Data(data.problem, Grid(x, data.q.size - first), data.q[first:], data.end)
        scheme = _Laboratory(part)
        outcome, detail = same(scheme, part)
        differs = np.flatnonzero(np.abs(scheme.q - whole.q[first:]) > 1e-10)
        if outcome == HOLDS and differs.size:
            reach = float(part.grid.nodes[differs[-1] + 1])
            outcome, detail = LOSES, f"q is wrong from x = {x:.4g} to {reach:.4g}: what lies left of the grid is lost"
        yield ROBUST_METHOD, "left end", x, outcome, detail, float(data.grid.nodes[start])


def _scheme(method: Method, data: _Data) -> Scheme:
    """Return the scheme of a method for cell means that belong to no profile."""
    if method.flux:
        return HamiltonJacobi(data.law, data.grid, data.W, method.flux)
    if method.form is Form.SLOPE:
        return SecondOrder(data.law, data.grid, data.q, 0.0, 0.0)
    return HighOrderHamiltonJacobi(data.law, data.grid, data.W, method.name, 0.0)


def _methods() -> list[tuple[Method, Guarantees]]:
    """Return every method on a grid with its own scheme, and its monitored bounds."""
    own = [method for method in METHODS.values() if method.on_grid and not method.carries]
    assert all(method.setup for method in own)
    # with a viscosity that changes from step to step the bounds of frozen steps do not hold here
    return [(m, LOCAL if m.flux and m.flux.viscous else m.setup.guarantees) for m in own]  # type: ignore[union-attr]


def _judged_by(method: Method) -> Flux | None:
    """Return the flux of frozen steps, or None: with a local viscosity a step does not preserve the order of states."""
    guarantees = method.setup.guarantees if method.setup else {}
    return method.flux if guarantees.get("kruzkov") else None


@np.errstate(all="ignore")
def _attempt(
    scheme: Scheme, data: _Data, number: float, guarantees: Guarantees, flux: Flux | None = None,
    viscosity: float = 1.0, saw: float = SAWTOOTH, steps: int | None = None, speed: float = 0.0,
) -> tuple[str, str]:  # fmt: skip
    """Return outcome and detail of steps of one CFL number; `speed` replaces a smaller max K f'."""
    grid, t = data.grid, 0.0
    _roughen(scheme, saw)
    bounds = BoundsMonitor(data.problem, grid, scheme.W, guarantees, flux if viscosity >= 1.0 else None)
    taken, oscillates = 0, ""
    try:
        while True:
            fastest = max(scheme.evaluate(), speed)
            first, q = scheme.means()
            scheme.law = scheme.law.covering(q)
            bound = viscosity * fastest
            dt = number * grid.dx / fastest
            bounds.observe(
                State(t, taken, first, q, scheme.law.kernel, fastest, bound, dt, scheme.toe_gain, scheme.crest_lowering,
                      scheme.volume)
            )  # fmt: skip
            grown = float(np.abs(np.diff(q)).sum()) - bounds.variation - bounds.growth_allowed
            if grown > OSCILLATION * (1.0 + bounds.variation):
                oscillates = oscillates or f"TV(q) grows beyond what it may at t = {t:.4g}, step {taken}"
            if t >= data.end or taken >= (STEPS if steps is None else steps):
                break
            dt = min(dt, data.end - t)
            if not np.isfinite(scheme.advance(dt, 1, fastest)):
                raise Breakdown(q, np.full(1, np.inf), first)
            t, taken = t + dt, taken + 1
    except Breakdown as broken:
        x = float(grid.centres[min(broken.cell, grid.cells - 1)])
        what = "the run cannot start" if not taken else f"q = {broken.q:.4g} at x = {x:.4g}, t = {t:.4g}, step {taken}"
        return FAILS, f"{oscillates}; {what}" if oscillates else what
    if t < data.end and steps is None:
        return FAILS, f"the time step collapses: {taken} steps to t = {t:.4g} of {data.end:.4g}"
    if oscillates:
        return OSCILLATES, oscillates
    lost = [(b.worst_margin, name, b) for name, b in bounds.bounds.items() if not b.holds]
    if lost:
        _, name, b = min(lost)
        return LOSES, f"{name} at t = {b.time:.4g}, {-b.worst_margin:.2g} times its allowance; {taken} steps"
    return HOLDS, f"{taken} steps to t = {t:.4g}"


def _roughen(scheme: Scheme, saw: float) -> None:
    """Add the sawtooth to the data."""
    n = scheme.q.size
    teeth = saw * np.where(np.arange(n) % 2, 1.0, -1.0)
    teeth[:2] = teeth[-2:] = 0.0
    for name in ("q", "state", "W"):
        if name in scheme.checkpoint_fields:
            state = getattr(scheme, name)
            dx = float(scheme.grid.dx)  # type: ignore[attr-defined]
            state += teeth if state.size == n else np.append(0.0, np.cumsum(teeth) * dx)
            break
    if "active" in scheme.checkpoint_fields:
        scheme.active = 0, getattr(scheme, name).size - 1  # type: ignore[attr-defined]


def measured_limit(points: Sequence[Trial], method: str) -> tuple[float, float]:
    """Return the last CFL number at which a method satisfies its bounds, and the first at which it does not, or inf."""
    mine = sorted((float(p.value), p.outcome) for p in points if p.method == method and p.parameter == "cfl")
    broken = [value for value, outcome in mine if outcome != HOLDS]
    if not broken:
        return mine[-1][0], np.inf
    return max([v for v, outcome in mine if outcome == HOLDS and v < broken[0]], default=0.0), broken[0]
