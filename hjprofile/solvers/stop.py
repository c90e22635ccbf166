"""Why a run stopped: a reason to decide by, and numbers from which the sentence is composed when it is shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Any

from hjprofile.errors import RunError

ROBUST_METHOD = "godunov"  # the monotone method that sentences recommend


class Reason(Enum):
    """What kept a run from going on, or a method from solving a problem."""

    NOT_ADMISSIBLE = auto()  # q <= -1, or a K that is no finite number
    TOO_SMALL_STEPS = auto()
    BROKEN_BOUND = auto()
    NOT_SMOOTH = auto()  # data that characteristics cannot represent
    NOT_RESOLVED = auto()  # data or a state that needs more fronts, cells or panels than there may be
    LABELS_LOST = auto()
    TOO_LONG = auto()  # more work than was allowed
    LEFT_THE_WINDOW = auto()
    BAD_COEFFICIENT = auto()
    NO_METHOD = auto()


class Time(float):
    """A time in a sentence."""


class Place(float):
    """An x in a sentence."""


@dataclass(frozen=True)
class Stop:
    """A reason and its sentence, with times and places as numbers, so that other units can be put in their place.

    Attributes:
        reason: to decide by.
        words: the sentence as a template of `str.format`, without the remedy.
        remedy: what to try; "" if `values` holds a Stop that says it.
        values: of the fields in `words`: each a Time, a Place, another Stop, or what stays as it is.
    """

    reason: Reason
    words: str
    remedy: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cause(self) -> str:
        """What happened, without what to try."""
        inner = {name: v.cause if isinstance(v, Stop) else v for name, v in self.values.items()}
        return self.words.format(**inner)

    @property
    def advice(self) -> str:
        """What to try."""
        return self.remedy or next((v.advice for v in self.values.values() if isinstance(v, Stop)), "")

    def __str__(self) -> str:
        return f"{self.cause}; {self.advice}" if self.advice else self.cause

    def mapped(self, time: Callable[[float], float], place: Callable[[float], float]) -> Stop:
        """Return the same with other times and places."""

        def there(value: Any) -> Any:
            if isinstance(value, Stop):
                return value.mapped(time, place)
            if isinstance(value, Time):
                return Time(time(value))
            return Place(place(value)) if isinstance(value, Place) else value

        return replace(self, values={name: there(value) for name, value in self.values.items()})


class Stopped(RunError):
    """A run that could not start or go on."""

    def __init__(self, stop: Stop):
        super().__init__(str(stop))
        self.stop = stop

    def __reduce__(self) -> tuple[type[Stopped], tuple[Stop]]:
        return type(self), (self.stop,)

    def mapped(self, time: Callable[[float], float], place: Callable[[float], float]) -> Stopped:
        """Return the same with other times and places."""
        return Stopped(self.stop.mapped(time, place))
