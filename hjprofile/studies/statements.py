"""Study of the statements of the source paper that hold at each time, with computed constants (theory.md §9).

Each statement is an inequality, value <= bound, at one or several times of a run. A statement that the discrete
solution satisfies exactly has only rounding as allowance. The statements along characteristics are equalities; their
bound is an estimate of the error of the computation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import instance
from hjprofile.problem.units import Units
from hjprofile.solvers.method import Feature, require, requirements
from hjprofile.studies.characteristic_statements import INVARIANT, WORDS, Characteristics, follow
from hjprofile.studies.statement_runs import FractionalStep, History, evolve, freeze
from hjprofile.studies.statement_table import NONLOCAL, STATEMENTS, Series, conditions

NO_SERIES: Series = (np.empty(0), np.empty(0), np.empty(0))
CELLS = 1000  # largest number of cells of the command
ROUNDING_EXCESS = 1e-10  # excess of a value over its bound that counts as rounding, relative to the bound or to 1
SHARES = 0.7, 0.1, 0.2  # of the work: the history, the frozen intervals, the characteristics


class StatementRow(NamedTuple):
    """One statement at one time: `value` <= `bound`, except for rounding.

    Attributes:
        statement: its name.
        equation: its number in the source paper, or the place of an unnumbered statement.
    """

    statement: str
    equation: str
    time: float
    value: float
    bound: float

    @property
    def holds(self) -> bool:
        """True if the value exceeds the bound by no more than rounding."""
        return bool(self.value <= self.bound + ROUNDING_EXCESS * max(1.0, abs(self.bound)))

    @property
    def share(self) -> float:
        """The value relative to the bound; 0 if both are zero except for rounding."""
        if abs(self.value) <= ROUNDING_EXCESS and abs(self.bound) <= ROUNDING_EXCESS:
            return 0.0
        return self.value / self.bound if self.bound else float(np.copysign(np.inf, self.value))


class StatementResult(NamedTuple):
    """The result for one statement over all its times.

    Attributes:
        statement, equation: as in the rows; words: the statement as a formula.
        applies: False if the problem is not of the kind for which it is stated; `reason` states why.
        holds: False if a row violates it; True if it does not apply.
        time, value, bound: of the row with the largest value relative to the bound; NaN if it does not apply.
    """

    statement: str
    equation: str
    words: str
    applies: bool
    holds: bool
    time: float
    value: float
    bound: float
    reason: str

    def __str__(self) -> str:
        """Return one line of the account."""
        head = f"{self.equation:<15} {self.words:<64}"
        if not self.applies:
            return f"{head} not applicable: {self.reason}"
        result = "holds" if self.holds else "FAILS"
        return f"{head} {result}  {self.value:.4g} / {self.bound:.4g} at t = {self.time:.4g}"


@dataclass(frozen=True)
class Statements:
    """Results of the study.

    Attributes:
        case: the name of the case.
        rows: all values and bounds, by statement and time.
        results: one for each statement.
        characteristics: the characteristics that were followed, as a table.
        units: the units of a survey, else None.
    """

    case: str
    rows: tuple[StatementRow, ...]
    results: tuple[StatementResult, ...]
    characteristics: Characteristics
    units: Units | None = None

    @property
    def holds(self) -> bool:
        """True if no statement is violated."""
        return all(result.holds for result in self.results)

    def __getitem__(self, statement: str) -> StatementResult:
        """Return the result of the statement with this name."""
        return next(result for result in self.results if result.statement == statement)


def statements(
    problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None, name: str = ""
) -> Statements:
    """Evaluate statements of the source paper for a problem, with the constants that it leaves generic.

    The method is the upwind scheme on the given grid, in time steps that are short enough for it to be monotone. The
    constants are computed from the run. Statements along characteristics use `conservative` on the same grid.

    Args:
        problem: slow erosion on the half line, with K or with a prescribed coefficient.
        grid: the grid.
        progress: a function that is called with the completed fraction in [0, 1].
        name: the name of the case in tables and pictures; the title of the problem by default.

    Returns:
        The values and bounds of each statement, a result for each, and the characteristics.

    Raises:
        InputError: for a rolling layer, a law of linear growth, the whole line, or an end at 0.
        RunError: if a run cannot continue.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [0.8]), end=1.0)
    >>> found = hj.statements(problem, hj.Grid(-5.0, 200))
    >>> found.holds, found["k_apart"].applies
    (True, True)
    """
    instance("problem", problem, Problem)
    instance("grid", grid, Grid)
    require("the study of the statements", {Feature.COEFFICIENT, Feature.INFLOW}, requirements(problem))
    problem.check(grid)
    if not problem.end > 0.0:
        raise InputError("end = 0; the study of the statements needs an end above 0")
    done = np.cumsum((0.0, *SHARES))

    def part(i: int) -> Callable[[float], None] | None:
        return None if progress is None else lambda fraction: progress(float(done[i] + SHARES[i] * fraction))

    history, frozen = evolve(problem, grid, part(0)), freeze(problem, grid, part(1))
    characteristics = follow(problem, grid, part(2))
    found = [*_on_the_slope(history, frozen), *_on_characteristics(characteristics, history.nonlocal_)]
    rows = tuple(row for mine, _ in found for row in mine)
    results = tuple(result for _, result in found)
    return Statements(name or problem.title, rows, results, characteristics, problem.profile.units)


def _on_the_slope(
    history: History, frozen: Sequence[FractionalStep]
) -> Iterator[tuple[list[StatementRow], StatementResult]]:
    """Yield rows and result of each statement on a state at a time."""
    missing = conditions(history)
    for statement in STATEMENTS:
        reason = next((need for need in statement.needs if need in missing), "")
        with np.errstate(over="ignore", divide="ignore"):  # a bound may be infinite
            series = NO_SERIES if reason else statement.series(history, frozen)
        yield judge(statement.name, statement.equation, statement.words, series, reason)


def _on_characteristics(
    found: Characteristics, nonlocal_: bool
) -> Iterator[tuple[list[StatementRow], StatementResult]]:
    """Yield rows and result of each statement along characteristics, with the largest defect at each time."""
    for name, (equation, words) in WORDS.items():
        series, reason = NO_SERIES, found.reason
        if name == INVARIANT and not nonlocal_:
            reason = NONLOCAL
        if not reason:
            defect = np.abs(found.defects[name])
            known = np.isfinite(defect).any(axis=1)
            value = np.nanmax(defect[known], axis=1)
            series = found.time[known], value, np.full(value.size, found.allowances[name])
        yield judge(name, equation, words, series, reason)


def judge(
    name: str, equation: str, words: str, series: Series, reason: str
) -> tuple[list[StatementRow], StatementResult]:
    """Return the rows and the result of one statement; a reason means that it does not apply."""
    rows = [StatementRow(name, equation, float(t), float(v), float(b)) for t, v, b in zip(*series, strict=True)]
    if not rows:
        return rows, StatementResult(name, equation, words, False, True, np.nan, np.nan, np.nan, reason)
    worst = max(rows, key=lambda row: (not row.holds, row.share))
    return rows, StatementResult(name, equation, words, True, worst.holds, worst.time, worst.value, worst.bound, "")
