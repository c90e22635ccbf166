"""Reasons and sentences of runs that stop."""

import pickle

import pytest

import hjprofile as hj
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
