"""The effect of noise in the heights of a survey on the toe outflow, by a run on the smoothed survey (§18).

f is concave, so noise in the slope lowers ∫f, hence K, and adds deposition.
"""

from __future__ import annotations

from dataclasses import replace

from hjprofile.problem.case import Case
from hjprofile.problem.survey import smoothed
from hjprofile.solvers.method import requirements
from hjprofile.solvers.methods import METHODS, by_fronts
from hjprofile.solvers.run import Run
from hjprofile.solvers.stop import Stopped

FRONTS, CELLS = 800, 200  # of the run on the smoothed survey
LARGE = 0.02  # effect on the toe outflow, as a fraction of the supply, that is reported


def with_noise_bias(run: Run, case: Case) -> Run:
    """Return a run with a caution if smoothing its survey changes the toe outflow by more than its error."""
    problem = case.problem
    found = smoothed(problem.profile) if run.done and problem.end > 0.0 else None
    if found is None or not METHODS["fronts"].supports >= requirements(problem, case.refresh):
        return run
    smooth = replace(problem, profile=found.profile, snapshots=[problem.end])
    try:
        other = by_fronts(smooth, replace(case.grid, cells=CELLS), FRONTS, None, None)
    except Stopped:
        return run
    change = other.toe_outflow - run.toe_outflow
    if not other.done or not abs(change) > max(LARGE * problem.end, 2.0 * (run.toe_outflow_error or 0.0)):
        return run
    units = problem.profile.units
    assert units is not None
    caution = (
        f"the heights scatter by about {found.scatter:.2g} {units.of_length}; with the survey smoothed (resample = "
        f"{found.spacing:g}) the toe outflow is {other.toe_outflow:.3g} instead of {run.toe_outflow:.3g}. If the "
        "scatter is noise of the measurement, smooth the survey: noise increases deposition."
    )
    return replace(run, cautions=(*run.cautions, caution))
