"""Reasons for which a run stops, with the numbers of their sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Any

from hjprofile.errors import RunError

ROBUST_METHOD = "godunov"  # the monotone method that sentences recommend


class Reason(Enum):
    """The cause for which a run stopped, or for which a method does not solve a problem."""

    NOT_ADMISSIBLE = auto()  # q <= -1, or K is not a finite number
    TOO_SMALL_STEPS = auto()
    BROKEN_BOUND = auto()
    NOT_SMOOTH = auto()  # data that characteristics cannot represent
    NOT_RESOLVED = auto()  # data or a state that needs more fronts, cells or panels than allowed
    LABELS_LOST = auto()
    TOO_LONG = auto()  # more work than was allowed
    LEFT_THE_WINDOW = auto()
    BAD_COEFFICIENT = auto()
    BAD_SUPPLY = auto()
    NO_METHOD = auto()
    CALLBACK = auto()  # a request of the user: the run is done


class Time(float):
    """A time in a sentence."""


class Place(float):
    """A position x in a sentence."""


@dataclass(frozen=True)
class Stop:
    """A reason and its sentence, with times and positions as numbers, so that their units can be converted.

    Attributes:
        reason: for decisions.
        words: the sentence as a template of `str.format`, without the remedy.
        remedy: the advice; "" if a Stop in `values` contains it.
        values: of the fields in `words`: each a Time, a Place, another Stop, or a value without conversion.
    """

    reason: Reason
    words: str
    remedy: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cause(self) -> str:
        """The sentence without the advice."""
        inner = {name: v.cause if isinstance(v, Stop) else v for name, v in self.values.items()}
        return self.words.format(**inner)

    @property
    def advice(self) -> str:
        """The advice."""
        return self.remedy or next((v.advice for v in self.values.values() if isinstance(v, Stop)), "")

    def __str__(self) -> str:
        return f"{self.cause}; {self.advice}" if self.advice else self.cause

    def mapped(self, time: Callable[[float], float], place: Callable[[float], float]) -> Stop:
        """Return the same with other times and positions."""

        def there(value: Any) -> Any:
            if isinstance(value, Stop):
                return value.mapped(time, place)
            if isinstance(value, Time):
                return Time(time(value))
            return Place(place(value)) if isinstance(value, Place) else value

        return replace(self, values={name: there(value) for name, value in self.values.items()})


class Stopped(RunError):
    """A run that could not start or continue."""

    def __init__(self, stop: Stop):
        super().__init__(str(stop))
        self.stop = stop

    def __reduce__(self) -> tuple[type[Stopped], tuple[Stop]]:
        return type(self), (self.stop,)

    def mapped(self, time: Callable[[float], float], place: Callable[[float], float]) -> Stopped:
        """Return the same with other times and positions."""
        return Stopped(self.stop.mapped(time, place))
