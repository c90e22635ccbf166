"""The command that solves a case."""

from __future__ import annotations

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
    from hjprofile.output.run_account import run_account
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
    say(json, run_account(result))
    if checkpoint.resumed_at is not None:
        say(json, f"  resumed     from the checkpoint at t = {checkpoint.resumed_at:.6g}")
    elif resume:
        say(json, "  resumed     no: there is no checkpoint, so the run started at t = 0")
    say(json, f"  written     {folder}: {listing(folder.path, files)}")
    answer(json, summary(result) | {"resumed_at": checkpoint.resumed_at, "files": files})
    if not result.done:
        raise RunError(f"{loaded.source}: {result.status.rstrip('.')}; the last good state is in {folder}")
