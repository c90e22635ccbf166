"""Dormand-Prince method of order 8 with two error estimates.

The method follows Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I (1993), chapter II. A step has
twelve stages, each at a state combined from the rates before it, and one more rate at its end for the estimates.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled, dop853, inner

STAGES = 12
BLOCK = 1024  # entries of a state that fit into the first-level cache while rates are summed


class Tableau(NamedTuple):
    """The coefficients of the method.

    Attributes:
        A, B: of the stages and of the step.
        E3, E5: of the error estimates.
        A_more, D: of three more stages, and of the interpolant of order 7 that uses them.
    """

    A: np.ndarray
    B: np.ndarray
    E3: np.ndarray
    E5: np.ndarray
    A_more: np.ndarray
    D: np.ndarray


@cache
def tableau() -> Tableau:
    """Return the coefficients as arrays."""
    stages, more = STAGES, STAGES + 4

    def table(rows, columns):
        filled = np.zeros((len(rows), columns))
        for row, values in zip(filled, rows, strict=True):
            row[: len(values)] = values
        return filled

    A, A_more, D = table(dop853.A, stages), table(dop853.A_MORE, more), table(dop853.D, more)
    return Tableau(A, np.array(dop853.B), np.array(dop853.E3), np.array(dop853.E5), A_more, D)


@inner
def state_at(stage, y, h, rates, tableau, out):
    """Fill the state at which the rate of a stage is evaluated, from the rates before it.

    The stage STAGES is the end of the step; later stages serve the interpolant.
    """
    for start in range(0, y.size, BLOCK):
        end = min(start + BLOCK, y.size)
        for l in range(start, end):
            out[l] = 0.0
        for j in range(stage):
            if stage < STAGES:
                a = tableau.A[stage, j]
            else:
                a = tableau.B[j] if stage == STAGES else tableau.A_more[stage - STAGES - 1, j]
            if a != 0.0:
                for l in range(start, end):
                    out[l] += a * rates[j, l]
        for l in range(start, end):
            out[l] = y[l] + h * out[l]


@inner
def step_error(h, rates, tableau, new, absolute):
    """Return the largest error of a step that ends at `new`; NaN if a rate is not finite.

    The error is absolute for the first `absolute` entries, and relative to 1 + |entry| for the others.
    """
    fifth = third = 0.0
    for l in range(new.size):
        e5 = e3 = 0.0
        for i in range(STAGES + 1):
            e5 += tableau.E5[i] * rates[i, l]
            e3 += tableau.E3[i] * rates[i, l]
        scale = 1.0 if l < absolute else 1.0 + abs(new[l])
        fifth, third = larger(abs(e5) / scale, fifth), larger(abs(e3) / scale, third)
    return h * fifth * fifth / math.sqrt(fifth * fifth + 0.01 * third * third + 1e-300)


@compiled
def interpolant(y, h, rates, tableau, new, F):
    """Fill the coefficients F (7, size) of `state_within` from all 16 rates of a step from y to new."""
    for l in range(y.size):
        F[0, l] = new[l] - y[l]
        F[1, l] = h * rates[0, l] - F[0, l]
        F[2, l] = 2.0 * F[0, l] - h * (rates[0, l] + rates[STAGES, l])
        for i in range(4):
            total = 0.0
            for j in range(STAGES + 4):
                total += tableau.D[i, j] * rates[j, l]
            F[3 + i, l] = h * total


@compiled
def state_within(y, F, part, out):
    """Fill the state at a fraction of the step, in [0, 1]."""
    for l in range(y.size):
        total = 0.0
        for i in range(7):
            total = (total + F[6 - i, l]) * (part if i % 2 == 0 else 1.0 - part)
        out[l] = y[l] + total


@inner
def larger(a, b):
    """Return the larger of two numbers; NaN if either is NaN."""
    return b if a <= b or b != b else a
