"""docs/errors.md holds every sentence with which the library refuses or stops, and every heading that it points to."""

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

import pytest
from bad_cases import VALID, with_files
from errors_page import ROOT, anchors, page

import hjprofile
from hjprofile.errors import PAGE
from hjprofile.problem.case import parse_case
from hjprofile.solvers.solve import check_case

HOME = Path(hjprofile.__file__).parent
SAYING = {"InputError", "RunError", "PicklingError", "complain", "error", "refuse"}  # what is called with a sentence
ABOUT = {"InputError", "RunError", "error", "complain"}  # ... and with a heading after it
# functions whose strings are parts of such sentences
PARTS = {"did_you_mean", "_what_a_header_is"}
SILENT = {  # without a sentence: exceptions caught inside, or of no concern to a user; and what hands one on
    "missing", "of", "Breakdown", "_StepTooSmall", "Stopped", "Halt", "Lost", "mapped",
    "NotImplementedError", "TypeError", "ValueError", "AttributeError", "OSError", "stopped",
}  # fmt: skip
ANYTHING = "\N{HORIZONTAL ELLIPSIS}"  # in a sentence: what varies


def name_of(call):
    """`refuse` of refuse(...), `error` of section.error(...)."""
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


FUNCTIONS = ast.FunctionDef | ast.Lambda
SCOPES = FUNCTIONS | ast.If | ast.ExceptHandler | ast.For | ast.While


def ancestors(node):
    while node := getattr(node, "parent", None):
        yield node


class Sentences(ast.NodeVisitor):
    """The sentences of a module, with ANYTHING for what varies; and the headings that it names."""

    def __init__(self, tree):
        self.found, self.headings, self.raised, self.assigned = [], set(), set(), {}
        for node in ast.walk(tree):
            for child in ast.iter_child_nodes(node):
                child.parent = node
            if isinstance(node, ast.Assign):
                (target,), values = node.targets[:1], [node.value]
                names = [target]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    names, values = target.elts, node.value.elts
                for name, value in zip(names, values, strict=False):
                    if isinstance(name, ast.Name):
                        self.assigned.setdefault(name.id, []).append(value)
        self.visit(tree)

    def values(self, name):
        """What was last given to a name before it is used: each of the branches, up to what all of them pass."""
        above, found = list(ancestors(name)), []
        for value in sorted(self.assigned.get(name.id, []), key=lambda value: -value.lineno):
            inside = [node for node in ancestors(value) if isinstance(node, SCOPES)]
            if value.lineno < name.lineno and all(node in above for node in inside if isinstance(node, FUNCTIONS)):
                found.append(value)
                if not inside or inside[0] in above:
                    break
        return found

    def variants(self, node, depth=0):
        """Every way in which an expression can be read, as texts; of what is no text just ANYTHING."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return [node.value]
        if isinstance(node, ast.JoinedStr):
            return self.joined(node.values, depth)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return self.joined([node.left, node.right], depth)
        if isinstance(node, ast.FormattedValue):
            return self.variants(node.value, depth) if node.conversion == -1 else [ANYTHING]
        if isinstance(node, ast.IfExp):
            return self.variants(node.body, depth) + self.variants(node.orelse, depth)
        if isinstance(node, ast.BoolOp):
            return [text for value in node.values for text in self.variants(value, depth)]
        if isinstance(node, ast.Name) and depth < 4:
            given = [text for value in self.values(node) for text in self.variants(value, depth + 1)]
            return given or [ANYTHING]
        return [ANYTHING]

    def joined(self, nodes, depth):
        """Each part in each of its ways, once, beside the first of the others."""
        parts = [[way for way in dict.fromkeys(self.variants(node, depth)) if way] or [""] for node in nodes]
        first = [max(ways, key=len) for ways in parts]
        return list(dict.fromkeys(
            "".join([*first[:i], way, *first[i + 1 :]]) for i, ways in enumerate(parts) for way in ways
        ))  # fmt: skip

    def visit_FunctionDef(self, node):
        if node.name in PARTS:
            for inner in ast.walk(node):
                if isinstance(inner, ast.Return) and inner.value is not None:
                    self.found += [(text, True) for text in self.variants(inner.value)]
        self.generic_visit(node)

    def visit_Call(self, node):
        name = name_of(node)
        if name in SAYING and node.args:
            self.found += [(text, False) for text in self.variants(node.args[0])] if name != "refuse" else [
                (text, True) for i in (0, 2) for text in self.variants(node.args[i])
            ]  # fmt: skip
        if name == "Stop":  # templates of str.format, and what to try
            given = node.args[1:3] + [k.value for k in node.keywords if k.arg in ("words", "remedy")]
            texts = [text for value in given for text in self.variants(value)]
            self.found += [(re.sub(r"\{[^}]*\}", ANYTHING, text), True) for text in texts]
        if name in ABOUT:
            given = node.args[1:] + [k.value for k in node.keywords if k.arg == "about"]
            self.headings |= {text for value in given for text in self.variants(value)}
        if name == "get" and isinstance(node.func.value, ast.Name) and node.func.value.id.endswith("ABOUT"):
            self.headings |= set(self.variants(node.args[1]))
        self.generic_visit(node)

    def visit_Assign(self, node):
        names = {target.id for target in node.targets if isinstance(target, ast.Name)}
        if names & {"status", "failed"}:
            self.found += [(text, False) for text in self.variants(node.value)]
        if names & {"ABOUT", "_ABOUT"} and isinstance(node.value, ast.Dict):
            self.headings |= {text for value in node.value.values for text in self.variants(value)}
        self.generic_visit(node)

    def visit_keyword(self, node):
        if node.arg == "status":
            self.found += [(text, False) for text in self.variants(node.value)]
        self.generic_visit(node)

    def visit_Raise(self, node):
        what = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
        if what is not None:
            self.raised.add(what.id if isinstance(what, ast.Name) else what.attr)
        self.generic_visit(node)


@cache
def reading(source):
    return Sentences(ast.parse(source))


def sentences(source):
    """(text, whether it is part of a longer one), for every sentence that says something by itself."""
    said = reading(source).found
    texts = [(" ".join(text.split()), part) for text, part in said]
    texts = [(text.removeprefix("hjprofile: "), part) for text, part in texts]
    silent = ("done", f"{ANYTHING}: [solver] {ANYTHING}")  # the latter's sentence is another's
    return [(text, part) for text, part in dict.fromkeys(texts) if re.search("[a-z]{3}", text) and text not in silent]


@cache
def shown():
    """What stands on the page between backticks."""
    text = re.sub(r"^```.*?^```", "", page(), flags=re.M | re.S)
    return [" ".join(span[1].split()) for span in re.findall(r"(`+)(.+?)\1(?!`)", text, flags=re.S)]


def is_shown(text, part, spans):
    """Whether a sentence stands on the page, to the letter where nothing varies."""
    pattern = ".*".join(re.escape(piece) for piece in re.split(f"{ANYTHING}+", text))
    match = re.compile(f".*{pattern}.*" if part else pattern).fullmatch
    return any(match(span) for span in spans)


MODULES = {path.relative_to(HOME).as_posix(): path.read_text(encoding="utf-8") for path in sorted(HOME.rglob("*.py"))}


@pytest.mark.parametrize("module", MODULES)
def test_every_sentence_is_on_the_page(module):
    missing = [text for text, part in sentences(MODULES[module]) if not is_shown(text, part, shown())]
    assert missing == [], f"{PAGE} lacks these sentences of hjprofile/{module}"


def test_every_heading_is_on_the_page():
    """Those that errors carry, those of its own contents, and those that other pages name."""
    named = set().union(*(reading(source).headings for source in MODULES.values())) - {ANYTHING, ""}
    assert len(named) > 25  # a check that finds none would let nothing fail
    named |= set(re.findall(r"\]\(#([\w-]+)\)", page()))
    for other in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        named |= set(re.findall(r"errors\.md#([\w-]+)", other.read_text(encoding="utf-8")))
    assert sorted(named - anchors()) == []


def test_whatever_is_raised_is_looked_for():
    """A new exception, or a new function that makes one, has to be named above."""
    raised = set().union(*(reading(source).raised for source in MODULES.values()))
    assert raised - SAYING - SILENT == set()
    assert SAYING - {"refuse", "complain"} <= raised | {"error"}


NEW = """
def check(x, whole):
    end = "the window" if whole else "the slope"
    if x > 0:
        hint = f"; set right to {x:g}"
        raise InputError(f"x = {x:g} lies past the end of {end}{hint}")
"""


def test_a_sentence_that_the_page_lacks_is_found():
    found = sentences(NEW)
    assert found == [
        (f"x = {ANYTHING} lies past the end of the window; set right to {ANYTHING}", False),
        (f"x = {ANYTHING} lies past the end of the slope; set right to {ANYTHING}", False),
    ]
    assert not any(is_shown(text, part, shown()) for text, part in found)
    assert is_shown(*found[0], ["x = 3 lies past the end of the window; set right to 3"])
    assert not is_shown(*found[0], ["x = 3 lies past the end of a window; set right to 3"])
    assert not is_shown(*found[1], ["x = 3 lies past the end of the window; set right to 3"])


def examples():
    """The pieces of case files that the page shows; a whole file with faults stands below a comment."""
    return [tomllib.loads(text) for text in re.findall(r"(?<!-->\n)^```toml\n(.*?)^```", page(), flags=re.M | re.S)]


@pytest.mark.parametrize("changes", examples(), ids=lambda changes: ", ".join(changes))
def test_the_examples_work(tmp_path, changes):
    """Each in the place of the same sections of a case, which is found good."""
    with_files(tmp_path)
    case = parse_case(VALID | {"domain": {"left": -6.0, "cells": 40}} | changes, "page", "errors.md", tmp_path)
    check_case(case)
