"""The text of docs/errors.md and the anchors of its headings."""

import re
from functools import cache
from pathlib import Path

from hjprofile.errors import PAGE

ROOT = Path(__file__).parents[2]


@cache
def page():
    return (ROOT / PAGE).read_text(encoding="utf-8")


def anchors():
    """Of the page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page(), flags=re.M | re.S), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
