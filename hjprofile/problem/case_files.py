"""The files of cases on disk, and the TOML in them and on the command line."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hjprofile.errors import InputError, did_you_mean
from hjprofile.problem.paths import located
from hjprofile.problem.ranges import as_path
from hjprofile.problem.survey_file import holds_points

ABOUT_VALUES = "a-value-by-an-option"  # heading of the page on errors
WORD = re.compile(r"(?:[~.]*/)*[A-Za-z_][\w./-]*")  # a text without quotes on the command line


def shipped_cases() -> dict[str, Path]:
    """Return the cases that come with the package.

    Returns:
        Name of the case -> path of its file, in alphabetical order.

    >>> import hjprofile as hj
    >>> "two_kinks" in hj.shipped_cases()
    True
    """
    here = Path(__file__).resolve().parent.parent
    for folder in (here / "cases", here.parent / "cases"):  # of an installed package; of a source checkout
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    return {}


def find_case(case: str | Path) -> Path:
    """Return the file of a case, given by path or by the name of a case of the package. Raise InputError if none."""
    path = located(Path(), as_path("case", case))
    try:
        if path.is_file():
            return path
    except OSError as error:  # a name too long, a folder that may not be entered
        raise InputError(f"{case}: cannot be read: {error.strerror}", "a-file-that-cannot-be-read") from None
    shipped = shipped_cases()
    if str(case) in shipped:
        return shipped[str(case)]
    names = {name: name for name in shipped}
    with suppress(OSError, ValueError):  # a folder that may not be entered, a NUL
        names |= {other.stem: str(other) for other in path.parent.glob("*.toml")}
    hint = did_you_mean(path.stem, names)
    folder = " (it is a folder)" if case and path.is_dir() else ""
    raise InputError(
        f"{case}: there is no such file{folder}, and no case of the package has this name{hint} "
        f"(its cases are: {', '.join(shipped)})",
        "a-case-that-is-not-there",
    )


def read_case(path: Path) -> dict[str, Any]:
    """Return the tables of a case file, unchecked. Raise InputError if the file cannot be read or is not TOML."""
    text = ""
    try:
        text = path.read_text(encoding="utf-8-sig")
        return tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}", "a-file-that-cannot-be-read") from None
    except UnicodeDecodeError as error:
        _refuse_a_survey(path)
        message = f"{path}: cannot be read: it is not text in UTF-8 ({error}); save it as UTF-8"
        raise InputError(message, "a-file-that-cannot-be-read") from None
    except (ValueError, RecursionError) as error:  # bad syntax, integers of thousands of digits, deep nesting
        _refuse_a_survey(path)
        found = re.search(r"\(at line (\d+), column \d+\)$", str(error))
        line = text.split("\n")[int(found[1]) - 1].strip()[:60] if found else ""
        shown = f", which reads {line!r}" if line else ""
        hint = "; write paths with / or in single quotes" if "\\" in line else ""
        raise InputError(f"{path}: not valid TOML: {error}{shown}{hint}", "a-file-that-is-no-toml") from None


def _refuse_a_survey(path: Path) -> None:
    """Raise InputError if a file that is no TOML holds measured points."""
    if holds_points(path):
        raise InputError(
            f"{path} is a survey (a table of points) and not a case file; "
            f"`hjprofile import {shlex.quote(str(path))}` makes a case from it",
            "a-survey-in-the-place-of-a-case",
        )


def read_values(arguments: Sequence[str], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted key -> value, read from texts such as `domain.cells=400`, and the values that are `given`.

    A value is written as in TOML; a plain word or a path is a string. Raise InputError for other texts, and for a key
    with two values.
    """
    values = dict(given)
    for argument in arguments:
        key, equals, text = argument.partition("=")
        key = key.strip()
        if not equals or not key:
            raise InputError(f"--set {argument} must be written --set section.key=value", ABOUT_VALUES)
        if key in values:
            raise InputError(f"{key} is given twice; give one value", ABOUT_VALUES)
        for form in (text, f'"{text.strip()}"' if WORD.fullmatch(text.strip()) else ""):
            with suppress(ValueError, RecursionError):
                content = tomllib.loads(f"value = {form}")
                if len(content) == 1:
                    values[key] = content["value"]
                    break
        else:
            raise InputError(
                f"--set {argument} must have a value as TOML writes it, for example --set 'title=\"My slope\"'",
                ABOUT_VALUES,
            )
    return values


def read_choices(arguments: Sequence[str]) -> dict[str, list[Any]]:
    """Return dotted key -> values, read from texts such as `erosion.m=0.5,1,2`.

    Values are written as in TOML; a plain word is a string. Raise InputError for other texts.
    """
    choices: dict[str, list[Any]] = {}
    for argument in arguments:
        key, equals, text = argument.partition("=")
        if not equals:
            raise InputError(f"{argument!r} must be written section.key=value,value,...", "a-sweep")
        if key in choices:
            raise InputError(f"{key} is given twice; list all its values at once", "a-sweep")
        word = r"(?<=,)\s*(?!(?:true|false|inf|nan)\s*,)([A-Za-z][\w./-]*)\s*(?=,)"
        for array in (text, re.sub(word, r'"\1"', f",{text},")[1:-1]):
            with suppress(ValueError, RecursionError):
                content = tomllib.loads(f"values = [{array}]")
                if len(content) == 1 and content["values"]:
                    choices[key] = content["values"]
                    break
        else:
            message = f"{argument!r} must have values as TOML writes them, or plain words, with commas between"
            raise InputError(message, "a-sweep")
    return choices
