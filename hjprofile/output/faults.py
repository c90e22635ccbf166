"""The checks of a stored run: its texts, numbers, case, units and tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hjprofile.problem import LONGEST_TITLE
from hjprofile.problem.case import law_from
from hjprofile.problem.stored import LARGEST
from hjprofile.solvers.run import Run

EVENTS = "birth", "merge", "exit", "blow-up"
SECTIONS = "erosion", "profile", "domain", "time", "solver"
MOST = 2**31  # kinks and vertical steps
LONGEST_TEXT = 10_000  # characters of a sentence
LONGEST_UNIT = 100  # characters of the name of a unit


def fault_of(run: Run, summary: Mapping[str, Any]) -> str:
    """Return a sentence on the first fault of a stored run, or "". `summary` is the content of its summary.json.

    Raise InputError, which is a ValueError, if no case can state its law.
    """
    return _of_texts(run) or _of_numbers(run, summary) or _of_case(run) or _of_units(run) or _of_tables(run)


def _of_texts(run: Run) -> str:
    texts = [run.method, run.status, run.account, *run.cautions, *(b.allowance for b in run.bounds.values())]
    if not all(isinstance(text, str) and len(text) <= LONGEST_TEXT for text in texts):
        return f"a text is not a string, or has more than {LONGEST_TEXT} characters"
    if not (isinstance(run.title, str) and len(run.title) <= LONGEST_TITLE):
        return f"title must be a string of at most {LONGEST_TITLE} characters"
    return ""


def _of_numbers(run: Run, summary: Mapping[str, Any]) -> str:
    errors = (run.error_estimate, run.toe_outflow_error, run.eroded_volume_error)
    numbers = (run.wall_seconds, *(error for error in errors if error is not None))
    if not all(isinstance(v, (int, float)) and not isinstance(v, bool) and 0.0 <= v < LARGEST for v in numbers):
        return "wall_seconds and the errors in summary.json must be numbers, not negative"
    if isinstance(run.steps, bool) or not isinstance(run.steps, int) or not 0 <= run.steps < LARGEST:
        return "steps in summary.json must be a whole number"
    if not all(isinstance(bound.holds, bool) for bound in run.bounds.values()):
        return "summary.json does not hold true or false for each bound"
    if (summary["cells"], summary["supplied"], summary["status"]) != (run.cells, run.time[-1], run.status):
        return "profile.nc and summary.json are not of the same run"
    return ""


def _of_case(run: Run) -> str:
    if not all(isinstance(run.case.get(name), Mapping) for name in SECTIONS):
        return f"the stored case must have the sections {', '.join(SECTIONS)}"
    if run.case["erosion"].get("law") != "python":  # the file would run its author's code
        law_from(run.case["erosion"])
    if not isinstance(run.case["solver"].get("method"), str):
        return "the stored case must name a method"
    return ""


def _of_units(run: Run) -> str:
    if run.units is None:
        return ""
    values = np.array([run.units.length, run.units.critical_slope, run.units.x_top, run.units.height_top])
    if len(run.units.unit) > LONGEST_UNIT:
        return f"the name of a unit has more than {LONGEST_UNIT} characters"
    if not (np.all(np.abs(values) <= LARGEST) and min(run.units.length, run.units.critical_slope) > 1.0 / LARGEST):
        return "the units of the survey must be numbers, its length and critical slope positive"
    return ""


def _of_tables(run: Run) -> str:
    first, last, left, right = float(run.time[0]), float(run.time[-1]), float(run.x[0]), float(run.x[-1])
    times, hair = set(run.time.tolist()), 1e-9
    for name, rows in (("kinks.csv", run.kinks), ("vertical_steps.csv", run.vertical_steps or ())):
        for row in rows:
            numbers = [value for field, value in row._asdict().items() if field != "speed"]  # NaN if unknown
            here = left - hair <= row.x <= right + hair and 0 < row[1] < MOST
            if not (row.time in times and here and np.all(np.isfinite(numbers)) and not np.isinf(row.speed)):
                return f"{name} holds a row that is not of this run: {row}"
    for event in run.events:
        during = first - hair <= event.time <= last + hair and 0 < event.kink < MOST and 0 < (event.into or 1) < MOST
        if not (event.event in EVENTS and during and left - hair <= event.x <= right + hair):
            return f"events.csv holds a row that is not of this run: {event}"
    return ""
