"""The kinds of initial profiles, and the functions that make them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.kinds import LIST, NUMBER
from hjprofile.problem.lists import above_minus_one, numbers, same_length, within
from hjprofile.problem.profile_base import TAIL, Profile, kind
from hjprofile.problem.ranges import Array, number
from hjprofile.problem.units import SurveyLine, Units

GAUSS = np.polynomial.legendre.leggauss(16)


@kind("kinks", positions=LIST, amplitudes=LIST)
@dataclass(frozen=True, eq=False, repr=False)
class Kinks(Profile):
    """A profile of kinks: q jumps up to amplitudes[j] at positions[j] and decays by R'(q) q_x = -q (§13); 0 on
    the left.
    """

    positions: Array
    amplitudes: Array

    def __post_init__(self) -> None:
        x, a = numbers("positions", self.positions), numbers("amplitudes", self.amplitudes)
        same_length(positions=x, amplitudes=a)
        if np.any(np.diff(x) <= 0):
            raise InputError(f"positions = {x.tolist()} must increase from left to right")
        object.__setattr__(self, "positions", x)
        object.__setattr__(self, "amplitudes", a)

    def start(self, tail: float = TAIL) -> float:
        return float(self.positions[0])

    def marks(self) -> Array:
        return self.positions

    def check(self, grid: Grid, law: ErosionLaw) -> None:
        within(grid, "positions", self.positions)
        self._pieces(law)
        super().check(grid, law)

    def breaks(self, law: ErosionLaw) -> Array:
        gaps = np.diff(self.positions)
        met = [float(law.decay(a, gap)) for a, gap in zip(self.amplitudes[:-1], gaps, strict=True)]
        return np.column_stack([self.positions, [0.0, *met], self.amplitudes])

    def excess(self, x: Array, law: ErosionLaw) -> Array:
        j = np.searchsorted(self.positions, x, side="right") - 1
        q = np.zeros_like(x)
        for i in np.unique(j[j >= 0]):
            q[j == i] = law.decay(self.amplitudes[i], x[j == i] - self.positions[i])
        return q

    def _pieces(self, law: ErosionLaw) -> list[float]:
        """Return W at each position."""
        W, met, at = 0.0, 0.0, []
        for j, (x, a) in enumerate(zip(self.positions, self.amplitudes, strict=True)):
            if j:
                before = self.amplitudes[j - 1]
                met = float(law.decay(before, x - self.positions[j - 1]))
                W += float(law.R(before) - law.R(met))
            if not a > met:
                raise InputError(
                    f"amplitudes[{j}] = {a:g} must exceed q = {met:.6g} on the left of the kink at x = {x:g}, "
                    "because a kink is an upward jump of q"
                )
            at.append(W)
        return at

    def W(self, x: Array, law: ErosionLaw) -> Array:
        W = np.zeros_like(x)
        ends = np.append(self.positions[1:], np.inf)
        for x0, x1, a, W0 in zip(self.positions, ends, self.amplitudes, self._pieces(law), strict=True):
            here = (x > x0) & (x <= x1)
            if here.any():
                W[here] = W0 + law.R(a) - law.R(law.decay(a, x[here] - x0))
        return W


@kind("bumps", amplitudes=LIST, centres=LIST, widths=LIST)
@dataclass(frozen=True, eq=False, repr=False)
class Bumps(Profile):
    """A profile of Gaussian bumps, q = Σ a exp(-((x - c)/w)²)."""

    amplitudes: Array
    centres: Array
    widths: Array

    def __post_init__(self) -> None:
        a, c, w = (numbers(n, getattr(self, n)) for n in ("amplitudes", "centres", "widths"))
        same_length(amplitudes=a, centres=c, widths=w)
        for name, value in (("amplitudes", a), ("centres", c), ("widths", w)):
            object.__setattr__(self, name, value)
        self._check_slopes(0.0)

    def _check_slopes(self, right: float) -> None:
        """Check q by its formula, sampled finely around every bump, because a cell mean can hide a narrow dip."""
        reach = self.widths[:, None] * np.linspace(-5, 5, 2001)
        x = np.minimum((self.centres[:, None] + reach).ravel(), right)
        q = self.excess(x) if self.amplitudes[self.amplitudes < 0.0].sum() <= -1.0 else np.zeros(1)
        least = int(np.argmin(q))
        if q[least] <= -1:
            place = f"q = {q[least]:.6g} at x = {x[least]:.6g}"
            raise InputError(f"{place}; q must be above -1 everywhere (u_x = 1 + q > 0)")

    def marks(self) -> Array:
        return (self.centres[:, None] + self.widths[:, None] * np.linspace(-6.0, 6.0, 25)).ravel()

    def check(self, grid: Grid, law: ErosionLaw) -> None:
        self._check_slopes(grid.right)
        super().check(grid, law)

    def excess(self, x: Array, law: ErosionLaw | None = None) -> Array:
        bumps = zip(self.amplitudes, self.centres, self.widths, strict=True)  # one by one, to save memory
        return sum((a * np.exp(-np.square((x - c) / w)) for a, c, w in bumps), np.zeros_like(x))

    def start(self, tail: float = TAIL) -> float:
        reach = np.sqrt(np.log(np.maximum(np.abs(self.amplitudes) / tail, 1.0)))
        return float(np.min(self.centres - self.widths * reach))

    def W(self, x: Array, law: ErosionLaw) -> Array:
        from scipy.special import erfc

        bumps = zip(0.5 * np.sqrt(np.pi) * self.amplitudes * self.widths, self.centres, self.widths, strict=True)
        with np.errstate(over="ignore"):  # underflow far from a narrow bump
            return sum((mass * erfc((c - x) / w) for mass, c, w in bumps), np.zeros_like(x))


@kind("points", x=LIST, q=LIST)
@dataclass(frozen=True, eq=False, repr=False)
class Points(Profile):
    """A piecewise linear profile of q between points (x, q), with a jump at a repeated x, and q = 0 outside."""

    x: Array
    q: Array
    source: Mapping[str, Any] = field(default_factory=dict)
    units: Units | None = None
    height: float = 0.0  # u - x on the left
    account: str = ""
    surveyed: SurveyLine | None = None
    rounding: float = 0.0

    def __post_init__(self) -> None:
        x, q = numbers("x", self.x, 2), numbers("q", self.q, 2)
        same_length(x=x, q=q)
        if np.any(np.diff(x) < 0):
            raise InputError(f"x[{np.argmax(np.diff(x) < 0) + 1}] must not be left of the point before it")
        if np.any((np.diff(x)[1:] == 0) & (np.diff(x)[:-1] == 0)):
            raise InputError("x holds a position three times; a jump is a position that is given twice")
        above_minus_one("q", q)
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "q", q)

    def start(self, tail: float = TAIL) -> float:
        return float(self.x[0])

    def marks(self) -> Array:
        return self.x

    def check(self, grid: Grid, law: ErosionLaw) -> None:
        if self.table["kind"] == "steps":
            within(grid, "edges", np.unique(self.x))
        within(grid, "x", self.x)
        super().check(grid, law)

    def breaks(self, law: ErosionLaw) -> Array:
        x = np.unique(self.x)
        left = self.q[np.searchsorted(self.x, x, side="left")]
        right = self.q[np.searchsorted(self.x, x, side="right") - 1]
        left[0] = right[-1] = 0.0
        return np.column_stack([x, left, right])

    def _place(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the piece that contains x, the distance from its start, and that distance relative to its length."""
        h = np.diff(self.x)
        inside = np.clip(x, self.x[0], self.x[-1])
        j = np.clip(np.searchsorted(self.x, inside, side="right") - 1, 0, h.size - 1)
        s = np.minimum(inside - self.x[j], h[j])
        # a piece of length 0 (a jump at the last point) is evaluated at its start only
        return j, s, np.divide(s, h[j], out=np.zeros_like(s), where=h[j] > 0)

    def excess(self, x: Array, law: ErosionLaw) -> Array:
        j, _, part = self._place(x)
        return np.where((x < self.x[0]) | (x > self.x[-1]), 0.0, self.q[j] + part * np.diff(self.q)[j])

    def W(self, x: Array, law: ErosionLaw) -> Array:
        h = np.diff(self.x)
        mass = np.concatenate([[0.0], np.cumsum(0.5 * h * (self.q[1:] + self.q[:-1]))])
        j, s, part = self._place(x)
        return self.height + mass[j] + s * (self.q[j] + 0.5 * part * np.diff(self.q)[j])


@kind("steady", flux=NUMBER, kink=NUMBER)
@dataclass(frozen=True, eq=False, repr=False)
class Steady(Profile):
    """The steady slope q = f⁻¹(a/(1 - a x)), whose flux is a everywhere, right of a kink at s0 (§5e-f).

    Without a kink it fills the whole grid, and the flux a enters at the left end.
    """

    flux: float
    kink: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "flux", number("flux", self.flux))
        if self.kink is not None:
            object.__setattr__(self, "kink", number("kink", self.kink))

    @property
    def inflow(self) -> float:
        return self.flux if self.kink is None else 0.0

    def start(self, tail: float = TAIL) -> float:
        return -np.inf if self.kink is None else self.kink

    def marks(self) -> Array:
        return np.empty(0) if self.kink is None else np.array([self.kink])

    def breaks(self, law: ErosionLaw) -> Array:
        if self.kink is None:
            return np.empty((0, 3))
        return np.array([[self.kink, 0.0, float(self.excess(np.array(self.kink), law))]])

    def excess(self, x: Array, law: ErosionLaw) -> Array:
        """Return q of the steady slope itself, on either side of a kink."""
        return law.inverse(self.flux / (1.0 - self.flux * x))

    def check(self, grid: Grid, law: ErosionLaw) -> None:
        try:
            top = law.inverse(np.array(self.flux))
            # within rounding of its supremum f no longer distinguishes slopes
            reached = top < 1.0 or law.f(0.5 * top) < (1 - 1e-12) * self.flux
        except ValueError:
            reached = False
        if not reached:
            raise InputError(
                f"flux = {self.flux:g} is not a value of the law {law.name!r}; it must be below the supremum of f"
            )
        super().check(grid, law)

    def W(self, x: Array, law: ErosionLaw) -> Array:
        # W = ∫ q from the kink, by Gauss-Legendre quadrature of an analytic function between neighbouring x
        first = float(np.min(x)) if self.kink is None else self.kink
        ordered, back = np.unique(np.maximum(x, first), return_inverse=True)
        edges = np.concatenate([[first], ordered])
        z, weights = GAUSS
        h = np.diff(edges)
        at = edges[:-1, None] + 0.5 * h[:, None] * (1.0 + z)
        return np.cumsum(0.5 * h * (self.excess(at, law) @ weights))[back].reshape(x.shape)


def kinks(positions: Sequence[float], amplitudes: Sequence[float]) -> Profile:
    """Return a profile of kinks: q jumps up to `amplitudes` at `positions` and decays between them by the law (theory,
    §13).

    Args:
        positions: x of the kinks, shape (n,), in exchange lengths, increasing, at most 0 on the half line.
        amplitudes: q right of each kink, shape (n,), in neutral slopes. Each exceeds q left of its kink, which depends
            on the law and is checked when a run begins. q = 0 left of the first kink.

    Returns:
        The profile.

    Raises:
        InputError: for other lists.

    >>> import hjprofile as hj
    >>> slope = hj.kinks([-7.0, -5.0], [0.4, 1.2])
    >>> print(slope.breaks(hj.rational()).round(3))
    [[-7.     0.     0.4  ]
     [-5.     0.054  1.2  ]]
    """
    return Kinks(positions, amplitudes)  # type: ignore[arg-type]


def bumps(amplitudes: Sequence[float], centres: Sequence[float], widths: Sequence[float]) -> Profile:
    """Return a profile of Gaussian bumps, q = Σ a exp(-((x - c)/w)²).

    Args:
        amplitudes: a, shape (n,), in neutral slopes; q must stay above -1.
        centres: c, shape (n,), in exchange lengths.
        widths: w, shape (n,), in exchange lengths, positive.

    Returns:
        The profile.

    Raises:
        InputError: for other lists, and if q is not above -1.

    >>> import hjprofile as hj
    >>> slope = hj.bumps(amplitudes=[1.5], centres=[-4.0], widths=[0.7])
    >>> round(slope.start(), 2)
    -6.64
    """
    return Bumps(amplitudes, centres, widths)  # type: ignore[arg-type]


def points(x: Sequence[float], q: Sequence[float]) -> Profile:
    """Return a piecewise linear profile of q, with q = 0 outside.

    Args:
        x: positions, shape (n,), n >= 2, in exchange lengths, not decreasing, at most 0 on the half line. A position
            that is given twice is a jump.
        q: u_x - 1 at these positions, shape (n,), in neutral slopes, above -1.

    Returns:
        The profile.

    Raises:
        InputError: for other lists.

    >>> import hjprofile as hj
    >>> hj.points(x=[-6.0, -5.0, -5.0, -3.0], q=[0.0, 0.5, 1.0, 0.0]).start()
    -6.0
    """
    return Points(x, q)  # type: ignore[arg-type]


@kind("steps", edges=LIST, values=LIST)
def steps(edges: Sequence[float], values: Sequence[float]) -> Profile:
    """Return a piecewise constant profile of q: q = values[i] on (edges[i], edges[i+1]), and 0 outside.

    Args:
        edges: shape (n + 1,), in exchange lengths, increasing, at most 0 on the half line.
        values: q = u_x - 1, shape (n,), in neutral slopes, above -1.

    Returns:
        The profile.

    Raises:
        InputError: for other lists.

    >>> import hjprofile as hj
    >>> hj.steps(edges=[-4.0, -3.0, -2.0], values=[0.8, 0.3]).start()
    -4.0
    """
    e, v = numbers("edges", edges, 2), numbers("values", values)
    if e.size != v.size + 1:
        raise InputError(f"edges has {e.size} entries and values has {v.size}; edges must have one more than values")
    if np.any(np.diff(e) <= 0):
        raise InputError(f"edges = {e.tolist()} must increase from left to right")
    above_minus_one("values", v)
    return Points(np.repeat(e, 2)[1:-1], np.repeat(v, 2))


def steady(flux: float, kink: float | None = None) -> Profile:
    """Return the steady slope of a given erosion flux, right of a kink if one is given (§5e-f).

    Args:
        flux: F = K f(q), dimensionless, positive and below the supremum of f (1 for `rational`), which is checked when
            a run begins.
        kink: x of the kink, in exchange lengths, negative; None for a slope that fills the grid. Then the flux enters
            at the left end, and a grid must be given.

    Returns:
        The profile.

    Raises:
        InputError: for other numbers.

    >>> import hjprofile as hj
    >>> hj.steady(flux=0.5, kink=-1.0).inflow
    0.0
    """
    return Steady(flux, kink)
