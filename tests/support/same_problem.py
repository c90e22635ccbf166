"""Comparison of two problems to the last bit."""

import numpy as np


def same(one, other, grid):
    """Whether two problems are one, to the last bit."""
    assert one.title == other.title
    assert one.end == other.end
    assert np.array_equal(one.times, other.times)
    assert one.law.table == other.law.table
    q = np.linspace(-0.9, 5.0, 40)
    assert np.array_equal(one.law.f(q), other.law.f(q))
    assert np.array_equal(one.profile.W(grid.nodes, one.law), other.profile.W(grid.nodes, other.law))
    assert one.profile.units == other.profile.units
    assert one.profile.account == other.profile.account
    assert one.profile.inflow == other.profile.inflow
    assert (one.coefficient is None) == (other.coefficient is None)
    if one.coefficient is not None:
        t = np.linspace(0.0, one.end, 5)[:, None]
        assert np.array_equal(one.coefficient.values(t, grid.nodes), other.coefficient.values(t, grid.nodes))
