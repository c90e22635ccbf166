"""The files of studies: their tables and pictures, as commands write them."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, cast

from hjprofile.errors import InputError
from hjprofile.output.folder import Owner, ResultFolder, folder_of
from hjprofile.output.store import attempt, to_csv, to_json
from hjprofile.output.survey_columns import with_survey_columns
from hjprofile.problem.case import to_toml
from hjprofile.problem.ranges import as_path, shown
from hjprofile.studies.calibration import Calibration
from hjprofile.studies.characteristic_statements import COLUMNS
from hjprofile.studies.chart import Chart, Point
from hjprofile.studies.dependence import Dependence, Distance
from hjprofile.studies.stability import Stability, Trial
from hjprofile.studies.statements import StatementRow, Statements
from hjprofile.studies.verdict import Consistency, verdict_of_all

Study = Consistency | Chart | Stability | Dependence | Statements | Calibration
KINDS = "a result of check, chart, stability, dependence, statements or fit"


class Written(NamedTuple):
    """The files of optional products, and a warning for each product that could not be made."""

    files: list[Path]
    warnings: list[str]


class StudyFiles(NamedTuple):
    """The files of a study.

    Attributes:
        tables: name -> content.
        pictures: name -> function that draws it, or None if the study has no such picture now.
    """

    tables: dict[str, bytes | str]
    pictures: Mapping[str, Callable[[], bytes | str] | None]


def study_files(study: Study | Sequence[Study]) -> StudyFiles:
    """Return the files of a study, or of a sequence of checks or of charts. Raise InputError for another object."""
    studies = list(study) if isinstance(study, Sequence) else [study]
    kinds = {type(one) for one in studies}
    kind = kinds.pop() if len(kinds) == 1 else None
    if kind is Consistency:
        return _of_checks(cast(list[Consistency], studies))
    if kind is Chart:
        return _of_charts(cast(list[Chart], studies))
    if len(studies) == 1 and kind in _FILES:
        return _FILES[kind](studies[0])
    raise InputError(f"study = {shown(study)} must be {KINDS}, or a list of checks or of charts")


def _of_checks(checks: list[Consistency]) -> StudyFiles:
    return StudyFiles({"check.json": to_json(check_report(checks))}, {})


def check_report(checks: Sequence[Consistency]) -> dict:
    """Return the content of `check.json` as a dictionary."""
    passes = all(one.passes for one in checks)
    return {"passes": passes, "verdict": verdict_of_all(checks), "cases": [one.report() for one in checks]}


def _of_charts(charts: list[Chart]) -> StudyFiles:
    from hjprofile.output.plots.study_pictures import chart_picture

    table = to_csv(Point._fields, [point for chart in charts for point in chart.points])
    return StudyFiles({"chart.csv": table}, {"chart.png": partial(chart_picture, charts)})


def _of_stability(found: Stability) -> StudyFiles:
    from hjprofile.output.plots.study_pictures import stability_picture

    table = to_csv(Trial._fields[:6], [trial[:6] for trial in found.rows])
    return StudyFiles({"stability.csv": table}, {"stability.png": partial(stability_picture, found.rows)})


def _of_dependence(found: Dependence) -> StudyFiles:
    from hjprofile.output.plots.study_pictures import dependence_picture

    table = to_csv(Distance._fields, found.rows)
    return StudyFiles({"dependence.csv": table}, {"dependence.png": partial(dependence_picture, found.rows)})


def _of_statements(found: Statements) -> StudyFiles:
    from hjprofile.output.plots.statement_pictures import invariant_picture, statements_picture

    tables: dict[str, bytes | str] = {
        "statements.csv": to_csv(*with_survey_columns(StatementRow._fields, found.rows, found.units)),
        "characteristics.csv": to_csv(*with_survey_columns(COLUMNS, found.characteristics.rows(), found.units)),
    }
    invariant = partial(invariant_picture, found.case, found.characteristics)
    pictures = {
        "statements.png": partial(statements_picture, found.case, found),
        "invariant.png": invariant if found["invariant"].applies else None,
    }
    return StudyFiles(tables, pictures)


def _of_fit(found: Calibration) -> StudyFiles:
    from hjprofile.output.fit_report import fit_report
    from hjprofile.output.plots.study_pictures import fit_picture

    tables: dict[str, bytes | str] = {"fit.json": to_json(fit_report(found)), "fitted.toml": to_toml(found.case)}
    return StudyFiles(tables, {"fit.png": partial(fit_picture, found)})


_FILES: Mapping[type | None, Callable] = {
    Stability: _of_stability, Dependence: _of_dependence, Statements: _of_statements, Calibration: _of_fit,
}  # fmt: skip


def write_study(study: Study | Sequence[Study], folder: str | Path) -> list[Path]:
    """Write the tables and pictures of a study into a folder, as its command does.

    Files of an earlier study of the same kind are replaced. If a picture cannot be drawn, the tables are complete and a
    UserWarning is issued.

    Args:
        study: a result of `check`, `chart`, `stability`, `dependence`, `statements` or `fit`; several checks or several
            charts may be given as a list.
        folder: the path of the folder, which is created.

    Returns:
        The paths of the written files.

    Raises:
        InputError: for another object, or if the folder belongs to a run or to a study of another case.
        OSError: if the folder is not writable.

    >>> import tempfile
    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [0.8]), end=1.0)
    >>> found = hj.statements(problem, hj.Grid(-5.0, 100), name="one kink")
    >>> files = hj.write_study(found, tempfile.mkdtemp())
    >>> sorted(file.name for file in files)
    ['characteristics.csv', 'statements.csv', 'statements.png']
    """
    files, path = study_files(study), as_path("folder", folder)
    names = sorted({_name(one) for one in (study if isinstance(study, Sequence) else [study])})
    owner = Owner((), hashlib.sha256("\n".join(names).encode()).hexdigest())
    written = write_files(folder_of(path, owner), files)
    for warning in written.warnings:
        warnings.warn(warning, stacklevel=2)
    return written.files


def _name(study: Study) -> str:
    return study.title if isinstance(study, Calibration) else study.case


def write_files(place: ResultFolder, files: StudyFiles) -> Written:
    """Write the tables of a study, then its pictures.

    Pictures of an earlier study are removed first, so that none remains with the tables of a later one.
    """
    place.remove(files.pictures)
    paths = place.write(files.tables)
    failures: list[str] = []
    for name, draw in files.pictures.items():
        if draw:
            paths += place.write(attempt(failures, f"{name} could not be drawn", _named, name, draw))
    return Written(paths, failures)


def _named(name: str, draw: Callable[[], bytes | str]) -> dict[str, bytes | str]:
    return {name: draw()}
