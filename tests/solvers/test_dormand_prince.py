"""The method of order 8 against its formulas, by whole arrays."""

import numpy as np
import pytest
from scipy.integrate import DOP853

from hjprofile.solvers.kernels.dormand_prince import STAGES, step_error, tableau


def test_the_coefficients_are_those_of_scipy():
    there = DOP853.A, DOP853.B, DOP853.E3, DOP853.E5, DOP853.A_EXTRA, DOP853.D
    for own, other in zip(tableau(), there, strict=True):
        assert np.array_equal(own, other)


@pytest.mark.parametrize("absolute", [0, 2, 4])
def test_the_error_of_a_step(absolute):
    """Each estimate is that of the worst entry: of the first ones as it is, of others as a part of 1 + their size."""
    rng = np.random.default_rng(1)
    rates, new, h = rng.uniform(-1.0, 1.0, (STAGES + 1, 4)), rng.uniform(-9.0, 9.0, 4), 0.3
    scale = np.where(np.arange(4) < absolute, 1.0, 1.0 + np.abs(new))
    fifth, third = (np.abs(E @ rates / scale).max() for E in (DOP853.E5, DOP853.E3))
    expected = h * fifth**2 / np.sqrt(fifth**2 + 0.01 * third**2)
    assert step_error(h, rates, tableau(), new, absolute) == pytest.approx(expected, rel=1e-12)


def test_the_error_of_a_step_that_is_no_number():
    rates = np.zeros((STAGES + 1, 2))
    assert step_error(0.3, rates, tableau(), np.zeros(2), 0) == 0.0
    rates[3, 0] = np.nan
    assert np.isnan(step_error(0.3, rates, tableau(), np.zeros(2), 0))
