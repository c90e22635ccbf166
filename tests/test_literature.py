"""The pages on literature: citations, DOIs, the numbered statements of the source paper, and names of the package."""

import contextlib
import re
import shlex
from pathlib import Path

import pytest
from cyclopts import MissingArgumentError

import hjprofile as hj
from hjprofile.cli import main
from hjprofile.cli.common import app
from hjprofile.solvers.grids.bounds_monitor import MONOTONE
from hjprofile.studies.characteristic_statements import WORDS
from hjprofile.studies.statement_table import STATEMENTS

ROOT = Path(__file__).parents[1]
STATEMENT_NAMES = {*(statement.name for statement in STATEMENTS), *WORDS}
DOCS = ROOT / "docs"
REFERENCES = (DOCS / "references.md").read_text(encoding="utf-8")
PAPER = (DOCS / "paper.md").read_text(encoding="utf-8")
OTHERS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("howto/*.md"))
    if path.name != "references.md"
}
ENTRY = re.compile(
    r"^\((?P<label>[\w-]+)\)=\n### (?P<name>.+)\n\n(?P<record>.+\n(?:.+\n)*)\n(?P<use>.+\n(?:.+\n)*)", re.M
)
ENTRIES = list(ENTRY.finditer(REFERENCES))
NUMBERED = {  # equations in each section of the paper, and its other statements
    "1": 11, "2": 27, "3": 25, "A": 6, "Theorem": 4, "Proposition": 2, "Definition": 1
}  # fmt: skip


def anchor(heading: str) -> str:
    """Return the anchor that a code host and the site give a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def names(text: str) -> set[str]:
    """Return the anchors of the entries that a page cites: by a link, by the role ref, or by name in a link."""
    labels = {entry["label"]: anchor(entry["name"]) for entry in ENTRIES}
    by_name = {entry["name"]: anchor(entry["name"]) for entry in ENTRIES}
    cited = set(re.findall(r"\]\([./]*references\.md#([^)]+)\)", text))
    cited |= {labels[label] for label in references_by_role(text) if label in labels}
    plain = {" ".join(name.split()) for name in re.findall(r"\[([^\]]+)\]\([./]*references\.md\)", text)}
    return cited | {by_name[name] for name in plain if name in by_name}


def references_by_role(text: str) -> set[str]:
    """Return the labels that the role ref names."""
    return set(re.findall(r"\{ref\}`(?:[^`<]*<)?([\w-]+)>?`", text))


def rows() -> list[list[str]]:
    """Return the cells of the tables of numbered statements, without their headers."""
    tables = PAPER.split("\n## Statements and methods from other sources\n")[0]
    lines = [line for line in tables.splitlines() if line.startswith("| ") and not line.startswith("| number")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def test_every_entry_has_a_record_and_a_use():
    """The form of an entry is: label, heading with the year, record with the same year, one sentence on its use."""
    assert len(ENTRIES) == REFERENCES.count("\n### ") == len({entry["label"] for entry in ENTRIES}) > 40
    for entry in ENTRIES:
        year = re.search(r"\((\d{4})[a-z]?\)$", entry["name"])[1]
        assert f"({year})" in entry["record"] and year in entry["label"], entry["name"]
        assert entry["use"].rstrip().endswith(".") and entry["use"].count(". ") == 0, entry["name"]


def test_dois_are_well_formed():
    """A DOI is linked to its resolver, with brackets escaped, and stands in one entry."""
    dois = re.findall(r"doi:\[([^\]]+)\]\((https://doi\.org/[^)]+)\)", REFERENCES)
    assert len(dois) == REFERENCES.count("doi:") == len({doi for doi, _ in dois}) > 25
    for doi, link in dois:
        assert re.fullmatch(r"10\.\d{4,5}/[\w.()/:-]+", doi), doi
        assert link == "https://doi.org/" + doi.replace("(", "%28").replace(")", "%29"), doi


def test_citations_lead_to_entries():
    """A citation names an entry, by its anchor, or by its label in the role ref."""
    there = {anchor(entry["name"]) for entry in ENTRIES}
    labels = {entry["label"] for entry in ENTRIES}
    for page, text in OTHERS.items():
        assert names(text) <= there, (page, names(text) - there)
        for label in references_by_role(text):
            dated = re.search(r"-\d{4}[a-z]?$", label)
            assert not dated or label in labels, (page, label)


def test_every_entry_is_cited():
    """An entry that no page cites is an error once the pages on methods exist."""
    cited = set().union(*map(names, OTHERS.values()))
    uncited = [entry["name"] for entry in ENTRIES if anchor(entry["name"]) not in cited]
    if uncited and not (DOCS / "methods.md").exists():
        pytest.skip(f"cited by pages to come: {uncited}")
    assert uncited == []


def test_every_numbered_statement_has_one_row():
    """The numbers are consecutive in each section, and the tables hold each once."""
    found = [row[0] for row in rows() if not row[0].startswith("unnumbered")]
    there = [
        f"{section} {n}" if len(section) > 1 else f"({section}.{n})"
        for section, most in NUMBERED.items()
        for n in range(1, most + 1)
    ]
    assert sorted(found) == sorted(there)
    for section in "123A":
        numbers = [int(number[3:-1]) for number in found if number.startswith(f"({section}.")]
        assert numbers == sorted(numbers), section


def test_numbers_outside_the_tables_are_numbers_of_the_paper():
    """A number in a sentence, as in the errata, has a row."""
    there = {row[0] for row in rows()}
    for number in re.findall(r"\((?:[1-3]|A)\.\d+\)|(?:Theorem|Proposition|Definition) \d", PAPER):
        assert number in there, number


def test_commands_and_options_exist():
    """Each command on the pages parses: its name and its options are known."""
    commands = {
        " ".join(command.split())
        for page in ("paper", "process", "references")
        for command in re.findall(r"`hjprofile ([a-z][^`]+)`", (DOCS / f"{page}.md").read_text(encoding="utf-8"))
    }
    assert len(commands) > 10
    with pytest.raises(SystemExit):  # a command exists once `main` has imported its module
        main(["cases"])
    shipped = {*hj.shipped_cases(), "CASE"}
    for command in commands:
        name, *arguments = shlex.split(command)
        with contextlib.suppress(MissingArgumentError):
            app.parse_args([name, *arguments], exit_on_error=False, print_error=False)
        assert not arguments or arguments[0] in shipped, command


def test_every_evaluated_statement_is_in_its_row():
    """A statement with a number is named in the row of that number, and each row names statements that exist."""
    evaluated = {row[0]: row[2] + row[3] for row in rows() if "hjprofile statements CASE" in row[2]}
    named = set(re.findall(r"statements CASE`, `(\w+)`", " ".join(evaluated.values())))
    assert named <= STATEMENT_NAMES
    of_name = {s.name: s.equation for s in STATEMENTS} | {name: equation for name, (equation, _) in WORDS.items()}
    for name, equation in of_name.items():
        for number in re.findall(r"^\([\dA]\.\d+\)|(?<=, )\([\dA]\.\d+\)", equation):
            assert f"`{name}`" in evaluated[number], (name, number)
    assert {f"`{name}`" for name in STATEMENT_NAMES} <= set(re.findall(r"`\w+`", PAPER))


def test_names_of_the_guide_exist():
    """Monitors, functions, scripts and sections of a case that the guide names are those of the package."""
    package = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "hjprofile").rglob("*.py"))
    monitors = set(re.findall(r"`(\w+_\w+|signs|kruzkov)`", " ".join(row[2] for row in rows())))
    monitors -= {"rankine_hugoniot_speed", *STATEMENT_NAMES}
    assert monitors == set(MONOTONE), monitors ^ set(MONOTONE)
    for function in re.findall(r"`hj\.(\w+)`", PAPER + REFERENCES):
        assert function in hj.__all__, function
    for script in re.findall(r"python (tests/[\w/]+\.py)", PAPER):
        assert (ROOT / script).exists(), script
    for key in re.findall(r"`\[\w+\] (\w+)", PAPER + REFERENCES):
        assert f'"{key}"' in package, key
