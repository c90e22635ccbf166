"""One comparison of the consistency test, and the verdict on a case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

QUIET = ("bounds:", "saved-")  # comparisons that are printed only if they fail


class Check(NamedTuple):
    """One comparison: errors on each grid, the observed order, and the criterion.

    If it is not `resolved`, the grids are too coarse for a decision, and the comparison is open. It then does not fail.
    If it is open and `decides`, the verdict on the case is "not resolved"; otherwise it is informational.
    """

    name: str
    cells: list[int]
    error: list[float]
    order: float | None
    threshold: float
    passes: bool
    rule: str
    resolved: bool = True
    unit: str = "cells"  # unit of `cells`
    decides: bool = True

    def line(self) -> str:
        """Return the line that is printed."""
        order = f"order {self.order:.2f}, " if self.order is not None else ""
        cells = f" on {self.cells[-1]} {self.unit}"
        verdict = ("passes" if self.resolved else "open") if self.passes else "FAILS"
        return f"{verdict:7} {self.name:38} {order}{self.error[-1]:.2g}{cells}  ({self.rule})"


@dataclass(frozen=True, repr=False)
class Consistency:
    """The consistency test of one case: true unless a comparison fails; as text, a line for each.

    In a test suite, `assert hj.check("my_case.toml")` shows the failed comparisons. `verdict` distinguishes a case that
    passes from one that is not resolved.
    """

    case: str
    title: str
    comparisons: Sequence[Check]
    remedy: str = "use more cells"

    @property
    def passes(self) -> bool:
        """True if no comparison fails."""
        return all(c.passes for c in self.comparisons)

    @property
    def open(self) -> list[str]:
        """The names of the comparisons that decide and that the grids leave open."""
        return [c.name for c in self.comparisons if c.decides and not c.resolved]

    @property
    def verdict(self) -> str:
        """The result: "passes", "fails" or "not resolved"; a failure precedes an open comparison."""
        if not self.passes:
            return "fails"
        return "not resolved" if self.open else "passes"

    def __bool__(self) -> bool:
        return self.passes

    def __str__(self) -> str:
        shown = [c for c in self.comparisons if not (c.name.startswith(QUIET) and c.passes and c.resolved)]
        lines = [f"{self.case}: {self._headline}", *(c.line() for c in shown)]
        return "\n  ".join([*lines, *(f"WARNING: {sentence}" for sentence in self.warnings)])

    @property
    def _headline(self) -> str:
        words = {"fails": "FAILS", "not resolved": f"not resolved on these grids: {', '.join(self.open)}"}
        return words.get(self.verdict, self.verdict)

    @property
    def warnings(self) -> list[str]:
        """A sentence if the grids are too coarse for comparisons that decide."""
        if not self.open:
            return []
        return [f"the grids do not resolve the profile, which leaves {', '.join(self.open)} open; {self.remedy}"]

    def __repr__(self) -> str:
        failed = [" ".join(c.line().split()) for c in self.comparisons if not c.passes]
        return f"<{self.case}: {'; '.join(failed) or self._headline}>"

    def report(self) -> dict[str, Any]:
        """Return the entry of `check.json`."""
        about = {"case": self.case, "title": self.title, "passes": self.passes, "verdict": self.verdict}
        return about | {"warnings": self.warnings, "comparisons": [c._asdict() for c in self.comparisons]}


def verdict_of_all(verdicts: Sequence[Consistency]) -> str:
    """Return the least favourable verdict on several cases."""
    found = {one.verdict for one in verdicts}
    return next((verdict for verdict in ("fails", "not resolved") if verdict in found), "passes")
