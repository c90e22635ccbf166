"""Random faults in the solvers and the studies, and the first test that fails for each of them.

    python tests/benchmarks/mutants.py --count 200 --seed 1 --out mutants.md
    python tests/benchmarks/mutants.py --only hjprofile/studies --count 20 --hours 1
    python tests/benchmarks/mutants.py --near                     with the tests of one folder only: candidates
    python tests/benchmarks/mutants.py --jobs 2 --unchecked       two at a time; the tests are known to pass
    python tests/benchmarks/mutants.py --list --count 20          print the mutants, run nothing

A mutant is a copy of the package in which one expression or statement is changed: an operator, a comparison, `and` for
`or`, `min` for `max`, a constant, a condition that is negated, a statement that is left out. Docstrings, messages, type
annotations, imports and decorators stay. Each mutant is tested in a temporary copy of the repository: first by the
tests of the folder that mirrors its module, then by the rest of the default suite, each up to the first failure.
A mutant is killed if a test fails or if the tests exceed their time limit. A survivor is either a missing test, or the
mutant is equivalent: it computes the same. Equivalent mutants are listed with a reason in `equivalent_mutants.md`, by
the text of their lines, and are not drawn.

Run the tests once before, so that compiled loops are in the caches beside their sources. They are copied. If a loop is
changed, only the loops that contain it are compiled again.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from itertools import islice
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.md")
SCOPE = ("hjprofile/solvers", "hjprofile/studies")
COPIED = ("hjprofile", "tests", "docs", "cases", ".ci", "README.md", "pyproject.toml", ".gitignore")
FIRST_LIMIT, REST_LIMIT = 400.0, 1500.0  # seconds; some five times what the tests take without a mutant

ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "/", "**": "*", "%": "*"}
COMPARISON = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
SELECTION = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax"}
SELECTION |= {"argmax": "argmin", "any": "all", "all": "any"}


class Mutant(NamedTuple):
    """One change of a file: the text from `start` to `end` becomes `text`."""

    path: str
    line: int
    start: int
    end: int
    text: str

    def lines(self, source: str) -> tuple[str, str]:
        """The lines that are changed, before and after, each on one line without indentation."""
        first, last = source.rfind("\n", 0, self.start) + 1, source.find("\n", self.end)
        before = source[first:last]
        after = source[first : self.start] + self.text + source[self.end : last]
        return " ".join(before.split()), " ".join(after.split())


class Sites(ast.NodeVisitor):
    """Every mutant of a source."""

    def __init__(self, path: str, source: str):
        self.path, self.source, self.found = path, source, list[Mutant]()
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.rows = source.splitlines()
        self.visit(ast.parse(source))

    def at(self, line: int, column: int) -> int:
        """The index in the text of a column, which ast counts in bytes."""
        return self.starts[line - 1] + len(self.rows[line - 1].encode()[:column].decode())

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return self.at(node.lineno, node.col_offset), self.at(node.end_lineno, node.end_col_offset)

    def add(self, start: int, end: int, text: str) -> None:
        line = self.source.count("\n", 0, start) + 1
        self.found.append(Mutant(self.path, line, start, end, text))

    def between(self, left: ast.expr, right: ast.expr, swaps: dict[str, str]) -> None:
        """The operator between two expressions, which may stand in brackets."""
        start, end = self.span(left)[1], self.span(right)[0]
        operator = re.search(r"[^\s()\\#]+", self.source[start:end])
        if operator and operator[0] in swaps:
            self.add(start + operator.start(), start + operator.end(), swaps[operator[0]])

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if not isinstance(node.left, ast.Constant) or not isinstance(node.left.value, str):
            self.between(node.left, node.right, ARITHMETIC)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
            self.between(left, right, COMPARISON)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self.between(left, right, {"and": "or", "or": "and"})
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self.between(node.target, node.value, {f"{a}=": f"{b}=" for a, b in ARITHMETIC.items()})
        self.leave_out(node)
        self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        if node.id in SELECTION and isinstance(node.ctx, ast.Load):
            self.add(*self.span(node), SELECTION[node.id])

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if node.attr in SELECTION and isinstance(node.ctx, ast.Load):
            end = self.span(node)[1]
            self.add(end - len(node.attr), end, SELECTION[node.attr])
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            return
        start, end = self.span(node)
        text = self.source[start:end]
        self.add(start, end, f"({text} + 1)")
        if node.value:
            self.add(start, end, f"(2 * {text})")
            self.add(start, end, f"(-{text})")

    def negate(self, test: ast.expr) -> None:
        start, end = self.span(test)
        self.add(start, end, f"not ({self.source[start:end]})")

    def visit_If(self, node: ast.If) -> None:
        if ast.unparse(node.test) != "TYPE_CHECKING":
            self.negate(node.test)
            self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        if not isinstance(node.test, ast.Constant):
            self.negate(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.negate(node.test)
        self.generic_visit(node)

    def leave_out(self, node: ast.stmt) -> None:
        self.add(*self.span(node), "pass")

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self.leave_out(node)
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> None:
        if node.col_offset:  # not of the module
            self.leave_out(node)
        self.generic_visit(node)

    def visit_Continue(self, node: ast.Continue) -> None:
        self.leave_out(node)

    def visit_Break(self, node: ast.Break) -> None:
        self.leave_out(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        self.leave_out(node)  # but the message stays

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for default in [*node.args.defaults, *node.args.kw_defaults]:
            if default is not None:
                self.visit(default)
        for statement in node.body:
            self.visit(statement)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for statement in node.body:
            self.visit(statement)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """A message."""

    def visit_Import(self, node: ast.Import) -> None: ...

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None: ...


def equivalent() -> set[tuple[str, str, str]]:
    """Place, line before and line after of the mutants that are known to compute the same.

    A place is a module, or a function of it, as `path::name`, where others have the same line.
    """
    rows = re.findall(r"^\| `(.*?)` \| `(.*?)` \| `(.*?)` \|", EQUIVALENT.read_text(encoding="utf-8"), flags=re.M)
    return {(path, before.replace("\\|", "|"), after.replace("\\|", "|")) for path, before, after in rows}


def drawn(only: list[str], seed: int) -> Iterator[Mutant]:
    """The mutants in random order: first a place, each as likely, then one of the changes there."""
    sites: dict[tuple[str, int, int], list[Mutant]] = {}
    for scope in only:
        top = ROOT / scope
        for path in [top] if top.is_file() else sorted(top.rglob("*.py")):
            for mutant in Sites(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")).found:
                sites.setdefault(mutant[0:1] + mutant[2:4], []).append(mutant)
    rng = random.Random(seed)
    order = sorted(sites)
    rng.shuffle(order)
    known = equivalent()
    for site in order:
        mutant = rng.choice(sites[site])
        before, after = mutant.lines((ROOT / mutant.path).read_text(encoding="utf-8"))
        try:
            ast.parse(changed(mutant))
        except SyntaxError:
            continue
        places = {place for place, *lines in known if lines == [before, after]}
        if not places & set(places_of(mutant) if places else ()):
            yield mutant


def places_of(mutant: Mutant) -> list[str]:
    """The module of a mutant, and the functions that it is in."""
    tree = ast.parse((ROOT / mutant.path).read_text(encoding="utf-8"))
    around = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.lineno <= mutant.line]
    return [mutant.path, *(f"{mutant.path}::{n.name}" for n in around if mutant.line <= (n.end_lineno or 0))]


def changed(mutant: Mutant) -> str:
    source = (ROOT / mutant.path).read_text(encoding="utf-8")
    return source[: mutant.start] + mutant.text + source[mutant.end :]


def tests_of(path: str) -> tuple[list[str], list[str]]:
    """The tests in the folder that mirrors a module, and all others; first those that name the module most often."""
    parts = Path(path).parts[1:]
    inner = parts[0] == "solvers" and (ROOT / "tests" / parts[1]).is_dir()
    folder = ROOT / "tests" / (parts[1] if inner else parts[0])
    name = re.compile(rf"\b{Path(path).stem}\b")
    named = {test: len(name.findall(test.read_text(encoding="utf-8"))) for test in ROOT.glob("tests/**/test_*.py")}
    order = sorted(named, key=lambda test: (-named[test], test))
    first = [test.relative_to(ROOT).as_posix() for test in order if test.parent == folder]
    return first, [test.relative_to(ROOT).as_posix() for test in order if test.parent != folder]


def copy_to(folder: Path) -> None:
    """The repository and the compiled loops; the latter are linked, for they are replaced and never changed."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc", "*.kernel"))
        else:
            shutil.copy2(ROOT / name, folder / name)
    for path in (ROOT / "hjprofile").rglob("*.kernel"):
        (folder / path.relative_to(ROOT)).parent.mkdir(exist_ok=True)
        try:
            os.link(path, folder / path.relative_to(ROOT))
        except OSError:  # another disk
            shutil.copy2(path, folder / path.relative_to(ROOT))


def digest_of_sources(folder: Path) -> bytes:
    """With which compiled loops are marked in a copy."""
    ask = "from hjprofile.solvers.kernels.disk_cache import SOURCES; print(SOURCES.hex())"
    done = subprocess.run([sys.executable, "-c", ask], env=environment(folder), cwd=folder, capture_output=True)
    return bytes.fromhex(done.stdout.decode() or "")


def environment(folder: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    return kept | {"PYTHONPATH": str(folder), "TMPDIR": str(folder / "tmp")}


def reaching(line: int, path: str) -> set[str]:
    """The loops that contain what a line of a kernel defines, as `module.name`: definitions that name one another."""
    names: dict[str, set[str]] = {}
    found = set[str]()
    for kernel in ROOT.glob("hjprofile/**/kernels/*.py"):
        body = ast.parse(kernel.read_text(encoding="utf-8")).body
        origin = {
            alias.name: f"{(node.module or '').rpartition('.')[2]}.{alias.name}"
            for node in body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for node in body:
            inside = [n for n in ast.walk(node) if isinstance(n, ast.Name)]
            named = isinstance(node, ast.FunctionDef | ast.ClassDef)
            defined = [node.name] if named else [n.id for n in inside if isinstance(n.ctx, ast.Store)]
            for name in (f"{kernel.stem}.{name}" for name in defined):
                names.setdefault(name, set()).update(origin.get(n.id, f"{kernel.stem}.{n.id}") for n in inside)
                if kernel == ROOT / path and node.lineno <= line <= (node.end_lineno or 0):
                    found.add(name)
    while more := {name for name, inside in names.items() if inside & found} - found:
        found |= more
    return found


def keep_what_is_as_it_was(folder: Path, mutant: Mutant, before: bytes) -> None:
    """Mark compiled loops that do not contain what is changed as compiled from the present sources.

    The package compiles all of them again after any edit, which is safe and takes minutes.
    """
    now = digest_of_sources(folder)
    affected = reaching(mutant.line, mutant.path)
    for compiled in folder.glob("hjprofile/**/*.kernel"):
        data = compiled.read_bytes()
        valid = data[:32] == hashlib.sha256(before + data[32:]).digest()
        if valid and ".".join(compiled.name.split(".")[:2]) not in affected:
            compiled.unlink()  # it may be a link
            compiled.write_bytes(hashlib.sha256(now + data[32:]).digest() + data[32:])


def failed_test(folder: Path, arguments: list[str], limit: float) -> str:
    """The first test that fails; "" if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments]
    with open(folder / "output.txt", "w") as stream:
        process = subprocess.Popen(
            command, cwd=folder, env=environment(folder), stdout=stream, stderr=stream, start_new_session=True
        )
        try:
            code = process.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return f"more than {limit:.0f} s"
    if code == 0:
        return ""
    output = (folder / "output.txt").read_text(errors="replace")
    found = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", output, flags=re.M)
    return found[1] if found else f"exit code {code}"


def verdict(mutant: Mutant | None, near: bool = False) -> str:
    """The test that kills a mutant, "" if it survives; without one, of the package as it is."""
    with tempfile.TemporaryDirectory(prefix="mutant-") as temporary:
        folder = Path(temporary)
        (folder / "tmp").mkdir()
        copy_to(folder)
        if mutant is None:
            return failed_test(folder, ["tests"], REST_LIMIT)
        before = digest_of_sources(folder) if "/kernels/" in mutant.path else b""
        (folder / mutant.path).write_text(changed(mutant), encoding="utf-8")
        if before and Path(mutant.path).stem not in ("__init__", "disk_cache"):
            keep_what_is_as_it_was(folder, mutant, before)
        first, rest = tests_of(mutant.path)
        killer = failed_test(folder, first, FIRST_LIMIT)
        return killer if killer or near else failed_test(folder, rest, REST_LIMIT)


def main() -> None:
    parser = argparse.ArgumentParser(description="Mutants, and the tests that kill them.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=list(SCOPE), metavar="PATH")
    parser.add_argument("--hours", type=float, default=float("inf"))
    parser.add_argument("--out", type=Path, default=Path("mutants.md"))
    parser.add_argument("--jobs", type=int, default=1, help="mutants that are tested at the same time")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--near", action="store_true", help="run the tests of the mirroring folder only")
    parser.add_argument("--unchecked", action="store_true", help="do not run the tests without a mutant first")
    options = parser.parse_args()

    # a signal that is ignored here, as under nohup, would be ignored by the processes of the tests too
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, lambda number, frame: None)
    if not (options.list or options.unchecked) and (failed := verdict(None)):
        sys.exit(f"without a mutant: {failed}")
    mutants = list(islice(drawn(options.only, options.seed), options.count))
    if options.list:
        for mutant in mutants:
            before, after = mutant.lines((ROOT / mutant.path).read_text(encoding="utf-8"))
            print(f"{mutant.path}:{mutant.line}\n    {before}\n    {after}")
        return
    until, count = time.monotonic() + 3600.0 * options.hours, Counter[str]()
    rows = ["| mutant | before | after | killed by | s |", "|---|---|---|---|---|"]

    def tested(mutant: Mutant) -> tuple[Mutant, str, float] | None:
        if (started := time.monotonic()) > until:
            return None
        return mutant, verdict(mutant, options.near), time.monotonic() - started

    with ThreadPoolExecutor(options.jobs) as pool:
        for done in as_completed([pool.submit(tested, mutant) for mutant in mutants]):
            if found := done.result():
                mutant, killer, seconds = found
                count["killed" if killer else "survived"] += 1
                before, after = mutant.lines((ROOT / mutant.path).read_text(encoding="utf-8"))
                cells = [f"`{cell}`".replace("|", "\\|") for cell in (f"{mutant.path}:{mutant.line}", before, after)]
                cells += [f"`{killer}`".replace("|", "\\|") if killer else "**survived**", f"{seconds:.0f}"]
                rows.append(f"| {' | '.join(cells)} |")
                share = count["killed"] / count.total()
                end = f"\nSeed {options.seed}: {count['killed']} of {count.total()} mutants are killed ({share:.0%}).\n"
                options.out.write_text("\n".join(rows) + "\n" + end, encoding="utf-8")
                print(f"{mutant.path}:{mutant.line}: {killer or 'SURVIVED'} ({seconds:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
