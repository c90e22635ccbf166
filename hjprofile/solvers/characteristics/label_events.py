"""Events of characteristics: their signs, and the panels after them (§14).

An event is a name and an index with a value that becomes negative: ("birth", panel), ("merge", segment between two
shocks), ("exit", shock), ("left" or "right", shock) if a label reaches a joint across which fields are not analytic,
and ("crest", 0) if the label at x = 0 does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hjprofile.solvers.characteristics.kernels import labels as kernels
from hjprofile.solvers.characteristics.kernels.announced_events import Fine, Signs, find_signs
from hjprofile.solvers.characteristics.panels import POINTS, RULE, Panels, interpolation

Event = tuple[str, int]

_S = np.cos(np.pi * np.arange(4 * POINTS, -1, -1) / (4 * POINTS))
FINE = Fine(_S, interpolation(_S) @ RULE.D, RULE.D @ RULE.D, RULE.D @ RULE.D @ RULE.D)
SLIVER = 0.1  # fraction of a panel below which a cut part joins the neighbour, if fields are analytic across the joint


def signs(panels: Panels) -> Signs:
    """Return the signs of events."""
    size, shocks = len(panels.r), panels.shocks
    found = Signs(*(np.empty(n) for n in (size, size, size, size, shocks, shocks, shocks, 2)))
    find_signs(panels.X, panels.mesh, panels.off, panels.off_crest, RULE, FINE, found)
    return found


def crossed(found: Signs, threshold: float) -> list[Event]:
    """Return the events that have occurred; births where X decreases with the label by `threshold`."""
    events = [("birth", int(p)) for p in np.flatnonzero(found.fold < -threshold)]
    for kind in ("merge", "left", "right"):
        events += [(kind, int(k)) for k in np.flatnonzero(getattr(found, kind) < 0.0)]
    events += [("exit", found.merge.size - 1)] if found.ends[0] < 0.0 else []
    return events + ([("crest", 0)] if found.ends[1] < 0.0 else [])


def value(found: Signs, event: Event) -> float:
    """Return the sign of one event."""
    kind, i = event
    if kind == "birth":
        return float(found.fold[i])
    if kind in ("exit", "crest"):
        return float(found.ends[int(kind == "crest")])
    return float(getattr(found, kind)[i])


def place(panels: Panels, k: int) -> float:
    """Return the position of shock k."""
    p, s = kernels.after_start(panels.off[k, 1], k + 1, panels.mesh)
    return float(panels.mesh.base[p] + (interpolation(np.array([s])) @ panels.X[p])[0])


def merged(panels: Panels, k: int) -> Panels:
    """Return panels without segment k: the shocks on its sides are one."""
    keep = np.ones(len(panels.r), dtype=bool)
    keep[panels.mesh.first[k] : panels.mesh.first[k + 1]] = False
    rest = panels.selected(keep)
    off, power, number = np.delete(panels.off, k, axis=0), np.delete(panels.power, k, axis=0), panels.number.copy()
    off[k - 1] = panels.off[k - 1, 0], panels.off[k, 1]
    power[k - 1] = 0.0
    number[k - 1 : k + 1] = [min(number[k - 1], number[k])]
    return replace(
        rest, mesh=rest.mesh._replace(first=np.delete(rest.mesh.first, k)), off=off, power=power, number=number,
        birth=np.delete(panels.birth, k), tau=np.delete(panels.tau, k),
    )  # fmt: skip


def exited(panels: Panels) -> Panels:
    """Return panels without the last shock and without the panels right of it."""
    rest = panels.selected(np.arange(len(panels.r)) < panels.mesh.first[-2])
    return replace(
        rest, mesh=rest.mesh._replace(first=rest.mesh.first[:-1]), off=panels.off[:-1], power=panels.power[:-1],
        number=panels.number[:-1], birth=panels.birth[:-1], tau=panels.tau[:-1], off_crest=panels.off[-1:, 0].copy(),
    )  # fmt: skip


def passed(panels: Panels, kind: str, i: int) -> Panels:
    """Return panels without those up to the joint that the label of shock i, or the one at x = 0, has reached.

    The first segment, or all, may be empty after it: left of the last label q = 0.
    """
    mesh, off, off_crest, power = panels.mesh, panels.off.copy(), panels.off_crest.copy(), panels.power.copy()
    keep = np.ones(len(panels.r), dtype=bool)
    if kind == "right":
        p = kernels.after_start(off[i, 1], i + 1, mesh)[0]
        keep[mesh.first[i + 1] : p + 1] = False
        off[i, 1] = 0.0
    else:
        k, reach = (i, off[i, 0]) if kind == "left" else (panels.shocks, off_crest[0])
        p = kernels.before_end(reach, k, mesh)[0]
        keep[p : mesh.first[k + 1]] = False
        if kind == "left":
            off[i, 0] = 0.0
        else:
            off_crest[0] = 0.0
    if kind != "crest":
        power[i] = 0.0
    return replace(panels.selected(keep), off=off, power=power, off_crest=off_crest)


def with_joint_at(panels: Panels, p: int, s: float) -> tuple[Panels, int]:
    """Return panels with a joint at s in panel p, and the panel that begins there; slivers join a neighbour."""
    mesh = panels.mesh
    k = panels.segment(p)
    if s > 1.0 - SLIVER and p + 1 < mesh.first[k + 1] and mesh.joined[p + 1]:
        return _shift_joint(panels, p, s), p + 1
    if s < -1.0 + SLIVER and p > mesh.first[k] and mesh.joined[p]:
        q = 1.0 + (s + 1.0) * mesh.half[p] / mesh.half[p - 1]
        return _shift_joint(panels, p - 1, q), p
    return panels.split({p: s}), p + 1


def _shift_joint(panels: Panels, p: int, s: float) -> Panels:
    """Return panels with the joint between p and p + 1 at the local position s of panel p, also beyond its end."""
    mesh = panels.mesh
    a, b = mesh.half[p], mesh.half[p + 1]
    half = mesh.half.copy()
    half[p], half[p + 1] = 0.5 * (1.0 + s) * a, b + 0.5 * (1.0 - s) * a
    r, X, I, slope = panels.r.copy(), panels.X.copy(), mesh.I.copy(), mesh.dI / mesh.half[:, None]
    pairs = [(f, f[p].copy(), f[p + 1].copy()) for f in (r, X, I, slope)]
    for q, start in ((p, -a), (p + 1, s * a)):
        at = start + half[q] * (1.0 + RULE.s)  # the label, from the middle of p
        here, there = interpolation(at / a), interpolation((at - a - b) / b)
        for field, before, after in pairs:
            field[q] = np.where(at <= a, here @ before, there @ after)
        X[q] += np.where(at <= a, mesh.base[p], mesh.base[p + 1]) - mesh.base[q]
    return replace(panels, r=r, X=X, mesh=mesh._replace(I=I, dI=slope * half[:, None], half=half))


def parted(panels: Panels, cut: int, t: float, tau: float, sides: Sequence[Sequence[float]], number: int) -> Panels:
    """Return panels with a shock born at time t at the start of panel `cut`.

    Its labels separate like coefficient * (t' - t)^power. `sides` are these two numbers for its left and its right,
    `tau` the age for which labels are set.
    """
    k = int(np.searchsorted(panels.mesh.first[1:-1], cut, side="right")) if cut else 0
    return replace(
        panels, mesh=panels.mesh._replace(first=np.insert(panels.mesh.first, k + 1, cut)),
        number=[*panels.number[:k], number, *panels.number[k:]],
        off=np.insert(panels.off, k, [v * tau**e for v, e in sides], axis=0),
        power=np.insert(panels.power, k, [e for _, e in sides], axis=0),
        birth=np.insert(panels.birth, k, t), tau=np.insert(panels.tau, k, tau),
    )  # fmt: skip
