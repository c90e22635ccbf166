"""The command line: one function per command, which parses, calls the library and prints an account."""

from __future__ import annotations

import gc
import io
import os
import sys
from typing import NoReturn

from hjprofile.errors import InputError, RunError
from hjprofile.interrupts import heed_no_more, leave_when_asked

INTERRUPTED = "hjprofile: interrupted; no partial file was left"
# command -> heading of the page on errors for a message without its own; the other commands are studies
_ABOUT = {
    "run": "a-run-that-stops",
    "sweep": "a-sweep",
    "fit": "a-fit",
    "plot": "a-result-folder",
    "export": "a-result-folder",
    "explain": "the-command-line",
    "import": "an-imported-survey",
}


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run a command. Exit with 0 if it is done, 1 if the run or a check failed, 2 for wrong usage or bad input.

    Known failures print a message, never a traceback.
    """
    if arguments is None:  # the process belongs to this command
        _own_process()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a character that the encoding lacks is printed as '?'
            stream.reconfigure(errors="replace")
    from cyclopts import CycloptsError

    import hjprofile.cli.explain_command
    import hjprofile.cli.import_command
    import hjprofile.cli.results
    import hjprofile.cli.run_command
    import hjprofile.cli.solving
    import hjprofile.cli.studies  # noqa: F401  each has commands
    from hjprofile.cli.common import app

    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        _leave(f"hjprofile: {error}", 2, "the-command-line")
    except (InputError, RunError) as error:
        command = (sys.argv[1:] if arguments is None else arguments)[0]
        *others, last = error.faults if isinstance(error, InputError) else (error,)
        about = _ABOUT.get(command, "a-check-or-a-study")
        for fault in others:
            print(_with_pointer(f"hjprofile: {fault}", fault.about or about), file=sys.stderr)
        _leave(f"hjprofile: {last}", 2 if isinstance(error, InputError) else 1, last.about or about)
    except MemoryError:
        _leave("hjprofile: the memory of this machine is not sufficient; use fewer cells or snapshots", 1, "memory")
    except BrokenPipeError:  # the reader of stdout has ended; Python's flush at exit must not fail
        _drop_stdout()
        sys.exit(1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _leave(f"hjprofile: {where}{error.strerror or error}; no partial file was left", 1, "a-place-to-write")
    except KeyboardInterrupt:
        _leave(INTERRUPTED, 1, "interrupted")
    heed_no_more()
    sys.exit(0)


def _own_process() -> None:
    """Prepare a process that belongs to the command alone: open streams, signals, garbage collection."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # a closed stream: the next file would take its number and receive the output
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
    leave_when_asked(_with_pointer(INTERRUPTED, "interrupted"))
    gc.disable()  # a collection during the imports costs time and frees nothing


def _leave(sentence: str, code: int, about: str) -> NoReturn:
    """Print a message and the command that explains it, then exit."""
    heed_no_more()
    try:
        sys.stdout.flush()
    except OSError:  # a full disk: the message below names it, or a more important reason
        _drop_stdout()
    print(_with_pointer(sentence, about), file=sys.stderr)
    sys.exit(code)


def _with_pointer(sentence: str, about: str) -> str:
    """Return a message with the command that explains it."""
    return f"{' '.join(sentence.split())} (see: hjprofile explain {about})"


def _drop_stdout() -> None:
    """Discard the output that stdout cannot write, because Python would try again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
