"""Reasons and sentences of runs that stop."""

import pickle

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.run import Breakdown, Verdict
from hjprofile.solvers.stop import Place, Reason, Stop, Stopped, Time

INNER = Stop(Reason.LABELS_LOST, "a kink would be born at x = {x:.6g}", "use the method fronts", {"x": Place(-2.0)})
OUTER = Stop(
    Reason.LABELS_LOST, "stopped at t = {t:.6g}, K = {K:g}: {why}", values={"t": Time(1.5), "K": 3.0, "why": INNER}
)


def test_a_sentence_is_its_cause_and_what_to_try():
    assert OUTER.cause == "stopped at t = 1.5, K = 3: a kink would be born at x = -2"
    assert str(OUTER) == OUTER.cause + "; use the method fronts"
    assert str(Stop(Reason.TOO_LONG, "it would take too long")) == "it would take too long"


def test_times_and_places_change_wherever_they_stand():
    there = OUTER.mapped(lambda t: 10.0 * t, lambda x: x + 4.0)
    assert str(there) == "stopped at t = 15, K = 3: a kink would be born at x = 2; use the method fronts"
    assert there.mapped(lambda t: t / 10.0, lambda x: x - 4.0) == OUTER
    assert str(Stopped(OUTER).mapped(lambda t: 10.0 * t, lambda x: x + 4.0)) == str(there)


def test_a_run_that_stops_says_why_in_both_ways():
    hollow = hj.steps([-4.0, -2.0], [-0.95])
    run = hj.solve_hj(hj.Problem(hj.rational(), hollow, end=3.0), hj.Grid(-6.0, 60), "lax-friedrichs", cfl=2.6)
    assert run.stop is not None and run.stop.reason is Reason.NOT_ADMISSIBLE
    assert run.status == str(run.stop) and isinstance(run.stop.values["t"], Time) and not run.done
    assert float(run.stop.values["t"]) == run.time[-1]


def test_an_error_carries_its_reason():
    hollow = hj.steps([-300.0, -2.0], [-0.999])
    with pytest.raises(hj.RunError, match="front tracking cannot start: ln K changes by") as caught:
        hj.track_fronts(hj.Problem(hj.rational(), hollow, end=1.0))
    assert caught.value.stop.reason is Reason.NOT_RESOLVED
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.stop) == (str(caught.value), caught.value.stop)


@pytest.mark.parametrize(("x", "where"), [(-2.5, " near x = -2.5"), (np.nan, "")])
def test_a_bound_that_is_broken_says_where_if_that_is_known(x, where):
    broken = Verdict(False, -3.0, 1.5, x, "rounding").broken("signs")
    assert broken.cause == f"signs does not hold at t = 1.5{where}: the excess is 3 times the allowance (rounding)"


@pytest.mark.parametrize(
    ("q", "K", "cell"),
    [
        ([0.0, -1.5, 0.5, np.nan, 0.2], [1.0] * 6, 3),  # of the cells with no slope above -1, the rightmost
        ([0.0, -0.9, 0.5, -0.2], [1.0, np.inf, np.nan, 1.0, 1.0], 1),  # of those where K is no number, the first
        ([0.0, -0.9, 0.5, -0.2], [1.0] * 5, 1),  # else the lowest slope
    ],
)
def test_a_breakdown_names_the_cell_to_blame(q, K, cell):
    found = Breakdown(np.array(q), np.array(K), first=10)
    assert found.cell == 10 + cell and found.q == pytest.approx(q[cell], nan_ok=True)
