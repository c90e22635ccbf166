"""Monitor of the vertical steps of u on a grid, under a law of linear growth (§16).

A scheme spreads a vertical step over a layer of cells. Outside the layer W + R(q) changes little, so W is continued
into the layer from either side along a piece of constant I. The position of the step preserves the area under u in the
layer, and its height is the difference of the two continuations there.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hjprofile.problem.erosion import Function
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.kernels.grid_loops import exponent
from hjprofile.solvers.kernels.journal import BLOW_UP, EVENTS, EXIT, MERGE
from hjprofile.solvers.run import Array, Event, State, VerticalStep
from hjprofile.solvers.vertical_steps.kernels import steps as kernels
from hjprofile.solvers.vertical_steps.kernels.steps import StepLaw
from hjprofile.solvers.vertical_steps.kernels.telescoping import WIDEST_LAYER

STEEP_DISTANCE = 4.0  # distance from a vertical slope, in cells; slopes as steep as there may be vertical steps
LEAST_HEIGHT = 1.5  # smallest height, relative to the decrease of R within a cell of a vertical slope
LEAST_LIFE = 3  # smallest number of sightings of a vertical step


class Layer(NamedTuple):
    """A vertical step found in one state, and the ends of its numerical layer."""

    x: float
    height: float
    speed: float
    left: float
    right: float


def find_steps(q: Array, x_left: float, dx: float, f: Array, law: StepLaw) -> list[Layer]:
    """Return the vertical steps from left to right, for cell means q and f(q) from x_left on."""
    steep = np.expm1(kernels.v_of(-np.expm1(-law.rate * STEEP_DISTANCE * dx), law))
    if not np.max(q) > steep:
        return []
    least = least_height(dx, law)
    W = np.append(0.0, np.cumsum(q) * dx)
    ln_K = np.zeros(q.size + 1)
    exponent(f, dx, ln_K)
    inner = q[1:-1]
    peaks = 1 + np.flatnonzero((inner > steep) & (inner >= q[:-2]) & (inner > q[2:]))
    found: list[Layer] = []
    ends = np.append(peaks, q.size - 1).tolist()
    for p, beyond in pairwise(ends):
        a, b = _layer(q, p, beyond, dx)
        x_a, x_b = x_left + a * dx, x_left + b * dx
        v = np.empty(2)
        kernels.start_pieces(q[[a, b]] * dx, np.full(2, dx), law, v)
        layer = _fit(W[a : b + 1], x_a, x_b, v, law)
        if layer and layer[1] >= least and not (found and x_a < found[-1].x):
            x, m, r = layer
            K = float(np.exp(ln_K[b])) * r / kernels.r_of(v[1], law)
            found.append(Layer(x, m, K * kernels.step_speed(m, law), x_a, x_b))
    return found


def _layer(q: Array, p: int, beyond: int, dx: float) -> tuple[int, int]:
    """Return the cells adjacent to the layer around cell p.

    To the left q decreases until it is nearly constant or rises. The right cell is twice as far, outside the
    oscillations of a second-order scheme. If the next peak, at the cell `beyond`, is nearer than that, it is the cell
    with the smallest q in between.
    """
    first = max(p - WIDEST_LAYER, 0)
    rises = np.diff(q[first : p + 1])
    flat = rises <= dx * np.max(rises, initial=0.0)
    ends = np.flatnonzero(flat & (q[first:p] < 0.5 * q[p]))  # the peak itself may be flat
    a = first + (int(ends[-1]) if ends.size else 0)
    b = 3 * p - 2 * a + 2
    return a, b if b < beyond else p + int(np.argmin(q[p : beyond + 1]))


def _fit(W: Array, x_a: float, x_b: float, v: Array, law: StepLaw) -> tuple[float, float, float] | None:
    """Return position, height and R on the right of a vertical step between x_a and x_b, or None if there is none.

    ln(1 + q) at x_a and x_b is v.
    """
    from scipy.optimize import brentq

    dx = (x_b - x_a) / (W.size - 1)
    area_of_layer = dx * (np.sum(W) - 0.5 * (W[0] + W[-1]))
    y = [kernels.y_of(one, law) for one in v]
    I = W[0] + kernels.r_of(v[0], law), W[-1] + kernels.r_of(v[1], law)

    def over(x: float) -> float:
        """Return the area of the continued pieces less the area of the layer."""
        left, right = (kernels.v_of(kernels.moved(y[k], x - at, law), law) for k, at in enumerate((x_a, x_b)))
        area = [kernels.at(law.area, law, one) for one in (v[0], left, right, v[1])]
        free = law.end - 1e-12
        vertical = 0.0
        if right >= free:  # the piece ends at its vertical slope, and W is continued as a constant
            level = x_b + np.log1p(-y[1]) / law.rate - x
            vertical = level * (law.r_most - law.r0)
        return float(
            (I[0] - law.r0) * (x - x_a) - (area[0] - area[1])
            + (I[1] - law.r0) * (x_b - x) - (area[2] - area[3]) - vertical - area_of_layer
        )  # fmt: skip

    if not over(x_a) > 0.0 > over(x_b):
        return None
    x = float(brentq(over, x_a, x_b, xtol=1e-13))
    left, right = (
        kernels.r_of(kernels.v_of(kernels.moved(y[k], x - at, law), law), law) for k, at in enumerate((x_a, x_b))
    )
    return x, float((I[1] - right) - (I[0] - left)), float(right)


def least_height(dx: float, law: StepLaw) -> float:
    """Return the smallest height at which a vertical step is found on cells of width dx."""
    y_cell = -np.expm1(-law.rate * dx)
    return LEAST_HEIGHT * float(law.r_most - kernels.r_of(kernels.v_of(y_cell, law), law))


def with_dates(
    events: Sequence[Event], grid: Grid, law: StepLaw, kinks_only: bool
) -> tuple[list[Event], tuple[str, ...]]:
    """Return the events that a grid can date, and a caution about the others.

    Before a slope becomes infinite it is steeper than any grid resolves. A scheme spreads it like a vertical step, and
    behind its layer q decreases and rises again: births depend on the cells, and blow-ups are found early or late. If
    the data are kinks only, no kink is born, and blow-ups are dated late, at the smallest height that is found.
    """
    if kinks_only:
        return [e for e in events if e.event != "birth"], ()
    doubtful = {"birth": "births of kinks", "blow-up": "blow-ups"}
    dropped = [name for kind, name in doubtful.items() if any(e.event == kind for e in events)]
    if not dropped:
        return list(events), ()
    caution = (
        f"{' and '.join(dropped)} are not reported, because {grid.cells} cells do not determine their times: "
        f"a vertical step is found from a height of {least_height(grid.dx, law):.2g} on; use the method fronts for "
        "their times"
    )
    return [e for e in events if e.event not in doubtful], (caution,)


class StepMonitor:
    """A monitor that finds the vertical steps of every state and links them: each has a permanent number.

    The blow-up of a step is dated when its height reaches the smallest one that a grid distinguishes from a steep
    slope. A step with fewer than LEAST_LIFE sightings is caused by that threshold, and is dropped.
    """

    checkpoint_fields: tuple[str, ...] = ("t", "count", "gone", "living", "rows", "log", "seen")

    def __init__(self, law: StepLaw, grid: Grid, saved_times: Array, f: Function):
        self.law, self.grid, self.saved_times, self.f = law, grid, saved_times, f
        self.t, self.count = 0.0, 0
        self.gone = (0.0, 0.0)  # width of the last layer that left at the crest; time until which it is found
        self.living = np.empty((0, 5))  # number, x, height, speed, width
        self.rows = np.empty((0, 5))
        self.log = np.empty((0, 5))  # time, kind, step, into, x
        self.seen = np.zeros(1)  # number of sightings of each
        self.latest: tuple[float, list[Layer]] = (-np.inf, [])

    def wants(self, state: State) -> bool:
        return True

    def layers(self, state: State) -> list[Layer]:
        """Return the vertical steps of a state."""
        if self.latest[0] != state.t:
            x_left = float(self.grid.nodes[state.first])
            self.latest = state.t, find_steps(state.q, x_left, self.grid.dx, self.f(state.q), self.law)
        return self.latest[1]

    def hidden(self, state: State) -> list[tuple[float, float]]:
        """Return the layers of vertical steps, in which no kinks are searched for."""
        width, until = self.gone
        leaving = [(-width, 0.0)] if state.t <= until else []
        return [(layer.left, layer.right) for layer in self.layers(state)] + leaving

    def observe(self, state: State) -> None:
        """Link each known step to the one that is nearest to its expected position."""
        dt, found = state.t - self.t, self.layers(state)
        ahead = self.living[:, 1] + self.living[:, 3] * dt
        reach = 8.0 * self.grid.dx + 0.5 * self.living[:, 3] * dt
        numbers = [0] * len(found)
        lost = list(range(len(self.living)))
        pairs = [(abs(layer.x - ahead[k]), k, i) for k in lost for i, layer in enumerate(found)]
        for distance, k, i in sorted(pairs):
            if distance <= reach[k] and k in lost and not numbers[i]:
                numbers[i] = int(self.living[k, 0])
                lost.remove(k)
        for k in lost:
            number, x, _, speed, width = self.living[k].tolist()
            near = [i for i, layer in enumerate(found) if abs(layer.x - ahead[k]) <= width + reach[k] and numbers[i]]
            if near:  # the lower number survives
                i = min(near, key=lambda i: abs(found[i].x - ahead[k]))
                low, high = sorted((int(number), numbers[i]))
                self._note(state.t, MERGE, high, low, found[i].x)
                numbers[i] = low
            elif ahead[k] > -reach[k] - width:
                self._note(min(self.t - x / speed, state.t), EXIT, number, np.nan, 0.0)
                self.gone = 2.0 * width, state.t + 2.0 * width / speed
        for i, layer in enumerate(found):
            if not numbers[i]:
                self.count += 1
                self.seen = np.append(self.seen, 0.0)
                numbers[i] = self.count
                self._note(state.t, BLOW_UP, self.count, np.nan, layer.x)
            self.seen[numbers[i]] += 1
        rows = [(n, s.x, s.height, s.speed, s.right - s.left) for n, s in zip(numbers, found, strict=True)]
        self.living, self.t = np.array(rows).reshape(-1, 5), state.t
        if state.t in self.saved_times:
            self.rows = np.vstack([self.rows, np.insert(self.living[:, :4], 0, state.t, axis=1)])

    def _note(self, t: float, kind: int, number: float, into: float, x: float) -> None:
        self.log = np.vstack([self.log, [t, kind, number, into, x]])

    def result(self, taken: int) -> tuple[list[VerticalStep], list[Event]]:
        """Return the vertical steps at the saved times, and their events, numbered after the first `taken` numbers."""
        lasting = np.flatnonzero(self.seen >= LEAST_LIFE).tolist()
        new: dict[float, int] = {n: number for number, n in enumerate(lasting, start=taken + 1)}
        steps = [VerticalStep(t, new[n], x, m, s) for t, n, x, m, s in self.rows.tolist() if n in new]
        events = [
            Event(t, EVENTS[int(kind)], new[n], new.get(into), x)
            for t, kind, n, into, x in self.log.tolist()
            if n in new and (np.isnan(into) or into in new)
        ]
        return steps, events
