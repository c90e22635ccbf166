"""The two exceptions of the package, their pointers to the page on errors, and the suggestion of the nearest name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

PAGE = "docs/errors.md"  # holds every message of the library; `hjprofile explain` prints its sections


class InputError(ValueError):
    """Bad input: nothing was computed (exit code 2).

    The message names the file, the key and the value, and states what is allowed.

    Attributes:
        about: heading of the page on errors, as in "a-survey"; "" if only the command determines it.
        faults: the errors of a rejected file, one for each fault. An error with one fault holds itself alone.

    >>> import hjprofile as hj
    >>> try:
    ...     hj.power(m=-1.0)
    ... except hj.InputError as error:
    ...     print(error)
    m = -1.0 must be a positive number, at most 100 (and not below 1e-100: use the law 'log')
    """

    def __init__(self, sentence: str, about: str = ""):
        super().__init__(sentence)
        self.about = about
        self._several: tuple[InputError, ...] = ()

    @property
    def faults(self) -> tuple[InputError, ...]:
        return self._several or (self,)

    @classmethod
    def of(cls, faults: Sequence[InputError]) -> InputError:
        """Return one error with all these faults, one per line; a single fault is returned itself."""
        if len(faults) == 1:
            return faults[0]
        error = cls("\n".join(map(str, faults)), faults[0].about)
        error._several = tuple(faults)
        return error


class RunError(RuntimeError):
    """A failed run or check (exit code 1).

    The message states time, position and reason of the failure, and a remedy.

    Attributes:
        about: heading of the page on errors, as in "a-run-that-stops"; "" if only the command determines it.

    >>> import hjprofile as hj
    >>> issubclass(hj.RunError, RuntimeError)
    True
    """

    def __init__(self, sentence: str, about: str = ""):
        super().__init__(sentence)
        self.about = about


def nearest(word: str, choices: Iterable[str] | Mapping[str, str]) -> str | None:
    """Return the nearest of the choices, or the text that a mapping gives for it; None if none is near. Ignore case."""
    import difflib

    written = choices if isinstance(choices, Mapping) else {choice: choice for choice in choices}
    lower = {choice.lower(): shown for choice, shown in written.items()}
    close = difflib.get_close_matches(word.lower(), lower, 1)
    return lower[close[0]] if close else None


def did_you_mean(word: str, choices: Iterable[str] | Mapping[str, str]) -> str:
    """Return `; did you mean 'x'?` with the nearest of the choices, or "" if none is near."""
    near = nearest(word, choices)
    return "" if near is None else f"; did you mean {near!r}?"


def by_last_part(dotted: Iterable[str]) -> dict[str, str]:
    """Return dotted keys under their own names and under their last parts, as choices of `did_you_mean`: end of
    time.end.
    """
    keys = list(dotted)
    return {key.rpartition(".")[2]: key for key in keys} | {key: key for key in keys}
