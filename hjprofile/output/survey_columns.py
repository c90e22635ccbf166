"""Columns of tables in the units of a survey, which follow the dimensionless ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from hjprofile.problem.units import Units

_IN_UNITS: dict[str, tuple[str, Callable[[Units, float], Any]]] = {  # column -> its column in the survey's units
    "time": ("time_survey", lambda units, t: units.volume * t),
    "x": ("x_survey", lambda units, x: units.x(x)),
    "height": ("height_survey", lambda units, height: units.rise * height),
    "l1": ("l1_survey", lambda units, height: units.rise * height),
    "inf_q": ("least_slope", lambda units, q: units.slope(q)),
    "sup_q": ("largest_slope", lambda units, q: units.slope(q)),
    "q_left": ("slope_left", lambda units, q: units.slope(q)),
    "q_right": ("slope_right", lambda units, q: units.slope(q)),
    "end": ("end_survey", lambda units, t: units.volume * t),
    "eroded_volume": ("eroded_volume_survey", lambda units, volume: units.volume * volume),
    "volume_budget_error": ("volume_budget_error_survey", lambda units, volume: units.volume * volume),
    "toe_outflow": ("toe_outflow_survey", lambda units, volume: units.volume * volume),
    "crest_lowering": ("crest_lowering_survey", lambda units, height: units.rise * height),
    "largest_lowering": ("largest_lowering_survey", lambda units, height: units.rise * height),
    "largest_rise": ("largest_rise_survey", lambda units, height: units.rise * height),
    "kink_x": ("kink_x_survey", lambda units, x: units.x(x)),
    "error_estimate": ("error_estimate_survey", lambda units, height: units.rise * height),
}


def survey_columns(columns: Iterable[str]) -> dict[str, str]:
    """Return the additional columns of a table with these columns, name -> the column from which it follows."""
    return {_IN_UNITS[column][0]: column for column in columns if column in _IN_UNITS}


def names_with_survey_columns(columns: Iterable[str]) -> list[str]:
    """Return the columns of a table and, after them, the additional ones."""
    columns = list(columns)
    return [*columns, *survey_columns(columns)]


def in_survey_units(column: str, value: float, units: Units) -> float:
    """Return a value of a dimensionless column in the units of a survey."""
    return float(_IN_UNITS[column][1](units, value))


def with_survey_columns(
    columns: Sequence[str], rows: Iterable[Sequence[Any]], units: Units | None
) -> tuple[Sequence[str], Iterable[tuple]]:
    """Return the header and the rows of a table, with the additional columns if there are units."""
    if units is None:
        return columns, (tuple(row) for row in rows)
    places = [columns.index(column) for column in survey_columns(columns).values()]

    def longer(known: Units) -> Iterator[tuple]:
        for row in rows:
            yield *row, *(in_survey_units(columns[i], row[i], known) for i in places)

    return names_with_survey_columns(columns), longer(units)
