"""The report and the account of a fit."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import hjprofile
from hjprofile.studies.calibration import FRONTS, Calibration, Parameter


def fit_report(found: Calibration) -> dict[str, Any]:
    """Return the content of `fit.json` as a dictionary."""
    return {
        "title": found.title,
        "parameters": {p.name: _row(p) for p in found.parameters},
        "supplied_volume": _row(found.volume) if found.volume else None,
        "correlation": found.correlation.tolist(),
        "points": found.x.size,
        "left_out": found.left_out,
        "residual_rms": found.rms,
        "sigma": {"value": found.sigma, "from": "given" if found.sigma_given else "residuals"},
        "degrees_of_freedom": found.degrees_of_freedom,
        "chi2_per_degree_of_freedom": None if found.chi2 is None else found.chi2 / found.degrees_of_freedom,
        "account": found.account,
        "warnings": list(found.warnings),
        "method": "fronts",
        "fronts": FRONTS,
        "evaluations": found.evaluations,
        "wall_seconds": found.wall_seconds,
        "hjprofile_version": hjprofile.__version__,
    }


def _row(p: Parameter) -> dict[str, Any]:
    return {"value": p.value, "interval_95": [p.low, p.high], "start": p.start}


def fit_account(found: Calibration) -> str:
    """Return the fitted values, one per line, their correlations, and the residuals."""
    rows = [*found.parameters, *([found.volume] if found.volume else [])]
    width = max(len(p.name) for p in rows)
    beyond = f" ({found.left_out} beyond the slope omitted)" if found.left_out else ""
    lines = [
        found.title,
        f"  fitted to {found.x.size} heights{beyond} in {found.wall_seconds:.2g} s, {found.evaluations} evaluations",
    ]
    if found.account:
        lines.append(f"  {found.account}")
    for p in rows:
        known = f"{p.low:.5g} to {p.high:.5g} (95 %)" if p.low == p.low else "no interval, see the warnings"
        lines.append(f"  {p.name:{width}}  {p.value:<10.6g}  {known}, started at {p.start:g}")
    names = [p.name for p in found.parameters]
    if pairs := list(combinations(range(len(names)), 2)):
        text = "; ".join(f"{names[i]} and {names[j]} {found.correlation[i, j]:.3f}" for i, j in pairs)
        lines.append(f"  correlations  {text}")
    source = "given" if found.sigma_given else "estimated from them"
    fits = f"  residuals {found.rms:.3g} r.m.s., sigma {found.sigma:.3g} {source}"
    if found.chi2 is not None:
        freedom = found.degrees_of_freedom
        fits += f", chi² per degree of freedom {found.chi2 / freedom:.3g} ({freedom} degrees)"
    return "\n".join([*lines, fits, *(f"  WARNING   {warning}" for warning in found.warnings)])
