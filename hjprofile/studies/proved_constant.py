"""The Lipschitz constant of the solution in its initial data that the proof gives, from the data alone (§9)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.solvers.norms import inverse_of_R
from hjprofile.solvers.run import Array

SLOPES = 1025  # slopes between the bounds of q at which the ratio f'/R' is sampled


class Proof(NamedTuple):
    """Bounds on two solutions q and p for all times, from their initial data.

    Attributes:
        coefficient: M f'(κ), with sup|k - l| <= M f'(κ) ‖q - p‖₁ for k = K(q), l = K(p).
        norm, size, variation: bounds of ‖f(p)‖₁, sup|f(p)| and TV(f(p)).
    """

    coefficient: float
    norm: float
    size: float
    variation: float

    @property
    def constant(self) -> float:
        """L with ‖q - p‖₁(t) <= e^{Lt} ‖q - p‖₁(0)."""
        return self.coefficient * (self.variation + (1.0 + self.norm) * self.size)


@np.errstate(over="ignore")  # an infinite constant is a bound
def proof(law: ErosionLaw, q: Array, p: Array, dx: float) -> Proof:
    """Return the bounds of §9 for two slopes, with the smaller constant of the two roles.

    - `law`: an erosion law of sublinear growth.
    - `q`, `p`: cell means at t = 0, above -1, on the same cells.
    - `dx`: the cell width.
    """
    least = min(float(q.min()), float(p.min()), 0.0)
    steepest, neutral = law.derivative(np.array([least, 0.0])).tolist()  # f' decreases
    mass = max(float(np.maximum(one, 0.0).sum()) for one in (q, p)) * dx
    largest_K = float(np.exp(neutral * mass))
    found = []
    for one in (q, p):
        R, W = law.R(one), dx * (np.cumsum(one) - 0.5 * one)
        plus, minus = (dx * float(np.maximum(sign * one, 0.0).sum()) for sign in (1.0, -1.0))
        I = np.concatenate([[law.R(0.0)], R + W])
        most = inverse_of_R(law, float(I.max()) + minus)
        between = np.expm1(np.linspace(np.log1p(least), np.log1p(most), SLOPES))
        ratio = float((law.derivative(between) / law.R_derivative(between)).max())
        size = max(float(law.f(np.array(most))), -float(law.f(np.array(least))))
        variation = ratio * (float(np.abs(np.diff(I)).sum()) + plus + minus)
        found.append(Proof(largest_K * steepest, neutral * plus + steepest * minus, size, variation))
    return min(found, key=lambda bounds: bounds.constant)
