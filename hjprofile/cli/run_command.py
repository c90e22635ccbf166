"""The command that solves a case."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hjprofile.cli.common import (
    CasePath,
    Cells,
    Cfl,
    End,
    Json,
    Method,
    Out,
    Progress,
    Resume,
    Strict,
    Tolerance,
    answer,
    app,
    folder_for,
    listing,
    say,
)
from hjprofile.errors import RunError

if TYPE_CHECKING:
    from hjprofile.solvers.run import Run


@app.command
def run(
    case: CasePath,
    /,
    *,
    method: Method = None,
    cells: Cells = None,
    cfl: Cfl = None,
    tolerance: Tolerance = None,
    end: End = None,
    strict: Strict = False,
    resume: Resume = False,
    out: Out = None,
    json: Json = False,
) -> None:
    """Solve a case and write its result folder."""
    from hjprofile.output.checkpoint import NAME, Checkpoint
    from hjprofile.output.store import summary, write_results
    from hjprofile.output.workers import drawing_helper
    from hjprofile.problem.case import load_case

    if tolerance is not None and method is None:
        method = "auto"
    solver = {"solver.method": method, "solver.cfl": cfl, "solver.tolerance": tolerance}
    asked = solver | {"domain.cells": cells, "time.end": end}
    loaded = load_case(case, {key: value for key, value in asked.items() if value is not None})
    folder = folder_for((case,), out, keep=NAME if resume else "")
    with drawing_helper(loaded.plots) as helper:
        from hjprofile.solvers.solve import check_case, solve_case

        check_case(loaded)
        folder.open()
        checkpoint = Checkpoint(folder.path, loaded.checkpoint, resume, folder.claim)
        with Progress("solving") as progress:
            result = solve_case(loaded, progress, strict, checkpoint)
        result, files = write_results(result, folder, loaded.vtk, loaded.plots, helper)
        checkpoint.discard()
    say(json, _account(result))
    if checkpoint.resumed_at is not None:
        say(json, f"  resumed     from the checkpoint at t = {checkpoint.resumed_at:.6g}")
    elif resume:
        say(json, "  resumed     no: there is no checkpoint, so the run started at t = 0")
    say(json, f"  written     {folder}: {listing(folder.path, files)}")
    answer(json, summary(result) | {"resumed_at": checkpoint.resumed_at, "files": files})
    if not result.done:
        raise RunError(f"{loaded.source}: {result.status.rstrip('.')}; the last good state is in {folder}")


def _account(run: Run) -> str:
    """Return the account of a run: method, budgets, bounds, warnings, in a few lines."""
    eroded = run.eroded_volume
    volume = f"net {'erosion' if eroded >= 0 else 'deposition'} {abs(eroded):.6g}"
    supplied = ""
    if run.units:
        volume += f" ({run.units.volume_text(abs(eroded) * run.units.volume)})"
        supplied = f" (supplied: {run.units.volume_text(run.time[-1] * run.units.volume)})"
    count = {kind: sum(e.event == kind for e in run.events) for kind in ("birth", "merge", "exit")}
    plural = {"birth": "births", "merge": "merges", "exit": "exits"}
    events = ", ".join(f"{n} {plural[kind] if n != 1 else kind}" for kind, n in count.items())
    lost = len(run.kinks_at(0)) + count["birth"] - count["merge"] - count["exit"] - len(run.kinks_at(-1))
    if lost > 0 and run.vertical_steps is None:
        events += f", {lost} unresolved"
    mass, budget = run.bounds["mass_budget"], run.bounds.get("volume_budget")
    lines = [
        run.title,
        f"  solved      {run.method}, {run.cells} cells, {run.steps} time steps in {run.wall_seconds:.2g} s "
        f"to t = {run.time[-1]:g}{supplied}",
        f"  volume      {volume}",
        f"  kinks       {len(run.kinks_at(0))} at t = {run.time[0]:g}, {len(run.kinks_at(-1))} at the end; {events}",
        f"  budgets     mass {f'to {mass.allowance}' if mass.holds else 'VIOLATED'}; "
        + (f"volume to {run.volume_budget_error:.2g} ({budget.allowance})" if budget else "none of volume"),
        f"  bounds      {'all hold' if not run.broken_bounds else 'VIOLATED:'}",
        *(f"  WARNING     {warning}" for warning in run.warnings),
    ]
    if run.vertical_steps is not None:
        broke, now = (sum(e.event == "blow-up" for e in run.events), run.steps_at(-1))
        tallest = f"; the tallest is {max(s.height for s in now):.4g} high" if now else ""
        lines.insert(4, f"  vertical    {len(now)} steps at the end, {broke} blow-up{'s' * (broke != 1)}{tallest}")
    if run.error_estimate is not None:
        lines.append(f"  error       ‖u - u_exact‖_∞ about {run.error_estimate:.2g} (estimate)")
    said = run.account.splitlines()  # notes on the data, then the note on the choice of `auto`
    labels = ["data", "chosen"][-len(said) :] if run.case["solver"]["method"] == "auto" else ["data"]
    lines[1:1] = [f"  {label:11} {text}" for label, text in zip(labels, said, strict=False)]
    return "\n".join(lines)
