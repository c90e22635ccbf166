"""The consistency test passes on sound solvers and turns red for any single fault in either form."""

import inspect

import numba
import numpy as np
import pytest

import hjprofile as hj
from hjprofile.evidence.consistency import check_consistency
from hjprofile.solvers import conservation, march
from hjprofile.solvers import hj as hj_form
from hjprofile.solvers.kernels import wavefront

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


def mutated(kernel, *changes):
    """A sweep compiled anew from its source with something changed in it."""
    source = inspect.getsource(kernel.py_func).replace("@vectorised", "")
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    names = dict(vars(wavefront))
    exec(source, names)
    return numba.njit(error_model="numpy")(names[kernel.py_func.__name__])


def late_K(update):
    """K of the node before: the rational law leaves `p` to others."""
    was, growth = update
    return [
        ("[start] = 1.0, 0.0\n", "[start] = 1.0, 0.0\n            p[start] = 0.0\n"),
        (f"{was} {growth}", f"{was} {growth}p[l]); p[l] = ("),
    ]


FAULTY_KERNELS = {
    "HJ: K without dx": ("hj_pass", ("thickening(law, z)", "thickening(law, z / dx)")),
    "HJ: K with the wrong sign": ("hj_pass", ("thickening(law, z)", "thickening(law, -z)")),
    "HJ: K shifted by a cell": ("hj_pass", *late_K(("K_left = K[l] *", "thickening(law, "))),
    "HJ: u_t with the wrong sign": ("hj_pass", ("here - ratio * F", "here + ratio * F")),
    "HJ: half the time step": ("hj_pass", ("here - ratio * F", "here - 0.5 * ratio * F")),
    "HJ: slope with the wrong dx": ("hj_pass", ("d = here - left", "d = 1.01 * (here - left)")),
    "CL second order: K without dx": ("hancock_pass", ("fine_growth(z[l])", "fine_growth(z[l] / dx)")),
    "CL second order: K with the wrong sign": ("hancock_pass", ("fine_growth(z[l])", "fine_growth(-z[l])")),
    "CL second order: K from half of f": ("hancock_pass", ("fine_growth(z[l])", "fine_growth(0.5 * z[l])")),
    "CL second order: K shifted by a cell": ("hancock_pass", *late_K(("K[l] *=", "fine_growth("))),
    "CL second order: K of the step's start": ("hancock_pass", ("z_here + df_here * rise * dx", "z_here")),
    "CL second order: flux of the step's start": ("hancock_pass", ("half + rise", "half")),
    "CL second order: slope to the wrong side": ("hancock_pass", ("half + rise", "rise - half")),
}


sound_godunov = conservation.FLUXES["conservative-godunov"]


def wrong_sign(*arguments):
    F, speed = sound_godunov(*arguments)
    return -F, speed


def shifted_K(law, dx, ql, qr, K, bound):
    return sound_godunov(law, dx, ql, qr, np.append(K[1:], 1.0), bound)


def replaced(table, **entries):
    return dict(table) | {name.replace("_", "-"): entry for name, entry in entries.items()}


FAULTY_FLUXES = {
    "HJ: another flux under its name": (hj_form, {"local_lax_friedrichs": wavefront.Godunov}),
    "HJ: viscosity doubled": (hj_form, {"lax_friedrichs": lambda bound: wavefront.LaxFriedrichs(2.0 * bound)}),
    "CL first order: wrong sign": (conservation, {"conservative_godunov": wrong_sign}),
    "CL first order: K shifted": (conservation, {"conservative_godunov": shifted_K}),
}


@pytest.mark.parametrize("fault", FAULTY_KERNELS)
def test_each_single_fault_in_a_sweep_turns_it_red(fault, monkeypatch):
    kernel, *changes = FAULTY_KERNELS[fault]
    monkeypatch.setattr(wavefront, kernel, mutated(getattr(wavefront, kernel), *changes))
    monkeypatch.setattr(march, "PATIENCE", 0)  # with a wrong K some would take millions of steps
    with np.errstate(all="ignore"):
        assert failures()


@pytest.mark.parametrize("fault", FAULTY_FLUXES)
def test_each_single_fault_in_a_flux_turns_it_red(fault, monkeypatch):
    where, entries = FAULTY_FLUXES[fault]
    monkeypatch.setattr(where, "FLUXES", replaced(where.FLUXES, **entries))
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
    moved = replace(a, u=a.u + 0.25 * a.time[:, None], q=a.q - 0.5, kinks=[k._replace(x=k.x + 0.01) for k in a.kinks])
    apart = hj.compare(a, moved)
    assert apart.height_sup == pytest.approx(0.25)  # at t = 1, the largest; the mean over 0, 0.5 and 1 is half of it
    assert apart.height_l1 == pytest.approx(0.125 * 5.0 * 201 / 200)
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
    assert np.isnan(hj.observed_order([10], [1.0])) and np.isnan(hj.observed_order([10, 10], [1.0, 0.5]))
    with pytest.raises(hj.InputError, match="errors has 1 entries and cells has 2"):
        hj.observed_order([10, 20], [1.0])
    assert np.isnan(hj.observed_order([0, 20], [1.0, 0.5]))
