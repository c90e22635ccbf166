"""Errors of discretised data against the initial profile, on a sample of the profile that resolves it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import Kinks
from hjprofile.solvers.run import Array

COARSE, FINE = 64, 8192  # intervals of a sample if the profile states its scales, and otherwise
PARTS = 4  # parts of each interval between two marks of a profile
MOST_PARTS = 64  # largest number of parts of an interval with a large change of slope
NEAREST = 1e-11  # smallest distance of two positions, relative to x: q = ΔW/Δx has an error of 1e-16/1e-11
SLOPE, FLUX = 0.1, 0.2  # largest error of q, as a fraction of ‖q‖₁, and of ln K
NO_GRAINS = -40.0  # ln K below which no grains arrive: K f moves nothing there, to rounding
FALL = 0.05  # largest error by an expansion shock, as a fraction of the range of W


class Sample(NamedTuple):
    """A profile at positions x, shape (n,), with W = u - x and ln K there, and the means q between them, (n - 1,)."""

    x: Array
    W: Array
    q: Array
    ln_K: Array


class Resolution(NamedTuple):
    """Errors of discretised data: sup|W_d - W|, ‖q_d - q‖₁/‖q‖₁ and sup|ln K_d - ln K|, all at t = 0.

    `fall` is the error of W, as a fraction of its range, caused by one front that carries a fall of q as a shock.
    """

    height: float
    slope: float
    flux: float
    fall: float = 0.0

    @property
    def holds(self) -> bool:
        """True if the data represent the profile; false if an error is NaN."""
        return self.slope <= SLOPE and self.flux <= FLUX and self.fall <= FALL

    def caution(self, data: str, remedy: str) -> tuple[str, ...]:
        """Return a sentence on `data` that do not represent the profile; no sentence if they do."""
        if self.holds:
            return ()
        faults = [
            f"q is wrong by {100.0 * self.slope:.3g} % of its L1 norm (at most {100.0 * SLOPE:g} %)",
            f"ln K is wrong by {self.flux:.3g} (at most {FLUX:g})",
            f"a steep fall that moves as a shock adds {100.0 * self.fall:.2g} % of the range of u - x "
            f"(at most {100.0 * FALL:g} %)",
        ]
        within = self.slope <= SLOPE, self.flux <= FLUX, self.fall <= FALL
        named = " and ".join(fault for fault, holds in zip(faults, within, strict=True) if not holds)
        return (f"{data} do not resolve the profile at t = 0: {named}. Use {remedy}.",)


EXACT = Resolution(0.0, 0.0, 0.0)


def fine_sample(
    problem: Problem, left: float, right: float = 0.0, also: Array | None = None, part: float = np.inf
) -> Sample:
    """Return a Sample of the profile on [left, right], on all its scales and with the positions `also`.

    If ln(1 + q) changes from one interval to the next by more than `part` of its range, both are divided further. A
    larger change that remains is a jump that the profile does not state.
    """
    profile, law = problem.profile, problem.law
    breaks, stated = profile.breaks(law)[:, 0], profile.marks()
    even = np.linspace(left, right, (FINE if stated is None else COARSE) + 1)
    marks = apart([even, breaks] if stated is None else [even, breaks, stated], left, right)
    if stated is not None:
        marks = divided(marks, np.full(marks.size - 1, PARTS))
    x = marks if also is None else apart([marks, also], left, right)
    while True:
        W = profile.W(x, law)
        q = np.diff(W) / np.diff(x)
        if part == np.inf:
            return Sample(x, W, q, _ln_K(problem, x, q))
        v = log_slope(q)
        change = np.abs(np.diff(v))
        change[np.isin(x[1:-1], breaks)] = 0.0
        allowed, part = part * float(np.ptp(np.append(v, 0.0))), np.inf
        if allowed > 0.0:
            parts = np.ceil(np.maximum(np.append(change, 0.0), np.append(0.0, change)) / allowed)
            x = apart([divided(x, np.clip(parts, 1, MOST_PARTS).astype(int))], left, right)


def log_slope(q: Array) -> Array:
    """Return ln(1 + q), and 0 where that is not finite: `Problem.check` rejects such a profile."""
    with np.errstate(all="ignore"):
        v = np.log1p(q)
    return np.where(np.isfinite(v), v, 0.0)


def compare_data(problem: Problem, sample: Sample, W: Array, ln_K: Array, area: float = 0.0) -> Resolution:
    """Return the errors of discretised data with W and ln K at the positions of the sample.

    `area` is the largest product of a fall of I, which one front carries, with the width to which it opens as a fan.
    Such a front is wrong by an eighth of the corresponding fall of q times the width in W.
    """
    off = W - sample.W
    off -= off[0]
    norm = float(np.abs(sample.q) @ np.diff(sample.x))
    flux = float(np.abs(np.maximum(ln_K, NO_GRAINS) - np.maximum(sample.ln_K, NO_GRAINS)).max())
    slope = float(np.abs(np.diff(off)).sum()) / norm if norm else 0.0
    extent = float(np.ptp(sample.W)) * float(problem.law.R_derivative(0.0))
    fall = area / (8.0 * extent) if extent else 0.0
    return Resolution(float(np.abs(off).max()), slope, flux, fall)


def cells_resolve(problem: Problem, grid: Grid) -> Resolution:
    """Return the errors of cell means on a grid, whose W is exact at the nodes."""
    profile, law = problem.profile, problem.law
    if isinstance(profile, Kinks) and grid.dx <= SLOPE * float(np.min(law.R_derivative(profile.amplitudes))):
        return EXACT  # q decays over R'(q): a sample, costly under most laws, is unnecessary
    # cells without a position of the sample add no error
    right = np.searchsorted(grid.nodes, fine_sample(problem, grid.left, grid.right).x)
    nodes = grid.nodes[np.unique(np.concatenate([[0], np.maximum(right - 1, 0), right, [grid.cells]]))]
    sample = fine_sample(problem, grid.left, grid.right, nodes)
    W = np.interp(sample.x, nodes, np.interp(nodes, sample.x, sample.W))  # the sample holds these nodes
    return compare_data(problem, sample, W, _ln_K(problem, sample.x, np.diff(W) / np.diff(sample.x)))


def _ln_K(problem: Problem, x: Array, q: Array) -> Array:
    """Return ∫_x^0 f(q) dξ at the positions x, of q between them."""
    with np.errstate(all="ignore"):  # a law that overflows makes the errors NaN, and the data do not hold
        return np.append(np.cumsum((problem.law.f(q) * np.diff(x))[::-1])[::-1], 0.0)


def apart(places: list[Array], left: float, right: float) -> Array:
    """Return all positions on [left, right], increasing, without those that are too near the one before."""
    x = np.unique(np.clip(np.concatenate(places), left, right))
    return x[np.append(True, np.diff(x) > NEAREST * (1.0 + abs(left)))]


def divided(marks: Array, parts: Array) -> Array:
    """Return the marks, with the interval right of each divided into equal parts, shape (n - 1,)."""
    first = np.repeat(np.cumsum(parts) - parts, parts)
    length = np.diff(marks) / parts
    within = (np.arange(first.size) - first) * np.repeat(length, parts)
    return np.append(np.repeat(marks[:-1], parts) + within, marks[-1])
