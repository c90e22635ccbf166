"""The words of the project: patterns that a reader decodes twice, and the first lines of docstrings."""

import ast
import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = sorted((ROOT / "hjprofile").rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "docs" / "gallery").glob("*.py"))]
PATTERNS = {  # clauses in the place of a noun, personified software, words that are not used
    "clause for a noun": r"(?:^|[.:;|(] *|\b(?:of|by|with|for|from|to|is|and|than|in|on) )"
    r"(?:[Ww]hat|[Ww]hatever|[Ww]hoever) (?!if\b)",
    "told": r"\b(?:tells?|told|telling)\b",
    "anew": r"\banew\b",
    "beside": r"\bbeside\b",
}
MOST = 80
IMPERATIVES = frozenset(
    """
    accept add adjust advance align allocate allow announce append apply approximate arrange ask assemble assert
    assign attach avoid begin bisect bound bracket bring build cache call carry change check choose classify clear
    clip close collect combine compare compile complete compose compress compute continue convert copy correct
    count cover create cross cut date decide declare decorate define delete describe determine differentiate
    discard discretise display disturb divide draw drop emulate encode end enter estimate evaluate examine exclude
    execute exit expand export extend extrapolate fail feed fill find finish fit fix follow forbid format forward
    freeze gather generate get give go group guard handle hash hold identify ignore import improve include index
    initialise insert integrate interpolate interrupt invert iterate join judge keep label leave limit line link
    list load locate look lower make map march mark match measure merge monitor move multiply name narrow
    normalise note notify number observe offer open order pack pad parse pass patch pause pick place plot prepare
    prescribe print probe process produce project propagate prove provide put raise reach react read reassign
    rebuild recall recognise recompute reconstruct record recover redirect reduce refine refresh refuse register
    reject release remember remove rename render repair repeat replace report represent require resample reset
    resolve restore restrict resume return reverse rise roll round run sample save scale scan search seek select
    send separate set settle shift shorten show simulate skip smooth solve sort split start state stop store
    stream subtract sum supply sweep take terminate test thin trace track transform translate treat trim truncate
    try turn undo update use validate vary verify visit wait walk warn weigh widen wrap write yield
    """.split()  # noqa: SIM905
)


def prose(path: Path) -> str:
    """Return the text that is read: a page without its code, or the docstrings, comments and messages of a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.S)
    return text


def documented(path: Path) -> list[tuple[ast.AST, str]]:
    """Return the functions of a module that have a docstring, with the first word of each."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    texts = ((node, ast.get_docstring(node)) for node in functions)
    properties = {"property", "cached_property"}  # they are documented as the noun that they are
    return [
        (node, text.split()[0].strip("`.,:"))
        for node, text in texts
        if text and not properties & {getattr(d, "id", getattr(d, "attr", "")) for d in node.decorator_list}
    ]


def test_patterns_that_are_read_twice_are_rare():
    """The sum over package and pages stays below a limit; a page lists its own in the message."""
    found = Counter()
    for path in (*PAGES, *MODULES):
        if path.name != "changelog.md":
            for name, pattern in PATTERNS.items():
                found[path.relative_to(ROOT).as_posix(), name] += len(re.findall(pattern, prose(path), flags=re.M))
    assert found.total() <= MOST, found.most_common(40)


def test_functions_are_documented_in_the_imperative():
    """At most one in eight docstrings of functions does not begin with an imperative verb."""
    first = [(f"{path.name}:{node.lineno}", word) for path in MODULES for node, word in documented(path)]
    fragments = [(where, word) for where, word in first if word.lower() not in IMPERATIVES]
    assert len(fragments) <= 0.12 * len(first), (len(fragments), len(first), fragments[:60])
