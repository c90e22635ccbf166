"""The account of a run for a reader: method, totals, kinks, budgets, bounds, warnings and errors, in a few lines."""

from __future__ import annotations

import math

from hjprofile.problem.units import Units
from hjprofile.solvers.run import Run

SMALLEST_PLACE, LARGEST_NUMBER = -6, 1e8  # digits after the point, and numbers, that are written without an exponent
PLURALS = {"birth": "births", "merge": "merges", "exit": "exits"}


def run_account(run: Run) -> str:
    """Return the account of a run, one fact in each line."""
    lines = [
        ("solved", _solved(run)),
        ("volume", _volume(run)),
        ("toe outflow", _toe(run)),
        ("vertical", _vertical_steps(run)),
        ("kinks", _kinks(run)),
        ("budgets", _budgets(run)),
        ("bounds", "all hold" if not run.broken_bounds else "VIOLATED:"),
        *(("WARNING", sentence) for sentence in (*run.cautions, *run.broken_bounds)),
        ("error", _error(run)),
    ]
    choice = run.account.splitlines()[len(run.input_changes) :]
    given = [*(("data", line) for line in run.input_changes), *(("chosen", line) for line in choice)]
    return "\n".join([run.title, *(f"  {label:11} {text}" for label, text in (*given, *lines) if text)])


def with_error(value: float, error: float | None) -> str:
    """Return a number with its error of two digits, rounded to the last of them unless one of the two is very small.

    >>> with_error(0.37882, 0.0097), with_error(29131.2, 132.0), with_error(2.5, 1.2e-11), with_error(2.5, None)
    ('0.3788 ± 0.0097', '29130 ± 130', '2.5 ± 1.2e-11', '2.5')
    """
    if not error:
        return f"{value:.6g}"
    place = math.floor(math.log10(error)) - 1
    if place < SMALLEST_PLACE or not max(abs(value), error) < LARGEST_NUMBER:
        return f"{value:.6g} ± {error:.2g}"
    return f"{round(value, -place):.{max(-place, 0)}f} ± {round(error, -place):.{max(-place, 0)}f}"


def _in_units(units: Units, value: float, error: float | None) -> str:
    return f"{with_error(value * units.volume, error and error * units.volume)} {units.of_volume}"


def _solved(run: Run) -> str:
    return (
        f"{run.method}, {run.cells} cells, {run.steps} time steps in {run.wall_seconds:.2g} s to t = {run.time[-1]:g}"
    )


def _volume(run: Run) -> str:
    eroded, error = run.eroded_volume, run.eroded_volume_error
    text = f"net {'erosion' if eroded >= 0 else 'deposition'} {with_error(abs(eroded), error)}"
    if run.units:
        text += f" ({_in_units(run.units, abs(eroded), error)})"
    return text


def _toe(run: Run) -> str:
    if math.isnan(run.toe_outflow):
        return ""
    supplied = float(run.time[-1])
    text = f"{with_error(run.toe_outflow, run.toe_outflow_error)} of {supplied:g} supplied"
    if run.units:
        volume, error = run.units.volume, run.toe_outflow_error
        outflow = with_error(run.toe_outflow * volume, error and error * volume)
        text += f" ({outflow} of {run.units.volume_text(supplied * volume)})"
    return text


def _vertical_steps(run: Run) -> str:
    if run.vertical_steps is None:
        return ""
    broke, now = (sum(e.event == "blow-up" for e in run.events), run.steps_at(-1))
    tallest = f"; the tallest is {max(s.height for s in now):.4g} high" if now else ""
    return f"{len(now)} steps at the end, {broke} blow-up{'s' * (broke != 1)}{tallest}"


def _kinks(run: Run) -> str:
    count = {kind: sum(e.event == kind for e in run.events) for kind in PLURALS}
    events = ", ".join(f"{n} {PLURALS[kind] if n != 1 else kind}" for kind, n in count.items())
    lost = len(run.kinks_at(0)) + count["birth"] - count["merge"] - count["exit"] - len(run.kinks_at(-1))
    if lost > 0 and run.vertical_steps is None:
        events += f", {lost} unresolved"
    return f"{len(run.kinks_at(0))} at t = {run.time[0]:g}, {len(run.kinks_at(-1))} at the end; {events}"


def _budgets(run: Run) -> str:
    mass, budget = run.bounds["mass_budget"], run.bounds.get("volume_budget")
    volume = f"volume to {run.volume_budget_error:.2g} ({budget.allowance})" if budget else "none of volume"
    return f"mass {f'to {mass.allowance}' if mass.holds else 'VIOLATED'}; {volume}"


def _error(run: Run) -> str:
    if run.error_estimate is None:
        return "not known: no independent method solves this case to its end"
    text = f"‖u - u_exact‖_∞ about {run.error_estimate:.2g} (estimate)"
    if run.units:
        text += f", {run.error_estimate * run.units.rise:.2g} {run.units.of_length}"
    return text
