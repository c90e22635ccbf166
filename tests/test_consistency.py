"""The consistency test passes on sound solvers and turns red for any single fault in either form."""

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.evidence.consistency import check_consistency
from hjprofile.solvers import conservation
from hjprofile.solvers import hj as hj_form
from hjprofile.solvers.kernels import grid as kernels

KINK = (hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, snapshots=6), hj.Grid(-5.0, 2000))


def failures(problem=KINK[0], grid=KINK[1]):
    return {c.name for c in check_consistency(problem, grid) if not c.passes}


def test_sound_solvers_pass():
    checks = check_consistency(*KINK)
    assert all(c.passes for c in checks)
    names = {c.name.split(":")[0] for c in checks}
    assert names == {"bounds", "identity", "independence", "kinks", "budget", "characteristics"}
    for c in checks:
        if c.name.startswith("independence"):
            assert len(c.cells) >= 4 and c.order is not None


def scaled(function, factor, argument):
    """`function` with one of its positional arguments multiplied."""

    def faulty(*arguments):
        arguments = list(arguments)
        arguments[argument] = arguments[argument] * factor
        return function(*arguments)

    return faulty


def shifted_flux(s, speed):
    """K one node too far right."""
    s.F[1:] = np.append(s.K[2:], 1.0) * s.f


sound_viscosity, sound_exponent, sound_edges = (
    kernels.hj_local_lax_friedrichs,
    kernels.hj_exponent,
    kernels.edge_exponent,
)


def doubled_viscosity(q, f_mean, df, K, F):
    sound_viscosity(q, f_mean, 2 * df, K, F)


class ShiftedSecondOrder(conservation.SecondOrder):
    def _reconstruct(self):
        super()._reconstruct()
        self.F[1:-1] = self.F[1:-1] * self.K[2:] / self.K[1:-1]


class FrozenK(conservation.SecondOrder):
    """K of the first stage used in both; and it is that of the step before."""

    def _reconstruct(self):
        old = self.K.copy()
        super()._reconstruct()
        self.F[1:] *= old[1:] / self.K[1:]


class NoUpwind(conservation.SecondOrder):
    """Flux from the wrong side."""

    def _reconstruct(self):
        super()._reconstruct()
        self.F[1:-1] = self.K[1:-1] * self.law.f(self.left[1:])


def hj_exponent(factor=1.0, shift=0):
    def faulty(f, dx, exponent):
        sound_exponent(f, factor * dx, exponent)
        if shift:
            exponent[:-1] = exponent[1:]

    return faulty


def edge_exponent(factor=1.0, shift=0):
    def faulty(left, right, dx, exponent):
        sound_edges(left, right, factor * dx, exponent)
        if shift:
            exponent[:-1] = exponent[1:]

    return faulty


def first_order_evaluate(change):
    original = conservation.FirstOrder.evaluate

    def faulty(self):
        speed = original(self)
        change(self)
        return speed

    return faulty


def negate(self):
    self.F = -self.F


def shift_K(self):
    self.F[1:] *= np.append(self.K[2:], 1.0) / self.K[1:]


FAULTS = {
    "HJ: K without dx": (kernels, "hj_exponent", hj_exponent(factor=200.0)),
    "HJ: K with the wrong sign": (kernels, "hj_exponent", hj_exponent(factor=-1.0)),
    "HJ: K shifted by a cell": (kernels, "hj_exponent", hj_exponent(shift=1)),
    "HJ: u_t with the wrong sign": (kernels, "hj_update", scaled(kernels.hj_update, -1.0, 2)),
    "HJ: half the time step": (kernels, "hj_update", scaled(kernels.hj_update, 0.5, 2)),
    "HJ: slope with the wrong dx": (kernels, "hj_slopes", scaled(kernels.hj_slopes, 1.01, 1)),
    "HJ: local viscosity doubled": (kernels, "hj_local_lax_friedrichs", doubled_viscosity),
    "HJ: Godunov with K of the next node": (hj_form, "FLUXES", dict(hj_form.FLUXES, godunov=shifted_flux)),
    "CL first order: wrong sign": (conservation.FirstOrder, "evaluate", first_order_evaluate(negate)),
    "CL first order: K shifted": (conservation.FirstOrder, "evaluate", first_order_evaluate(shift_K)),
    "CL second order: K without dx": (kernels, "edge_exponent", edge_exponent(factor=200.0)),
    "CL second order: K with the wrong sign": (kernels, "edge_exponent", edge_exponent(factor=-1.0)),
    "CL second order: K from half of f": (kernels, "edge_exponent", edge_exponent(factor=0.5)),
    "CL second order: K shifted by a cell": (kernels, "edge_exponent", edge_exponent(shift=1)),
    "CL second order: flux with K of the next node": (conservation, "SecondOrder", ShiftedSecondOrder),
    "CL second order: K of the stage before": (conservation, "SecondOrder", FrozenK),
    "CL second order: downwind": (conservation, "SecondOrder", NoUpwind),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_single_fault_turns_it_red(fault, monkeypatch):
    where, name, faulty = FAULTS[fault]
    monkeypatch.setattr(where, name, faulty)
    with np.errstate(all="ignore"):
        assert failures()


def test_compare_wants_nested_grids_and_common_times():
    problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, snapshots=3)
    a, b = hj.solve_hj(problem, hj.Grid(-5.0, 100)), hj.solve_hj(problem, hj.Grid(-5.0, 150))
    with pytest.raises(hj.InputError, match="100 and 150 cells do not nest"):
        hj.compare(a, b)
    other = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, snapshots=[0.3])
    with pytest.raises(hj.InputError, match="no saved time"):
        hj.compare(a, hj.solve_hj(other, hj.Grid(-5.0, 100)))


def test_compare_measures_what_it_says():
    """A run against itself shifted by a known amount."""
    from dataclasses import replace

    problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, snapshots=3)
    a = hj.solve_hj(problem, hj.Grid(-5.0, 200))
    same = hj.compare(a, a)
    assert same.slope_max <= 1e-12 and same.height_sup == 0.0 and same.kinks == 0.0
    moved = replace(a, u=a.u + 0.25, q=a.q - 0.5, kinks=[k._replace(x=k.x + 0.01) for k in a.kinks])
    apart = hj.compare(a, moved)
    assert apart.height_sup == pytest.approx(0.25) and apart.height_l1 == pytest.approx(0.25 * 5.0 * 201 / 200)
    assert apart.slope_l1 == pytest.approx(2.5) and apart.slope_max == pytest.approx(0.5)
    assert apart.kinks == pytest.approx(0.01)


def test_compare_across_nested_grids_converges():
    problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, snapshots=3)
    fine = hj.solve_conservative(problem, hj.Grid(-5.0, 1600))
    apart = [hj.compare(hj.solve_hj(problem, hj.Grid(-5.0, n), "godunov"), fine).height_l1 for n in (100, 200, 400)]
    assert 0.85 <= hj.observed_order([100, 200, 400], apart) <= 1.2


def test_observed_order():
    assert hj.observed_order([10, 20, 40], [1.0, 0.25, 0.0625]) == pytest.approx(2.0)
    assert np.isnan(hj.observed_order([10, 20], [1.0, 0.0]))
