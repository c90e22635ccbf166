"""The two ways in which a user is told that something cannot be done, and where the documentation says more of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

PAGE = "docs/errors.md"  # every sentence that the library refuses or stops with is there; a test says so


class InputError(ValueError):
    """Bad input: one sentence that names the file, the key, the value and what is allowed (exit code 2).

    `about` is the heading of PAGE, as in "a-survey", under which there is more of it; "" where only the command knows.
    `faults` are the errors that a file was rejected for, one for each fault; of an error with one fault, itself alone.
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
        """Return one error with all these faults, a line each; of one fault, itself."""
        if len(faults) == 1:
            return faults[0]
        error = cls("\n".join(map(str, faults)), faults[0].about)
        error._several = tuple(faults)
        return error


class RunError(RuntimeError):
    """A run or a check that failed: one sentence that says when, where, why and what to try (exit code 1).

    `about` as for an InputError.
    """

    def __init__(self, sentence: str, about: str = ""):
        super().__init__(sentence)
        self.about = about


def nearest(word: str, choices: Iterable[str] | Mapping[str, str]) -> str | None:
    """Return the nearest of the choices, or what stands for it; None if none is near. Case is ignored."""
    import difflib

    written = choices if isinstance(choices, Mapping) else {choice: choice for choice in choices}
    lower = {choice.lower(): shown for choice, shown in written.items()}
    close = difflib.get_close_matches(word.lower(), lower, 1)
    return lower[close[0]] if close else None


def did_you_mean(word: str, choices: Iterable[str] | Mapping[str, str]) -> str:
    """`; did you mean 'x'?` with the nearest of the choices, or what stands for it, or "" where none is near."""
    near = nearest(word, choices)
    return "" if near is None else f"; did you mean {near!r}?"


def by_last_part(dotted: Iterable[str]) -> dict[str, str]:
    """Dotted keys under their own names and under their last parts, as choices of `did_you_mean`: end of time.end."""
    keys = list(dotted)
    return {key.rpartition(".")[2]: key for key in keys} | {key: key for key in keys}
