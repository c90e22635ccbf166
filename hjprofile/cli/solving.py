"""The commands sweep, fit and cases."""

from __future__ import annotations

from hjprofile.cli.common import (
    After,
    CasePath,
    Fitted,
    Json,
    Kept,
    Out,
    Progress,
    Quiet,
    Sigma,
    Vary,
    Workers,
    answer,
    app,
    folder_for,
    listing,
    load_cases,
    say,
)
from hjprofile.errors import RunError


@app.command
def sweep(
    case: CasePath,
    /,
    *,
    vary: Vary,
    workers: Workers = None,
    resume: Kept = False,
    out: Out = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Solve a case for every combination of values of some of its keys, and write one table.

    Writes sweep.csv and sweep.nc. The exit code is 1 if no member could be solved.
    """
    from hjprofile.output.folder import MEMBERS
    from hjprofile.output.sweep_results import account, report
    from hjprofile.output.sweep_results import sweep as run_sweep
    from hjprofile.output.workers import processes
    from hjprofile.problem.case_files import read_choices

    choices = read_choices(vary)
    folder = folder_for((case,), out, keep=MEMBERS if resume else "").path
    with processes(workers) as executor, Progress("sweeping", not quiet, solves=False) as progress:
        result = run_sweep(case, choices, executor, folder, resume, progress)
    say(quiet or json, account(result))
    say(quiet or json, f"written to {folder}: sweep.csv, sweep.nc")
    answer(json, report(result) | {"files": [folder / "sweep.csv", folder / "sweep.nc"]})
    if not any(outcome.done for outcome in result.outcomes):
        raise RunError(f"{case}: no member was solved; the reasons are in {folder / 'sweep.csv'}")


@app.command
def fit(
    case: CasePath,
    after: After,
    /,
    *,
    vary: Fitted,
    sigma: Sigma = None,
    out: Out = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Fit parameters of a case to a survey made afterwards, with 95 % intervals.

    The profile of the case is the survey before. Writes fit.json, fit.png and fitted.toml, the case with the fitted
    values.
    """
    from hjprofile.output.fit_report import fit_account, fit_report
    from hjprofile.output.study_files import study_files, write_files
    from hjprofile.problem.survey import read_survey
    from hjprofile.studies.calibration import fit as fit_case

    folder, (loaded,) = load_cases((case,), out)
    x, height, _ = read_survey(after)
    found = fit_case(loaded.source, x, height, vary, sigma)
    written = write_files(folder.open(), study_files(found))
    say(quiet or json, fit_account(found))
    lines = [f"  WARNING   {warning}" for warning in written.warnings]
    say(quiet or json, "\n".join([*lines, f"  written     {folder}: {listing(folder.path, written.files)}"]))
    answer(json, fit_report(found) | {"files": written.files})


@app.command
def cases(*, json: Json = False) -> None:
    """List the cases that come with the package."""
    import tomllib

    from hjprofile.problem.case_files import shipped_cases

    shipped = shipped_cases()
    titles = {name: tomllib.loads(path.read_text(encoding="utf-8")).get("title", "") for name, path in shipped.items()}
    width = max(map(len, shipped), default=0)
    say(json, "\n".join(f"{name:{width}}  {title}" for name, title in titles.items()))
    answer(json, {"cases": [{"case": n, "title": title, "file": shipped[n]} for n, title in titles.items()]})
