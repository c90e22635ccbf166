"""Files of measured points as programs write them: encodings, separators, decimals, columns, gaps and order."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hjprofile.errors import InputError
from hjprofile.problem.heights import without_height
from hjprofile.problem.lists import as_numbers, same_length
from hjprofile.problem.paths import require_file
from hjprofile.problem.ranges import Array, shown

ABOUT = "an-imported-survey"
MOST_ROWS = 5  # that a message names
LONGEST_SHOWN = 60  # characters of a line in a message
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "bars", ",": "commas", "": "blanks"}  # the first that fits is taken
SAMPLE = 200  # lines at each end of a file in which the separator is sought
NEARLY_ALL = 0.9  # of the lines of a file
COMMENT = ("#", "%", "//", "!")
EMPTY = {"", "nan", "na", "n/a", "#n/a", "null", "none", "nodata", "-", "--", "*"}
GROUPS = "'’ \u00a0\u2009\u202f"  # marks between groups of three digits, besides the comma and the point
NUMBER = re.compile(rf"[+-]?(\d[\d.,{GROUPS}]*|[.,]\d+)([eEdD][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?")
STRONG = "\t;|"  # separators that are in no number and hardly in a remark
STATION = re.compile(r"([+-]?\d+)\+(\d{3}(?:[.,]\d*)?)")  # kilometres and metres
# Names of columns, the first that occurs is taken; also in German, French, Spanish and Italian
DISTANCE = (
    "distance", "dist", "chainage", "station", "sta", "offset", "s", "x", "entfernung", "abstand", "distanz",
    "progresiva", "distancia", "progressiva", "distanza",
)  # fmt: skip
HEIGHT = (
    "height", "elevation", "elev", "altitude", "alt", "z", "h", "ele", "rl", "höhe", "hoehe", "cota", "altura", "quota",
)  # fmt: skip
EASTING, NORTHING = ("x", "easting", "east", "e", "utmx"), ("y", "northing", "north", "n", "utmy")
DEGREES = {"lon", "long", "longitude", "lat", "latitude"}
LENGTHS = {"m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3}
LENGTHS |= {"ft": 0.3048, "feet": 0.3048, "foot": 0.3048, "yd": 0.9144, "mi": 1609.344}


class Measured(NamedTuple):
    """The points of a file, x increasing.

    Attributes:
        x, height: shape (points,), in the units of the file.
        rows: the row of each point in its file, whose first line is row 1, or its index in an array.
        unit: the unit of length that the header names, or "".
        account: one line on everything that was done to the file, or "" if nothing was.
    """

    x: Array
    height: Array
    rows: list[int]
    unit: str
    account: str


class Row(NamedTuple):
    """A line of the file with content, comments excluded: its number, its text and its cells."""

    number: int
    line: str
    cells: list[str]


def read_points(file: Path, columns: Sequence[str | int] | None = None, nodata: ArrayLike = ()) -> Measured:
    """Return the points of a file of measured heights.

    Args:
        file: text with one point per line. Separators, decimal commas, thousands, encodings, comments and headers are
            recognised.
        columns: names, or numbers from 1 on, of x and height, or of x, y and height, if they are not recognised.
        nodata: numbers that stand for a missing height, besides the common ones.

    Raises InputError that names every fault of the file, with rows.
    """
    require_file(file)
    text, encoding = _decoded(file)
    missing = tuple(np.asarray(nodata, dtype=float).ravel().tolist())
    found = _points_of(text, encoding, file, None if columns is None else tuple(columns), missing)
    return found._replace(x=found.x.copy(), height=found.height.copy(), rows=list(found.rows))


@lru_cache(maxsize=4)  # each member of a sweep reads the file of its survey; an edited file has another text
def _points_of(
    text: str, encoding: str, file: Path, columns: tuple[str | int, ...] | None, nodata: tuple[float, ...]
) -> Measured:
    """Return the points of the text of a file. Raise InputError that names every fault, with rows."""
    rows, separator = _split(text)
    headers, body = _headers(rows)
    if not body:
        raise InputError(f"file = {str(file)!r} has no line with two numbers; a survey needs x and height", ABOUT)
    comma = _decimal_comma(body, separator)
    chosen, names = _columns(file, headers, body, columns)
    body, texts = [r for r in body if _has_digits(r)], sum(not _has_digits(r) for r in body)
    values, numbers, gaps, faults = _values(body, chosen, comma)
    below = _below_names(headers, names)
    faults = [row for row in below if not _only_units(row)] + faults
    if faults:
        named = "; ".join(f"row {row.number}: {row.line[:LONGEST_SHOWN]!r}" for row in faults[:MOST_ROWS])
        more = f"; {len(faults) - MOST_ROWS} more" if len(faults) > MOST_ROWS else ""
        raise InputError(
            f"file = {str(file)!r} has {len(faults)} row{'s' * (len(faults) > 1)} without numbers in the columns "
            f"{', '.join(names)}: {named}{more}; correct or delete these rows",
            ABOUT,
        )
    beneath = [[cell for row in below for cell in row.cells[i : i + 1]] for i in chosen]
    units = [" ".join([name, *cells]) for name, cells in zip(names, beneath, strict=True)]
    unit = _unit(file, units)
    notes = [f"separated by {SEPARATORS[separator]}"] if separator != "," else []
    notes += [f"{texts} row{'s' * (texts > 1)} of text left out"] if texts else []
    notes += ["decimal commas"] * comma + [encoding] * bool(encoding)
    notes += [f"columns {' and '.join(names)}"] if len(chosen) > 2 or len(body[0].cells) > 2 else []
    if len(chosen) == 3:
        along = np.hypot(*np.diff(values[:, :2], axis=0).T)
        values = np.column_stack([np.append(0.0, np.cumsum(along)), values[:, 2]])
        notes.append("x is the distance along the line")
    return _in_order(f"file = {str(file)!r}", file.name, values, numbers, gaps, nodata, unit, notes)


def holds_points(file: Path) -> bool:
    """Return True if most lines of a file have two numbers or more, as those of a table of points."""
    try:
        rows, separator = _split(_decoded(file)[0])
    except (InputError, csv.Error):  # no text
        return False
    return 2 * sum(_numbers(row, separator) >= 2 for row in rows) > len(rows)


def from_arrays(x: Any, height: Any, nodata: ArrayLike = (), unit: str = "") -> Measured:
    """Return points given as two lists of numbers; NaN is a missing height. Raises InputError."""
    arrays = as_numbers(x), as_numbers(height)
    for name, given, array in (("x", x, arrays[0]), ("height", height, arrays[1])):
        if array is None or array.ndim != 1:
            raise InputError(f"{name} = {shown(given)} must be a list of numbers", ABOUT)
    a, b = arrays
    assert a is not None and b is not None
    same_length(x=a, height=b)
    if not np.isfinite(a).all():
        i = int(np.argmin(np.isfinite(a)))
        raise InputError(f"x[{i}] = {a[i]:g} must be a finite number", ABOUT)
    gap = ~np.isfinite(b)
    rows = np.flatnonzero(~gap).tolist()
    values = np.column_stack([a, b])[~gap]
    return _in_order("the survey", "the survey", values, rows, int(gap.sum()), nodata, unit, [])


def unit_named(name: str) -> str:
    """Return the short name of a unit of length: m for metres; a name that is not known, as it is."""
    factor = LENGTHS.get(name.strip().lower())
    return name.strip() if factor is None else next(short for short, value in LENGTHS.items() if value == factor)


def _decoded(file: Path) -> tuple[str, str]:
    """Return the text of a file and the name of its encoding, "" if that is UTF-8. Raises InputError."""
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(f"file = {str(file)!r} cannot be read: {error.strerror}", ABOUT) from None
    if data[:2] == b"PK":  # an archive, as spreadsheets are
        raise InputError(f"file = {str(file)!r} is not text; export the table as CSV", ABOUT)
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return data.decode("utf-16", errors="replace"), "UTF-16"
    if data[1:100:2].count(0) > 20 or data[0:100:2].count(0) > 20:
        order = "utf-16-le" if data[1:100:2].count(0) > data[0:100:2].count(0) else "utf-16-be"
        return data.decode(order, errors="replace"), "UTF-16"
    if b"\0" in data[:1000]:
        raise InputError(f"file = {str(file)!r} is not text; export the table as CSV", ABOUT)
    try:
        return data.decode("utf-8-sig"), ""
    except UnicodeDecodeError:
        return data.decode("latin-1"), "Latin-1"


def _split(text: str) -> tuple[list[Row], str]:
    """Return the rows of a text, and the separator by which most of them have two numbers; "" for blanks."""
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    lines = [(n, line) for n, line in lines if not line.lstrip().startswith(COMMENT)]
    if lines and (stated := re.fullmatch(r"\s*sep=(.)\s*", lines[0][1])):  # as spreadsheets write it
        return _rows(lines[1:], stated[1]), stated[1]
    sample = lines if len(lines) <= 2 * SAMPLE else lines[:SAMPLE] + lines[-SAMPLE:]
    best, found = (0, 0.0), ","
    # one that is in nearly all lines is the separator; commas and blanks then belong to numbers and remarks
    strong = [mark for mark in STRONG if sum(mark in line for _, line in sample) > NEARLY_ALL * len(sample)]
    for separator in strong or SEPARATORS:
        rows = _rows(sample, separator)
        counts = Counter((len(row.cells), n) for row in rows if (n := _numbers(row, separator)) >= 2)
        for (width, numeric), rows_alike in counts.items():
            if (rows_alike, numeric / width) > best:  # of separators that fit all rows, one that leaves no other text
                best, found = (rows_alike, numeric / width), separator
    return _rows(lines, found), found


def _rows(lines: list[tuple[int, str]], separator: str) -> list[Row]:
    return [Row(n, line.strip(), _cells(line, separator)) for n, line in lines]


def _cells(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def _is_number(cell: str, separator: str) -> bool:
    """Return True if a cell is a number in some notation. Blanks group digits only if nothing else would need them."""
    if separator in (",", "") and re.search(r"\s", cell):
        return False
    return bool(NUMBER.fullmatch(cell) or STATION.fullmatch(cell))


def _numbers(row: Row, separator: str) -> int:
    return sum(_is_number(cell, separator) for cell in row.cells)


def _headers(rows: list[Row]) -> tuple[list[Row], list[Row]]:
    """Return the rows above the first one with two numbers, and the others."""
    for i, row in enumerate(rows):
        if _numbers(row, ";") >= 2:
            return rows[:i], rows[i:]
    return rows, []


def _decimal_comma(body: list[Row], separator: str) -> bool:
    """Return True if decimals have a comma: it is the last mark of a cell with both, or the only mark of all cells."""
    cells = [cell for row in body for cell in row.cells if NUMBER.fullmatch(cell)]
    for cell in cells:
        if "," in cell and "." in cell:
            return cell.rindex(",") > cell.rindex(".")
    commas = [cell for cell in cells if "," in cell]
    if separator == "," and all(map(THOUSANDS.fullmatch, commas)):  # quoted
        return False
    return bool(commas) and not any("." in cell for cell in cells)


def _value(cell: str, comma: bool) -> float:
    """Return the number in a cell, NaN for a gap. Raises ValueError."""
    if not comma:
        with suppress(ValueError):
            return float(cell)  # as most cells are
    if cell.lower() in EMPTY:
        return np.nan
    if station := STATION.fullmatch(cell):
        metres = float(station[2].replace(",", "."))
        return 1000.0 * float(station[1]) + (-metres if station[1].startswith("-") else metres)
    digits = re.sub(rf"(?<=\d)[{GROUPS}](?=\d)", "", cell).replace("D", "e").replace("d", "e")
    digits = digits.replace(".", "").replace(",", ".") if comma else _without_thousands(digits)
    return float(digits)


def _without_thousands(digits: str) -> str:
    return digits.replace(",", "") if THOUSANDS.fullmatch(digits) else digits


def words_of(name: str) -> list[str]:
    """Return the words of the name of a column in small letters, without its unit and without signs."""
    name = re.sub(r"[(\[].*?[)\]]", "", name.strip().strip("#").lower())
    words = [word for word in re.split(r"[\s_/,.:-]+", name.strip()) if word]
    return [word for word in words if word not in LENGTHS] or words


def plain(name: str) -> str:
    """Return the words of the name of a column as one."""
    return "".join(words_of(name))


def _columns(
    file: Path, headers: list[Row], body: list[Row], columns: Sequence[str | int] | None
) -> tuple[list[int], list[str]]:
    """Return the indices and the names of the columns of x (and y) and of height. Raises InputError."""
    width = Counter(len(row.cells) for row in body).most_common(1)[0][0]
    fitting = [row.cells for row in headers if len(row.cells) == width]
    known = [cells for cells in fitting if {plain(cell) for cell in cells} & {*HEIGHT}]
    header = (known[:1] or fitting[-1:] or [[]])[0]
    names = header or [str(i + 1) for i in range(width)]
    numeric = [i for i in range(width) if _mostly_numbers(body, i)]
    if columns is not None:
        chosen = [_found(file, column, names) for column in columns]
        return chosen, [names[i] for i in chosen]
    if degrees := [names[i] for i in numeric if plain(names[i]) in DEGREES]:
        raise InputError(
            f"file = {str(file)!r} has the column {degrees[0]}, and degrees are no lengths; project the points",
            ABOUT,
        )
    columns_of_numbers = {i: names[i] for i in range(width) if _has_a_number(body, i)}
    x, y, east, z = (_first(columns_of_numbers, wanted) for wanted in (DISTANCE, NORTHING, EASTING, HEIGHT))
    if east is not None and y is not None and z is not None and (x is None or x == east):
        chosen = [east, y, z]
    elif x is not None and z is not None:
        chosen = [x, z]
    elif len(numeric) == 2 or (len(numeric) == 3 and not header):
        chosen = numeric
    else:
        shown = [names[i] for i in (numeric if len(numeric) > 1 else columns_of_numbers)] or names
        raise InputError(
            f"file = {str(file)!r} has the numeric columns {', '.join(map(repr, shown))}; name those of x and height, "
            f"for example --columns {shown[0]},{shown[-1]}",
            ABOUT,
        )
    return chosen, [names[i] for i in chosen]


def _has_digits(row: Row) -> bool:
    return any(mark.isdigit() for mark in row.line) or any(cell.lower() in EMPTY - {""} for cell in row.cells)


def _below_names(headers: list[Row], names: list[str]) -> list[Row]:
    """Return the rows between that of the names and the first with numbers."""
    named = next((i for i, row in enumerate(headers) if set(names) <= set(row.cells)), len(headers))
    return [row for row in headers[named + 1 :] if any(mark.isalnum() for mark in row.line)]


def _only_units(row: Row) -> bool:
    return all(cell.strip("()[] ").lower() in {*LENGTHS, ""} for cell in row.cells)


def _first(names: dict[int, str], wanted: Sequence[str]) -> int | None:
    """Return the column whose name is wanted, or else contains a wanted word, of single letters only z."""
    for word in wanted:
        for i, name in names.items():
            if plain(name) == word:
                return i
    for word in wanted:
        for i, name in names.items():
            if (len(word) > 1 or word == "z") and word in words_of(name):
                return i
    return None


def _has_a_number(body: list[Row], column: int) -> bool:
    return any(_is_number(row.cells[column], ";") for row in body if column < len(row.cells))


def _mostly_numbers(body: list[Row], column: int) -> bool:
    cells = [row.cells[column] for row in body if column < len(row.cells)]
    filled = [cell for cell in cells if cell.lower() not in EMPTY]
    return bool(filled) and sum(_is_number(cell, ";") for cell in filled) > 0.5 * len(filled)


def _found(file: Path, column: str | int, names: list[str]) -> int:
    """Return the index of a column by its name or by its number from 1 on. Raises InputError."""
    if isinstance(column, int) and 1 <= column <= len(names):
        return column - 1
    for same in (lambda a, b: a == b, lambda a, b: plain(a) == plain(b)):
        for i, name in enumerate(names):
            if isinstance(column, str) and same(name, column):
                return i
    listed = ", ".join(map(repr, names))
    message = f"file = {str(file)!r} has no column {column!r}; it has {listed}, which are also numbered from 1 on"
    raise InputError(message, ABOUT)


def _values(body: list[Row], chosen: list[int], comma: bool) -> tuple[Array, list[int], int, list[Row]]:
    """Return the values of the chosen columns, their row numbers, the number of gaps, and the rows with a fault."""
    values, numbers, gaps, faults = [], [], 0, []
    for row in body:
        try:
            found = [_value(row.cells[i], comma) for i in chosen]
        except (ValueError, IndexError):
            faults.append(row)
            continue
        if all(map(math.isfinite, found[:-1])) and not math.isinf(found[-1]):
            if math.isnan(found[-1]):
                gaps += 1
            else:
                values.append(found)
                numbers.append(row.number)
        elif any(map(math.isnan, found)):
            gaps += 1
        else:
            faults.append(row)
    return np.array(values).reshape(-1, len(chosen)), numbers, gaps, faults


def _unit(file: Path, header: list[str]) -> str:
    """Return the unit of length in the header of the chosen columns. Raises InputError if there are two."""
    found = [unit for name in header for unit in _units_in(name)]
    if len({LENGTHS[unit] for unit in found}) > 1:
        raise InputError(
            f"file = {str(file)!r} has the units {' and '.join(dict.fromkeys(found))} in its header; x and height must "
            "be in one unit",
            ABOUT,
        )
    return found[0] if found else ""


def _units_in(name: str) -> Iterator[str]:
    """Yield the unit of length in the name of a column, in brackets or as its last word."""
    words = re.findall(r"[a-z]+", name.lower())
    if len(words) > 1 and words[-1] in LENGTHS:
        yield words[-1]


def _in_order(
    name: str, short: str, values: Array, numbers: list[int], gaps: int, nodata: ArrayLike, unit: str,
    notes: list[str],
) -> Measured:  # fmt: skip
    """Return points with increasing x: sorted, without missing heights, repeated x with their mean height.

    `name` is the description of the survey in messages, `short` that in the account.
    """
    rows = np.array(numbers, dtype=int)
    sound = ~np.isin(values[:, 1], np.asarray(nodata, dtype=float))
    values, rows, gaps = values[sound], rows[sound], gaps + int(np.count_nonzero(~sound))
    if np.all(np.diff(values[:, 0]) <= 0.0) and len(values) > 1 and values[0, 0] > values[-1, 0]:
        values, rows = values[::-1], rows[::-1]
        notes.append("x descends in the file")
    elif np.any(np.diff(values[:, 0]) < 0.0):
        order = np.argsort(values[:, 0], kind="stable")
        values, rows = values[order], rows[order]
        notes.append("rows sorted by x")
    none = without_height(values[:, 0], values[:, 1]) if len(values) else np.zeros(0, dtype=bool)
    values, rows, gaps = values[~none], rows[~none], gaps + int(np.count_nonzero(none))
    if gaps:
        notes.append(f"{gaps} row{'s' * (gaps > 1)} without a height left out")
    x, first, count = np.unique(values[:, 0], return_index=True, return_counts=True)
    if x.size < 2:
        found = f"{x.size} point{'s' * (x.size != 1)}" + (f" with a height, and {gaps} without" if gaps else "")
        raise InputError(f"{name} has {found}; a survey needs at least 2", ABOUT)
    height = np.add.reduceat(values[:, 1], first) / count
    if repeated := int(np.sum(count - 1)):
        notes.append(f"{repeated} repeated x, heights averaged")
    account = f"{short}: {x.size} points; {', '.join(notes)}" if notes else ""
    return Measured(x, height, rows[first].tolist(), unit, account)
