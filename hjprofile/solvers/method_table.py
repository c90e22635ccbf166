"""The table of methods for a reader."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.method import Feature
from hjprofile.solvers.methods import METHODS


class MethodRow(NamedTuple):
    """A method and its properties.

    Attributes:
        name: in case files, on the command line and in Python.
        form: its unknown: "height", "slope", or "off grid" for fronts, characteristics and levels of u.
        order: of the error on smooth data, in the cells, fronts or levels; NaN if a tolerance replaces them.
        cfl_proved: largest Δt max(K f')/Δx with bounds proved for any data; NaN for none.
        supports: models and data beyond slow erosion of a slope that is neutral at its left end: "inflow",
            "coefficient", "refresh", "layer", "whole line", "linear growth".
        needs_tolerance: True if it requires a tolerance.
    """

    name: str
    form: str
    order: float
    cfl_proved: float
    supports: tuple[str, ...]
    needs_tolerance: bool


class MethodTable(tuple[MethodRow, ...]):
    """The rows of a table, which is printed with aligned columns."""

    def __repr__(self) -> str:
        head = "method", "form", "order", "proved CFL", "supports"
        lines = [head, *((r.name, r.form, _text(r.order), _text(r.cfl_proved), ", ".join(r.supports)) for r in self)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join("  ".join(f"{c:{w}}" for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def methods() -> MethodTable:
    """Return the methods and their properties, a row for each.

    Returns:
        The rows in the order of the documentation. Printed, they are a table.

    >>> import hjprofile as hj
    >>> print(*hj.methods()[:2], sep="\\n")
    MethodRow(name='lax-friedrichs', form='height', order=1.0, ...)
    MethodRow(name='local-lax-friedrichs', form='height', order=1.0, ...)
    >>> [row.name for row in hj.methods() if "layer" in row.supports]
    ['conservative-telescoping']
    """
    return MethodTable(
        MethodRow(
            method.name, _words(method.form.name), method.order, method.cfl_proved,
            tuple(_words(feature.name) for feature in Feature if feature in method.supports), method.needs_tolerance,
        )
        for method in METHODS.values()
    )  # fmt: skip


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _text(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3g}"
