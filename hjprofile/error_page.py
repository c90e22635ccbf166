"""The sections of the page on errors, docs/errors.md, which the package contains."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from hjprofile.errors import PAGE, InputError, did_you_mean


class Section(NamedTuple):
    """A section of the page, without its subsections.

    Attributes:
        heading: the text of its heading.
        level: 1 for the title of the page, 2 for a section, 3 for a subsection.
        text: the text below the heading, without comments and with links as plain words.
        within: the anchors of its subsections.
    """

    heading: str
    level: int
    text: str
    within: list[str]


def anchor_of(heading: str) -> str:
    """Return the anchor of a heading, as in "a-survey"."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@cache
def sections() -> dict[str, Section]:
    """Return anchor -> section of the page, in its order."""
    here = Path(__file__).resolve().parent
    installed = here / Path(PAGE).name
    page = (installed if installed.exists() else here.parent / PAGE).read_text(encoding="utf-8")
    found: dict[str, Section] = {}
    lines: dict[str, list[str]] = {}
    parent = anchor = ""
    fenced = False
    for line in page.splitlines():
        fenced ^= line.startswith("```")
        mark, _, heading = line.partition(" ")
        if fenced or not re.fullmatch("#+", mark):
            lines[anchor].append(line)
            continue
        anchor, level = anchor_of(heading), len(mark)
        found[anchor], lines[anchor] = Section(heading, level, "", []), []
        if level > 2:
            found[parent].within.append(anchor)
        else:
            parent = anchor
    return {name: section._replace(text=_plain("\n".join(lines[name]))) for name, section in found.items()}


def explain(heading: str) -> str:
    """Return the text of a section of the page on errors.

    Args:
        heading: the heading as a message of a command names it, in words or with hyphens.

    Returns:
        The text below the heading, without that of its subsections.

    Raises:
        InputError: if there is no such heading.

    >>> import hjprofile as hj
    >>> "Its file" in hj.explain("a folder of another case")
    True
    """
    return sections()[find_section(str(heading))].text


def find_section(words: str) -> str:
    """Return the anchor of the section with this anchor or heading. Raise InputError if there is none."""
    known = sections()
    anchor = anchor_of(words.rpartition("#")[2])
    if anchor not in known:
        hint = did_you_mean(anchor, list(known)) or ";"
        raise InputError(
            f"{words!r} is not a heading of the page on errors{hint} `hjprofile explain` lists them", "the-command-line"
        )
    return anchor


def _plain(text: str) -> str:
    """Return Markdown without comments, and with the words of links only."""
    text = re.sub(r"<!--.*?-->\n?", "", text, flags=re.S)
    text = re.sub(r"\[([^\]]+)\]\(#([\w-]+)\)", r"\1 (`hjprofile explain \2`)", text)
    return re.sub(r"\[([^\]]+)\]\([^)\s]+\)", r"\1", text).strip()
