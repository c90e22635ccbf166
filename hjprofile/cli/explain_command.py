"""The command that prints a section of the page on errors."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from hjprofile.cli.common import Json, answer, app, say

Heading = Annotated[str, Parameter(help="Heading of the page on errors, as a message names it; words or hyphens.")]


@app.command
def explain(*heading: Heading, json: Json = False) -> None:
    """Print the section of the page on errors that a message names. Without HEADING, list the headings."""
    from hjprofile.error_page import find_section, sections

    known = sections()
    if not heading:
        say(json, "\n".join(f"{'  ' * max(s.level - 2, 0)}{name}" for name, s in known.items() if s.level > 1))
        answer(json, {"headings": [name for name, s in known.items() if s.level > 1]})
        return
    anchor = find_section(" ".join(heading))
    section = known[anchor]
    more = [f"More: {', '.join(f'`hjprofile explain {name}`' for name in section.within)}"] if section.within else []
    say(json, "\n\n".join(filter(None, [section.heading, section.text, *more])))
    answer(json, {"heading": anchor, "title": section.heading, "text": section.text, "within": section.within})
