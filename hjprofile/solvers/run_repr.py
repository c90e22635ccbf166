"""A run in a few lines of text, and as a table for notebooks."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any

LONGEST_TITLE = 60  # characters


def as_text(run: Any) -> str:
    """Return the `repr` of a run."""
    (_, title), (_, method), (_, status), *rest = _rows(run)
    named = f"Run {title!r}" if run.title.strip() else "Run"
    return "\n  ".join((f"{named} by {method}: {status}", *(f"{name}: {value}" for name, value in rest)))


def as_html(run: Any) -> str:
    """Return the table of a run for notebooks."""
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(name)}</th><td style="text-align: left">{escape(value)}</td></tr>'
        for name, value in _rows(run)
    )
    return f"<table>{rows}</table>"


def _rows(run: Any) -> Iterator[tuple[str, str]]:
    """Yield name and value of each row."""
    title = run.title if len(run.title) <= LONGEST_TITLE else run.title[: LONGEST_TITLE - 3] + "..."
    yield "title", " ".join(title.split()) or "(none)"
    yield "method", run.method
    yield "status", f"done ({run.stop})" if run.done and run.stop else run.status
    times = f"{len(run.time)} saved times from {run.time[0]:g} to {run.time[-1]:g}"
    yield "states", f"{times}, {run.cells} cells on [{run.x[0]:g}, {run.x[-1] + 0.0:g}]"
    error = "unknown" if run.error_estimate is None else f"about {run.error_estimate:.2g}"
    yield (
        "results",
        (
            f"eroded volume {run.eroded_volume:.6g}, toe outflow {run.toe_outflow:.6g}, "
            f"{len(run.kinks_at(-1))} kinks at the end; error of u {error}"
        ),
    )
    if run.units is not None:
        yield "units", str(run.units)
    if run.warnings:
        yield "warnings", f"{len(run.warnings)}, in `warnings`"
