"""Dormand and Prince's method of order 8 with two estimates of its error.

After Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I (1993), chapter II: a step has twelve rates,
each at a state made of those before it, and one more at its end, for the estimates.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled

STAGES = 12


class Tableau(NamedTuple):
    """The coefficients: A of the stages and B of the step by their rates, E3 and E5 of the estimates by all rates."""

    A: np.ndarray
    B: np.ndarray
    E3: np.ndarray
    E5: np.ndarray


@cache
def tableau() -> Tableau:
    """The coefficients, from scipy: half a second of imports, which runs on a grid do without."""
    from scipy.integrate import DOP853

    return Tableau(DOP853.A, DOP853.B, DOP853.E3, DOP853.E5)


@compiled
def state_at(stage, y, h, rates, tableau, out):
    """Fills the state at which the rate of a stage is taken, from the rates before it; after STAGES, the step's end."""
    for l in range(y.size):
        out[l] = 0.0
    for j in range(stage):
        a = tableau.A[stage, j] if stage < STAGES else tableau.B[j]
        if a != 0.0:
            for l in range(y.size):
                out[l] += a * rates[j, l]
    for l in range(y.size):
        out[l] = y[l] + h * out[l]


@compiled
def step_error(h, rates, tableau, new, absolute):
    """The largest error of a step that ends at `new`; NaN where a rate is not finite.

    Of the first `absolute` entries as it is, of the others as a part of 1 + their size.
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
def larger(a, b):
    """The larger of the two; NaN if either is."""
    return b if a <= b or b != b else a
