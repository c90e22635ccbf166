"""Kinks of rounded data: jumps of q that the rounding of heights may have caused are not reported."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hjprofile.solvers.run import Event, KinkRecord, in_order


def without_weak_kinks(
    kinks: Sequence[KinkRecord], events: Sequence[Event], least: float
) -> tuple[list[KinkRecord], list[Event]]:
    """Return kinks and events without kinks whose jump of q has not reached `least`.

    A kink that reaches it after the start is born at the first saved time at which it has. If a reported kink merges
    into one that has not reached it, the result of the merge has the number of the reported kink.
    """
    if not least > 0.0 or not kinks:
        return list(kinks), list(events)
    start = min(record.time for record in kinks)
    first: dict[int, KinkRecord] = {}  # kink -> its first record at all
    strong: dict[int, KinkRecord] = {}  # kink -> its first record with a jump that is reported
    for record in sorted(kinks, key=lambda record: record.time):
        first.setdefault(record.kink, record)
        if record.jump >= least:
            strong.setdefault(record.kink, record)
    since = {kink: record.time for kink, record in strong.items()}
    kept, births, heir = _events_of(events, since)
    heirs = {kink for kink, (t, _) in heir.items() if since.get(kink, t) >= t}
    for kink, record in strong.items():
        if kink in heirs:
            continue
        if record is first[kink] and kink in births:
            kept.append(births[kink])
        elif record.time > start:
            kept.append(Event(record.time, "birth", kink, None, record.x))
    found = [record._replace(kink=_now(record.kink, heir)) for record in kinks if _is_reported(record, since, heir)]
    return _numbered(found, in_order(kept), start)


def _events_of(
    events: Sequence[Event], since: dict[int, float]
) -> tuple[list[Event], dict[int, Event], dict[int, tuple[float, int]]]:
    """Return the merges and exits of reported kinks, kink -> its birth, and the heirs.

    An heir is a weak kink into which a reported one merges: kink -> since when it is which reported kink.
    """
    kept: list[Event] = []
    births: dict[int, Event] = {}
    heir: dict[int, tuple[float, int]] = {}
    for event in in_order(events):
        kink, into = _now(event.kink, heir), None if event.into is None else _now(event.into, heir)
        if event.event == "birth":
            births[kink] = event
            continue
        if not since.get(kink, np.inf) <= event.time:
            continue
        if into is not None and not since.get(into, np.inf) <= event.time:
            heir[into] = event.time, kink
            continue
        if into != kink:
            kept.append(event._replace(kink=kink, into=into))
    return kept, births, heir


def _now(kink: int, heir: dict[int, tuple[float, int]]) -> int:
    """Return the reported kink that a kink is after a merge, or the kink itself."""
    return heir[kink][1] if kink in heir else kink


def _is_reported(record: KinkRecord, since: dict[int, float], heir: dict[int, tuple[float, int]]) -> bool:
    """Return True if a kink has reached the jump that is reported, or is the result of a merge with one that had."""
    reached = record.time >= heir[record.kink][0] if record.kink in heir else False
    return reached or (record.kink in since and record.time >= since[record.kink])


def _numbered(kinks: list[KinkRecord], events: list[Event], start: float) -> tuple[list[KinkRecord], list[Event]]:
    """Return kinks and events with numbers from 1 on: those at the start from the left, then by the date of birth."""
    data = [record.kink for record in sorted(kinks, key=lambda record: record.x) if record.time == start]
    born = {event.kink: (event.time, event.x) for event in events if event.event == "birth"}
    later = sorted({record.kink for record in kinks} - set(data), key=lambda kink: born.get(kink, (start, 0.0)))
    number = {kink: i for i, kink in enumerate([*data, *later], start=1)}
    return (
        [record._replace(kink=number[record.kink]) for record in kinks],
        [
            event._replace(kink=number[event.kink], into=None if event.into is None else number[event.into])
            for event in events
            if event.kink in number
        ],
    )
