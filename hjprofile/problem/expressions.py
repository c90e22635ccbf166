"""Arithmetic expressions written as text, checked against a short list before anything is compiled."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, did_you_mean
from hjprofile.problem.ranges import shown

ABOUT = "an-expression"  # heading of the page on errors
_FUNCTIONS = {name: getattr(np, name) for name in ("exp", "log", "log1p", "expm1", "sqrt", "sin", "cos")}
_NODES = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.UAdd, ast.USub,
    ast.Name, ast.Load, ast.Call, ast.Constant,
)  # fmt: skip


class Arithmetic(NamedTuple):
    """A checked expression: `value` takes one array for each variable, `used` holds the variables that occur in it."""

    value: Callable[..., Any]
    used: frozenset[str]


class _FloatConstants(ast.NodeTransformer):
    """A transformer of integers into floats, so that no power of integers can grow without bound."""

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        return ast.copy_location(ast.Constant(float(node.value)), node)  # type: ignore[arg-type]


def _checked(tree: ast.AST, written: str, variables: tuple[str, ...], allowed: str) -> set[str]:
    """Return the names that a syntax tree uses. Raise InputError for any part that is not on the list."""
    called = {id(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)}
    used = set()
    for node in ast.walk(tree):
        fine = isinstance(node, _NODES)
        if isinstance(node, ast.Constant):
            fine = isinstance(node.value, (int, float)) and not isinstance(node.value, bool)
            fine = fine and bool(np.isfinite(float(node.value)))  # type: ignore[arg-type]
        elif isinstance(node, ast.Name):
            fine = node.id in (_FUNCTIONS if id(node) in called else variables)
            used.add(node.id)
        elif isinstance(node, ast.Call):
            fine = isinstance(node.func, ast.Name) and len(node.args) == 1 and not node.keywords
        if not fine:
            part = ast.unparse(node) or type(node).__name__
            hint = did_you_mean(part, variables)
            if isinstance(node, ast.BitXor):
                part, hint = "^", " (a power is written **);"
            raise InputError(f"{written} contains {part!r}{hint or ';'} {allowed}", ABOUT)
    return used


def arithmetic(text: str, *variables: str, name: str = "expression") -> Arithmetic:
    """Return an arithmetic expression in these variables: numbers, + - * / **, exp, log, log1p, expm1, sqrt, sin, cos.

    The syntax tree is checked against that list before anything is compiled. A value that is not a real number is NaN.
    Raise InputError for any other expression; the message begins with the key `name`.
    """
    allowed = f"allowed are numbers, {', '.join(variables)}, + - * / ** and the functions {', '.join(_FUNCTIONS)}"
    if not isinstance(text, str):
        raise InputError(f"{name} = {shown(text)} must be a string", ABOUT)
    if len(text) > 1000:
        raise InputError(f"{name} is {len(text)} characters long; at most 1000 are allowed", ABOUT)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of '1or q' and similar, which the list excludes
            tree = ast.parse(text.strip(), mode="eval")
        used = _checked(tree, f"{name} = {text!r}", variables, allowed)
        tree = ast.fix_missing_locations(_FloatConstants().visit(tree))
        code = compile(tree, "<expression>", "eval")
    except (SyntaxError, RecursionError, MemoryError, OverflowError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        hint = "is not an arithmetic expression (products are written with *)"
        raise InputError(f"{name} = {text!r} {hint}; {allowed}", ABOUT) from None

    def value(*arguments: Any) -> Any:
        arrays = [np.asarray(a, dtype=float) for a in arguments]
        nothing = 0.0 * sum(arrays)  # gives a constant the shape of the variables
        with np.errstate(all="ignore"):
            try:
                result = eval(code, {"__builtins__": {}, **_FUNCTIONS, **dict(zip(variables, arrays, strict=True))})
            except (ArithmeticError, RecursionError):  # of constants alone: 1/0, 9.0**9.0**9.0
                result = np.nan
            return np.nan + nothing if np.iscomplexobj(result) else result + nothing  # complex: (-1)**0.5

    return Arithmetic(value, frozenset(used & set(variables)))
