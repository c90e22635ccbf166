"""The messages of a failed command: on stderr, each with the command that explains it."""

from __future__ import annotations

import os
import sys

from hjprofile.errors import InputError, RunError

FAILURES = InputError, RunError, MemoryError, OSError  # of a command, which ends with a message and no traceback
# command -> heading of the page on errors for a message without its own; the other commands are studies
_ABOUT = {
    "run": "a-run-that-stops",
    "sweep": "a-sweep",
    "fit": "a-fit",
    "plot": "a-result-folder",
    "export": "a-result-folder",
    "explain": "the-command-line",
    "methods": "the-command-line",
    "import": "an-imported-survey",
    "new": "the-command-line",
    "validate": "a-case-file",
}


def report(error: BaseException, command: str) -> int:
    """Print the messages of one of FAILURES, after everything printed so far, and return its exit code."""
    try:
        sys.stdout.flush()
    except OSError:  # a full disk: the message below names it, or a more important reason
        drop_stdout()
    if isinstance(error, InputError | RunError):
        about = _ABOUT.get(command, "a-check-or-a-study")
        for fault in error.faults if isinstance(error, InputError) else (error,):
            complain(f"hjprofile: {fault}", fault.about or about)
        return 2 if isinstance(error, InputError) else 1
    if isinstance(error, MemoryError):
        complain("hjprofile: the memory of this machine is not sufficient; use fewer cells or snapshots", "memory")
    elif isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        complain(f"hjprofile: {where}{error.strerror or error}; no partial file was left", "a-place-to-write")
    return 1


def complain(sentence: str, about: str) -> None:
    """Print a message on stderr with the command that explains it."""
    print(with_pointer(sentence, about), file=sys.stderr)


def with_pointer(sentence: str, about: str) -> str:
    """Return a message with the command that explains it."""
    return f"{' '.join(sentence.split())} (see: hjprofile explain {about})"


def drop_stdout() -> None:
    """Discard the output that stdout cannot write, because Python would try again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
