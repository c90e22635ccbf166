"""The three verdicts of the consistency test, and surveys whose pieces are narrower than the cells."""

import json
from dataclasses import replace

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.output.store import to_json
from hjprofile.studies import consistency
from hjprofile.studies.consistency import _completed, _identity, _within, check_consistency
from hjprofile.studies.records import records
from hjprofile.studies.verdict import Check, Consistency, verdict_of_all

PASSES = Check("identity:godunov", [2000], [1e-13], None, 1e-10, True, "to rounding")
OPEN = Check("budget:godunov", [1000, 2000], [2.0, 1.0], 1.0, 0.5, True, "at most 0.5", resolved=False)
ASIDE = OPEN._replace(name="budget:lax-friedrichs", decides=False)
FAILS = PASSES._replace(error=[1.0], passes=False)


@pytest.mark.parametrize(
    ("comparisons", "verdict", "headline", "true"),
    [
        ((PASSES,), "passes", "slope: passes", True),
        ((PASSES, ASIDE), "passes", "slope: passes", True),
        ((PASSES, ASIDE, OPEN), "not resolved", "slope: not resolved on these grids: budget:godunov", True),
        ((OPEN, FAILS), "fails", "slope: FAILS", False),
    ],
)
def test_three_verdicts(comparisons, verdict, headline, true):
    found = Consistency("slope", "Slope", comparisons)
    assert (found.verdict, bool(found), found.passes) == (verdict, true, true)
    lines = str(found).splitlines()
    assert lines[0] == headline
    marks = {line.split()[1]: line.split()[0] for line in lines[1:] if "WARNING" not in line}
    assert marks == {
        c.name: "FAILS" if not c.passes else "passes" if c.resolved else "open" for c in comparisons
    }  # fmt: skip
    report = found.report()
    assert (report["verdict"], report["passes"]) == (verdict, true)
    assert bool(report["warnings"]) == (OPEN in comparisons)


def test_the_verdict_on_several_cases_is_the_least_favourable():
    one, two, three = (Consistency("", "", c) for c in ((PASSES,), (OPEN,), (FAILS,)))
    assert [verdict_of_all(v) for v in ((one,), (one, two), (two, three))] == ["passes", "not resolved", "fails"]


def test_an_open_case_does_not_fail_the_command(in_tmp, call, monkeypatch):
    monkeypatch.setattr(consistency, "check_consistency", lambda *_: [PASSES, OPEN])
    code, out, err = call("check", "hillslope", "--out", "verdict")
    assert (code, err) == (0, "")
    assert out.startswith("hillslope: not resolved on these grids: budget:godunov\n  passes  identity:godunov")
    assert "\n  open    budget:godunov" in out
    for words in ("use more cells (this test uses up to 4000)", "`resample`", "method auto with a tolerance"):
        assert words in out
    content = json.loads((in_tmp / "verdict" / "check.json").read_text())
    assert (content["passes"], content["verdict"], content["cases"][0]["verdict"]) == (
        True, "not resolved", "not resolved",
    )  # fmt: skip


def test_advice_names_only_what_the_case_can_use(monkeypatch):
    monkeypatch.setattr(consistency, "check_consistency", lambda *_: [OPEN])
    case = hj.load_case("two_kinks")
    (sentence,) = hj.check(replace(case, grid=replace(case.grid, cells=4000))).warnings
    assert "more cells" not in sentence and "resample" not in sentence and "method auto" in sentence


def rough(noise, length, points=41, method="isotonic"):
    """A slope with a point each 1.5 m and noise of that height, repaired: flats between rises."""
    rng = np.random.default_rng(3)
    x = 1.5 * np.arange(points)
    height = 0.36 * x + 1.5 * np.sin(0.09 * x) + noise * rng.standard_normal(points)
    survey = hj.survey(x=x, height=height, critical_slope=0.36, length=length, repair=method)
    return hj.Problem(hj.rational(), survey, end=0.5, snapshots=3), survey.grid(1000)


def section():
    """A stretch of a real elevation model, 30 m apart, which falls in places."""
    from matplotlib.cbook import get_sample_data

    height = get_sample_data("jacksboro_fault_dem.npz")["elevation"].astype(float)[100, 40:100]
    low, high = sorted((int(height.argmin()), int(height.argmax())))
    height = height[low : high + 1]
    x = 30.0 * np.arange(height.size)
    units = {"critical_slope": float(np.ptp(height) / np.ptp(x)), "length": float(np.ptp(x)) / 25.0}
    survey = hj.survey(x=x, height=height, repair="isotonic", **units)
    return hj.Problem(hj.rational(), survey, end=0.5, snapshots=3), survey.grid(1000)


ROUGH = {
    "noise of 10 cm": (lambda: rough(0.1, 12.0), "local-lax-friedrichs", "passes"),
    "by weno5": (lambda: rough(0.5, 1.0, 21), "weno5", "passes"),
    "by fronts": (lambda: rough(0.1, 12.0), "fronts", "passes"),
    "by fronts that do not represent it": (lambda: rough(0.5, 1.0, 21), "fronts", "not resolved"),
    "a section of an elevation model": (section, "godunov", "passes"),
    "by lax-friedrichs, whose error exceeds the change": (lambda: rough(0.5, 2.0), "lax-friedrichs", "not resolved"),
    "a coarse grid on which conservative stops": (lambda: rough(2.0, 1.0), "godunov", "passes"),
}


SLOW = "noise of 10 cm"  # seconds; the same slope is compared by fronts as well


@pytest.mark.parametrize("name", [n if n != SLOW else pytest.param(n, marks=pytest.mark.slow) for n in ROUGH])
def test_no_rough_survey_fails(name):
    make, method, expected = ROUGH[name]
    found = Consistency(name, "", check_consistency(*make(), method=method))
    assert found.passes, str(found)
    assert found.verdict == expected, str(found)
    if expected == "passes":
        assert any(method in c.name and c.name.endswith(":u") for c in found.comparisons)
    if method == "fronts" and found.open:
        assert "bounds:fronts" in found.open
    if method == "lax-friedrichs":
        assert found.open and all("lax-friedrichs:u" in name for name in found.open)
    if method == "weno5":
        assert {c.name for c in found.comparisons} >= {"order:weno5", "independence:weno5:u", "budget:weno5"}


def stopped_on(*cells):
    """Runs of one method on three grids, of which some stop."""
    problem, grid = rough(2.0, 1.0)
    run = hj.solve_hj(replace(problem, end=0.0, snapshots=2), replace(grid, cells=100), "godunov")
    return {("godunov", n): replace(run, status="stopped") if n in cells else run for n in (500, 1000, 2000)}


def test_a_stop_is_excused_only_where_the_grid_does_not_represent_the_profile():
    (excused,) = _completed(stopped_on(500), {500, 1000}, decides=False)
    assert excused.passes and not excused.resolved and not excused.decides and excused.rule == "stopped"
    (blamed,) = _completed(stopped_on(500, 2000), {500, 1000}, decides=True)
    assert not blamed.passes
    (sound,) = _completed(stopped_on(), set(), decides=True)
    assert sound.passes and sound.resolved


def test_stops_that_leave_too_few_grids_leave_the_case_open(monkeypatch):
    """Two grids give one difference, and no order."""
    sound = consistency.solve_with

    def stops(method, problem, grid, *arguments, **options):
        run = sound(method, problem, grid, *arguments, **options)
        return (
            replace(run, status="stopped") if method.name == "conservative" and grid.dx > 0.1 else run
        )  # not on the smooth bump

    monkeypatch.setattr(consistency, "solve_with", stops)
    problem, grid = rough(2.0, 0.5)
    found = Consistency("slope", "", check_consistency(problem, grid))
    assert found.verdict == "not resolved" and "bounds:conservative" in found.open
    assert json.loads(to_json(found.report()))["verdict"] == "not resolved"
    assert "order:conservative" in {c.name for c in found.comparisons}  # it needs no grid of the case


def test_a_threshold_above_the_change_of_the_slope_decides_nothing():
    apart = "independence:godunov:u", [250, 500, 1000, 2000], [0.8, 0.4, 0.2, 0.1], 0.2
    within, vacuous = (_within(*apart, sound=True, resolved=True, change=change) for change in (0.5, 0.3))
    assert within.passes and within.resolved
    assert vacuous.passes and not vacuous.resolved and "exceeds the change" in vacuous.rule
    assert not _within(*apart[:3], 0.01, sound=True, resolved=True, change=0.001).passes  # a failure remains one


def test_a_distance_that_converges_is_evidence_of_soundness():
    """Differences of a method fall slowly by chance, but its distance from an exact solution falls with order 0.6."""
    apart = "characteristics:godunov:u", [250, 500, 1000, 2000]
    near = _within(*apart, [0.027, 0.019, 0.013, 0.0079], 0.01, sound=False, resolved=True)
    assert near.passes and near.resolved
    assert not _within(*apart, [0.027, 0.026, 0.026, 0.027], 0.1, sound=False, resolved=True).passes


def test_speeds_of_kinks_beyond_the_smallest_float_are_not_compared():
    """K falls to exp(-1000) at the left end, and the speed of a kink there is 0."""
    problem = hj.Problem(hj.rational(), hj.steps([-120.0, -119.0, -60.0, 0.0], [0.5, 2.0, -0.95]), end=0.1, snapshots=2)
    run = hj.solve_hj(problem, hj.Grid(-122.0, 2000), "godunov")
    kink = run.kinks[0]._replace(x=-119.0, q_left=0.5, q_right=2.0, jump=1.5, rankine_hugoniot_speed=0.0)
    assert np.interp(kink.x, run.x, run.K[0]) < 1e-300
    found = {c.name: c for c in records(replace(run, kinks=[kink]), problem, None, "")}
    assert found["saved-kinks"].passes
    wrong = kink._replace(x=-0.5, rankine_hugoniot_speed=0.0)  # K is near 1 there, and 0 is no speed
    found = {c.name: c for c in records(replace(run, kinks=[wrong]), problem, None, "")}
    assert not found["saved-kinks"].passes


def test_rounding_that_K_passes_on_is_allowed_for():
    """Where q = -0.95, f' = 1 / (1 + q)² = 400, and an error of q in one cell changes ln K by 400 Δx of it."""
    problem = hj.Problem(hj.rational(), hj.steps([-4.0, -2.0, 0.0], [0.5, -0.95]), end=0.0, snapshots=2)
    allowed = []
    for n in (100, 400):
        grid = hj.Grid(-5.0, n)
        height, slope = hj.solve_hj(problem, grid, "godunov"), hj.solve_conservative(problem, grid)
        runs = {("godunov", n): height, ("conservative-godunov", n): slope}
        allowed.append(_identity(runs, n, "godunov", problem, coarse=False).threshold / np.sqrt(n))
        faulty = {**runs, ("godunov", n): replace(height, u=height.u + 1e-6 * np.sin(9.0 * height.x))}
        assert not _identity(faulty, n, "godunov", problem, coarse=False).passes
    rounding = [1.95 + 4.05 / dx for dx in (0.05, 0.0125)]
    factors = [1.0 + 400.0 * dx for dx in (0.05, 0.0125)]
    ratio = rounding[0] * factors[0] / (rounding[1] * factors[1])
    assert allowed[0] / allowed[1] == pytest.approx(ratio, rel=0.1)
