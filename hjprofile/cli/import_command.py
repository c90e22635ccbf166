"""The command that makes a case from a file of measured points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from hjprofile.cli.common import OUT, Json, answer, app, expanded, say

Source = Annotated[Path, Parameter(converter=expanded, help="A text file with a point per line, in any notation.")]
Slope = Annotated[float | None, Parameter(help="Neutral slope, height over length; the mean slope by default.")]
Length = Annotated[float | None, Parameter(help="Exchange length in the unit of x; a tenth of the extent by default.")]
Columns = Annotated[
    str | None, Parameter(help="Columns of x and height, or x, y and height: names or numbers, as 2,4.")
]
Uphill = Annotated[Literal["left", "right"] | None, Parameter(help="Side of the crest; found from the heights.")]
Nodata = Annotated[list[float] | None, Parameter(help="Number that stands for no height. May be repeated.")]
From = Annotated[float | None, Parameter(name="--from", help="Smallest x that is used.")]
To = Annotated[float | None, Parameter(help="Largest x that is used.")]
NewCase = Annotated[
    Path | None, Parameter(OUT, converter=expanded, help="The new case file; FILE with .toml by default.")
]


@app.command(name="import")
def import_(
    file: Source, /, *, critical_slope: Slope = None, length: Length = None, columns: Columns = None,
    uphill: Uphill = None, nodata: Nodata = None, from_: From = None, to: To = None, out: NewCase = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Make a case from a file of measured points: a clean CSV file, and a case file next to it.

    Separators, decimal commas, headers, units in headers, gaps and the direction are recognised. No file is replaced.
    """
    from hjprofile.problem.survey_import import import_survey

    wanted = [int(name) if name.isdigit() else name for name in columns.split(",")] if columns else None
    reading: dict[str, Any] = {"columns": wanted, "nodata": nodata, "uphill": uphill, "from": from_, "to": to}
    made = import_survey(file, out, critical_slope, length, **reading)
    lines = [*made.account, f"written: {made.survey}, {made.case}", f"next: hjprofile run {made.case}"]
    say(json, "\n".join(lines))
    answer(json, {"case": made.case, "survey": made.survey, "account": made.account})
