"""Every case that comes with the package does what its [expect] says, and passes the consistency test."""

import numpy as np
import pytest

import hjprofile as hj

KNOWN = {
    "eroded_volume",
    "volume_tolerance",
    "kinks_at_start",
    "kink_positions",
    "position_cells",
    "events",
    "step_positions",
    "step_heights",
    "step_tolerance",
}


@pytest.mark.parametrize("name", hj.shipped_cases())
def test_case_meets_its_expectation(name):
    case = hj.load_case(name)
    expect = case.expect
    assert expect and set(expect) <= KNOWN, "a case states what is expected of it, in keys that this test knows"
    run = hj.solve_case(case)
    assert run.done
    assert all(b.holds for b in run.bounds.values())
    assert abs(run.eroded_volume - expect["eroded_volume"]) <= expect["volume_tolerance"]
    assert run.error_estimate is not None and run.eroded_volume_error is not None
    # the expected number is rounded
    assert (
        abs(run.eroded_volume - expect["eroded_volume"]) <= run.eroded_volume_error + 0.05 * expect["volume_tolerance"]
    )
    assert run.eroded_volume_error <= 5.0 * expect["volume_tolerance"]
    assert len(run.kinks_at(0)) == expect["kinks_at_start"]
    found, wanted = [k.x for k in run.kinks_at(-1)], expect["kink_positions"]
    assert len(found) == len(wanted)
    for x, place in zip(found, wanted, strict=True):
        assert abs(x - place) <= expect["position_cells"] * case.grid.dx
    if "events" in expect:
        assert [e.event for e in run.events] == expect["events"]
    for wanted, got in (
        ("step_positions", [s.x for s in run.steps_at(-1)]),
        ("step_heights", [s.height for s in run.steps_at(-1)]),
    ):
        assert got == pytest.approx(expect.get(wanted, []), abs=expect.get("step_tolerance"))
    numbers = {k.kink for k in run.kinks} | {s.step for s in run.vertical_steps or ()}
    assert all(e.kink in numbers or e.event != "exit" for e in run.events)
    assert np.all(np.diff(run.time) > 0)


# in a second or two: a closed form, a prescribed coefficient, and a rolling layer, which is refused
QUICK = "travelling_kink", "steady_slope", "drying_channel", "thin_layer"


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in hj.shipped_cases()]
)
def test_case_passes_the_consistency_test(name):
    case = hj.load_case(name)
    if case.problem.supply_flux:  # there is one solver for this model, not two to compare
        with pytest.raises(hj.InputError, match="does not take a rolling layer"):
            hj.check_consistency(case.problem, case.grid, case.cfl)
        return
    checks = hj.check_consistency(case.problem, case.grid, case.cfl)
    assert [c.name for c in checks if not c.passes] == []


def test_the_hillslope_is_what_its_script_cuts(tmp_path):
    """The CSV that is shipped is the section of matplotlib's elevation model that its script describes."""
    import runpy
    import shutil

    folder = next(iter(hj.shipped_cases().values())).parent
    script = shutil.copy(folder / "cut_hillslope.py", tmp_path)
    runpy.run_path(script)
    assert (tmp_path / "hillslope.csv").read_text() == (folder / "hillslope.csv").read_text()
