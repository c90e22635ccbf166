"""What the pages show is what comes out: every command and every example of README.md and docs/ is run.

A page is worked through from top to bottom, in a folder of its own; its Python blocks share their names. A block of
`text` right below something that printed has to be what was printed. Comments in the page, which no reader sees:

    <!-- file: NAME -->     the next block is written to this file, and not run
    <!-- run: COMMAND -->   run here; a block of text right below is its output
    <!-- not run: WHY -->   the next block is neither run nor compared

In a block of text a line `...` stands for any lines, seconds for any seconds, and what is rounding for any rounding.
"""

import ast
import contextlib
import importlib.util
import io
import re
import shlex
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from cyclopts import MissingArgumentError
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.cli import main
from hjprofile.cli.common import app
from hjprofile.output import store, workers

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("howto/*.md"))]
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]
PART = re.compile(
    r"^<!-- (?P<mark>file|run|not run): (?P<what>.*?) -->$|^```(?P<language>[\w{}-]*)\n(?P<body>.*?)^```$", re.M | re.S
)


def parts(page):
    """Marks, blocks and what stands between them, in their order, as (mark or language or "prose", what or body)."""
    text, end = page.read_text(encoding="utf-8"), 0
    for part in PART.finditer(text):
        if text[end : part.start()].strip():
            yield "prose", text[end : part.start()]
        yield (part["mark"], part["what"]) if part["mark"] else (part["language"], part["body"])
        end = part.end()


def printed_by(what):
    """What a function prints, stdout and stderr in turn, and its exit code."""
    printed, code = io.StringIO(), 0
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            what()
        except SystemExit as end:
            code = end.code
    return printed.getvalue(), code


def commands(text):
    """What the lines of a shell block print. Only hjprofile, python and pytest are known."""
    printed, failed = "", []
    for line in text.replace("\\\n", " ").splitlines():
        shown, code = "", 0
        for stage in line.split(" | "):
            program, *arguments = shlex.split(stage, comments=True) or ["#"]
            if program == "hjprofile":
                shown, code = printed_by(lambda a=arguments: main(a))
            elif program == "pytest":
                shown, code = printed_by(lambda a=arguments: sys.exit(pytest.main(["-p", "no:cacheprovider", *a])))
            elif program == "python":
                start = [sys.executable, *arguments]
                done = subprocess.run(start, input=shown, capture_output=True, text=True, timeout=120)
                shown, code = done.stdout + done.stderr, done.returncode
            elif program != "#":
                pytest.fail(f"{line!r} is not known here; mark its block <!-- not run: WHY -->")
        printed += shown
        failed += [line] if code else []
    return printed, failed


def normal(text):
    """Text in which seconds, and what is nothing but rounding, are the same on every machine."""
    text = re.sub(r"\b\d[\d.]*(e[+-]\d+)? ?s\b", "0 s", text)
    text = re.sub(r"\b\d(\.\d+)?e-1\d\b", "1e-16", text)
    return re.sub(r"[ \t]+$|=(?==)|(?<==)=", "", text, flags=re.M)  # pytest fills its lines with =


def compare(shown, printed, where):
    if "\n...\n" not in f"\n{shown}":
        assert normal(printed) == normal(shown), where
        return
    pattern = ".*".join(map(re.escape, re.split(r"^\.\.\.\n", normal(shown), flags=re.M)))
    assert re.fullmatch(pattern, normal(printed), re.S), f"{where}: {printed}"


def work_through(page):
    """Runs a page in the present folder."""
    names, mark, printed, failed = {"__name__": "docs"}, None, None, []
    for number, (kind, body) in enumerate(parts(page)):
        where, (marked, mark) = f"{page.name}, part {number}: {body[:60]!r}", (mark, None)
        if kind == "text" and printed is not None and not marked:
            compare(body, printed, where)
            printed, failed = None, []
            continue
        assert not failed, f"{page.name}: {failed} failed: {printed}"
        printed = None
        if kind in ("file", "not run"):
            mark = kind, body
        elif marked:
            assert kind != "prose", f"{where}: no block right below {marked}"
            if marked[0] == "file":
                Path(marked[1]).write_text(body, encoding="utf-8")
        elif kind in ("run", "sh"):
            printed, failed = commands(body)
        elif kind == "python":
            printed, _ = printed_by(lambda code=body, at=where: exec(compile(code, at, "exec"), names))
    assert not failed, f"{page.name}: {failed} failed: {printed}"


@pytest.mark.parametrize(
    "page",
    [p for p in PAGES if any(kind in ("run", "sh", "python") for kind, _ in parts(p))],
    ids=lambda page: page.relative_to(ROOT).as_posix(),
)
def test_pages_print_what_they_show(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    # what takes seconds, and changes nothing of what is printed: processes of one's own, and ink
    for begins_processes in ("processes", "drawing_helper"):
        monkeypatch.setattr(workers, begins_processes, lambda wanted: contextlib.nullcontext())
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    monkeypatch.setattr(store, "_picture", lambda run, name: {f"{name}.png": b""})
    work_through(page)


def test_commands_within_sentences_are_commands():
    """`hjprofile run hillslope --cells 400` in the midst of a line names no command or option that is not there."""
    within = re.compile(r"`hjprofile ([a-z][^`\[]+)`")
    said = {
        " ".join(command.split())
        for page in PAGES
        for kind, text in parts(page) if kind == "prose"
        for command in within.findall(text)
    }  # fmt: skip
    assert len(said) > 20
    printed_by(lambda: main(["cases"]))  # a command exists once `main` has imported its module
    for command in said:
        with contextlib.suppress(MissingArgumentError):  # only the command is named, or it and an option
            app.parse_args(shlex.split(command), exit_on_error=False, print_error=False)


@pytest.mark.parametrize(
    "text",
    [
        "```python\nprint(1.25)\n```\n\n```text\n1.26\n```\n",
        "```python\nx = 1\n```\n\n```text\n1\n```\n",
        "```python\nfor i in range(3):\n    print(i)\n```\n\n```text\n1\n...\n```\n",
        "```sh\nhjprofile run nowhere.toml\n```\n",
        "```sh\nrm -r results\n```\n",
        "<!-- file: law.py -->\n\nThe law is this:\n\n```python\n1/0\n```\n",
    ],
    ids=["another number", "nothing printed", "another start", "a failure", "an unknown command", "a lost mark"],
)
def test_a_page_that_shows_what_does_not_come_out_is_found(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text(text, encoding="utf-8")
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        work_through(tmp_path / "page.md")


def test_no_python_hides_in_text():
    """A block of text is what something printed: Python that nobody runs would stand there as if it worked."""
    for page in PAGES:
        for kind, body in parts(page):
            if kind != "text":
                continue
            statements: list[ast.stmt] = []
            with contextlib.suppress(SyntaxError):
                statements = ast.parse(body).body
            code = ast.Import | ast.ImportFrom | ast.Assign | ast.For | ast.FunctionDef
            assert not any(isinstance(node, code) for node in statements), f"{page.name}: {body[:60]!r} is Python"


def test_rows_of_a_table_have_as_many_cells_as_its_head():
    for page in PAGES:
        columns = 0
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
            cells = len(re.findall(r"(?<!\\)\|", line)) if re.match(r" *\|", line) else 0
            assert not (columns and cells and cells != columns), f"{page.name}:{number}: {line[:60]}"
            columns = cells


SOURCES = [*PAGES, *sorted(DOCS.glob("gallery/*.py")), *sorted((ROOT / "hjprofile").rglob("*.py"))]
SOURCES += sorted((ROOT / "tests").rglob("*.py"))


def test_no_keys_of_the_papers_source_are_cited():
    """A reader has the numbers printed in the paper; the keys of its LaTeX source are not printed."""
    keys = [
        "K", "eq1", "eq2", "eq:f", "eq:fixed_k", "eq:q-along-chars", "L1-contraction", "W-along-chars", "fex", "Fchar",
        "continous-dep-on-init-data", "decay_sup_flux", "decay_tv_flux", "dep_on_coefficients", "eq1-Deltat", "qBound",
        "eq:bound-total-flux", "k-Deltat", "k_Deltat", "kruzkov", "the-problem", "def:calD",
    ]  # fmt: skip
    key = re.compile(r"(?<![\w\]`\"')(])\[(" + "|".join(map(re.escape, keys)) + r")\](?!\()")
    for path in SOURCES:
        for line in path.read_text(encoding="utf-8").splitlines():
            assert "type: ignore" in line or not key.search(line), f"{path.name}: {line.strip()}"


def test_sections_that_are_cited_are_there():
    """§N is a section of the pages model, theory and methods, §5a one of the solutions in §5."""
    pages = {name: (DOCS / f"{name}.md").read_text(encoding="utf-8") for name in ("model", "theory", "methods")}
    numbers = [int(n) for text in pages.values() for n in re.findall(r"^## §(\d+) ", text, flags=re.M)]
    assert numbers == list(range(1, len(numbers) + 1))
    there = {str(n) for n in numbers}
    solutions = pages["theory"].split("\n## §5 ")[1].split("\n## ")[0]
    there |= {f"5{letter}" for letter in re.findall(r"^- \*\*([a-z])\. ", solutions, flags=re.M)}
    assert len(there) > 17
    for path in [*SOURCES, *sorted((ROOT / "cases").glob("*.toml"))]:
        for section in re.findall(r"§(\d+[a-z]?)", path.read_text(encoding="utf-8")):
            assert section in there, f"{path.name}: §{section}"


GREEK = {
    "alpha", "beta", "gamma", "delta", "Delta", "varepsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu",
    "xi", "rho", "sigma", "tau", "phi", "psi", "omega", "ell",
}  # fmt: skip


def letters_of(formula):
    """Return the letters of a formula: Latin ones, and Greek ones by name."""
    formula = re.sub(r"\\(?:text|mathrm)\{[^}]*\}", "", formula)
    commands = set(re.findall(r"\\([a-zA-Z]+)", formula))
    return commands & GREEK | set(re.findall(r"[A-Za-z]", re.sub(r"\\[a-zA-Z]+", " ", formula)))


def formulas(text):
    text = re.sub(r"```.*?```", "", text, flags=re.S)
    return re.findall(r"\$\$(.*?)\$\$", text, flags=re.S) + re.findall(
        r"\$([^$]+)\$", re.sub(r"\$\$.*?\$\$", "", text, flags=re.S)
    )


def test_a_letter_has_one_meaning_on_a_page():
    """The table of symbols has one row for each letter and page, and every letter of the formulas has a row."""
    rows = re.findall(
        r"^\| (\$.*?) \| .* \| ([\w, ]+) \|$", (DOCS / "symbols.md").read_text(encoding="utf-8"), flags=re.M
    )
    rows_of = Counter()
    for symbols, pages in rows:
        for page in ("model", "theory", "methods") if pages == "all" else pages.split(", "):
            for symbol in re.findall(r"\$([^$]+)\$", symbols):
                # data and means have a bar, and a row of their own
                rows_of.update(("bar " * ("bar" in symbol) + letter, page) for letter in letters_of(symbol))
    assert len(rows) > 50 and [row for row, count in rows_of.items() if count > 1] == []
    for page in ("model", "theory", "methods"):
        used = set().union(*map(letters_of, formulas((DOCS / f"{page}.md").read_text(encoding="utf-8"))))
        assert {letter for letter in used if not rows_of[letter, page]} <= {"d", "e"}, page


def test_births_are_those_of_the_table():
    """Of the first kink of `breaking_bump`, on the grids of the page on kinks."""
    table = re.findall(
        r"^  \| (\d+) \| (?:t = )?([\d.]+), (?:x = )?(-[\d.]+) \| (?:t = )?([\d.]+), (?:x = )?(-[\d.]+) \|$",
        (DOCS / "kinks.md").read_text(encoding="utf-8"), flags=re.M,
    )  # fmt: skip
    assert len(table) == 5
    case = hj.load_case("breaking_bump")
    for cells, *told in table:
        grid = hj.Grid(case.grid.left, int(cells))
        runs = hj.solve_hj(case.problem, grid), hj.solve_conservative(case.problem, grid)
        births = [next(e for e in run.events if e.event == "birth") for run in runs]
        # half a unit of the last digit that is told, and a batch of steps, which machines may end elsewhere
        for birth, time, x in zip(births, told[::2], told[1::2], strict=True):
            assert birth.time == pytest.approx(float(time), abs=1.5e-3), cells
            assert birth.x == pytest.approx(float(x), abs=1e-2), cells


def test_every_command_is_on_the_page_of_the_python_interface():
    """With its function, which is public, or as one that has none."""
    rows = re.findall(r"^\| (`.*`) \| (.*) \|$", (DOCS / "api.md").read_text(encoding="utf-8"), flags=re.M)
    commands = {name: row for names, row in rows for name in re.findall(r"`(\w+)`", names)}
    assert set(commands) == {name for name in app if not name.startswith("-")}
    for row in commands.values():
        assert row == "none" or set(re.findall(r"`(\w+)`", row)) <= set(hj.__all__)


def anchors(page):
    """Of the headings of a page, as a code host and the site make them."""
    text = PART.sub("", page.read_text(encoding="utf-8"))
    titles = [re.sub(r"[^\w\- ]", "", title.lower()) for title in re.findall(r"^#+ (.*)$", text, flags=re.M)]
    return {title.replace(" ", "-") for title in titles}


def test_links_lead_somewhere():
    for page in PAGES:
        for target, anchor in re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
            if target.startswith("http"):
                continue
            there = page.parent / target if target else page
            assert there.exists(), f"{page.name}: {target}"
            assert not anchor or anchor in anchors(there), f"{page.name}: {target}#{anchor}"


def test_continuous_integration_runs_the_readmes_tests():
    shell = [body for language, body in parts(ROOT / "README.md") if language == "sh"]
    test_command = shell[1].splitlines()[-1].split("python ")[-1]
    assert test_command in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_every_public_name_is_on_the_page_of_the_python_interface():
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    told = re.findall(r"^\.\. auto\w+:: (\w+)$", text, flags=re.M)  # types that are only returned have full names
    assert sorted([*told, "__version__"]) == sorted(hj.__all__)
    assert "hj.__version__" in text


def test_the_steps_of_the_hillslope_are_those_of_its_run():
    told = re.search(
        r"its steps range from ([\d.e-]+) to ([\d.e-]+\d)",
        " ".join((DOCS / "model.md").read_text(encoding="utf-8").split()),
    )
    run = hj.solve_case(hj.load_case("hillslope"))
    # two digits; what is bounded ahead may differ a little between machines
    assert run.step_range == pytest.approx([float(step) for step in told.groups()], rel=0.03)


def test_every_page_is_on_the_site():
    tables = "".join(
        re.findall(r"^```{toctree}\n(.*?)^```$", (DOCS / "index.md").read_text(encoding="utf-8"), re.M | re.S)
    )
    pages = {p.relative_to(DOCS).with_suffix("").as_posix() for p in PAGES if p.is_relative_to(DOCS)} - {"index"}
    assert pages <= set(tables.split())


def test_every_picture_is_drawn_by_a_script_that_figures_runs():
    spec = importlib.util.spec_from_file_location("figures", ROOT / "tests" / "benchmarks" / "figures.py")
    figures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(figures)
    drawn = {name for _, names in figures.MAKES.values() for name in names} | set(figures.ELSEWHERE)
    assert {path.name for path in (DOCS / "figures").iterdir()} <= drawn
    for script in figures.MAKES:
        assert (ROOT / "tests" / "benchmarks" / script).exists(), script


@pytest.mark.parametrize("page, section", [("symbols.md", ""), ("development.md", "From the command to the kernel")])
def test_what_the_code_is_said_to_name_it_names(page, section):
    text = (DOCS / page).read_text(encoding="utf-8")
    if section:
        text = text.split(f"\n## {section}\n")[1].split("\n## ")[0]
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "hjprofile").rglob("*.py"))
    named = re.findall(r"`([^`\n]+)`", text)
    named += re.findall(r"^  +([\w.]+)  ", text, flags=re.M)
    for name in named:
        if name.endswith(".py"):
            assert [*ROOT.glob(f"hjprofile/**/{name}"), *ROOT.glob(name)], name
        elif not name.endswith((".md", ".html")):
            assert re.search(rf"\b{re.escape(name.split('.')[-1])}\b", code), name
