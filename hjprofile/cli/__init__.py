"""The command line: one function per command, which parses, calls the library and prints an account."""

from __future__ import annotations

import gc
import io
import os
import sys
from typing import NoReturn

from hjprofile.cli.messages import FAILURES, complain, drop_stdout, report, with_pointer
from hjprofile.interrupts import heed_no_more, leave_when_asked

INTERRUPTED = "hjprofile: interrupted; no partial file was left"


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

    import hjprofile.cli.case_commands
    import hjprofile.cli.explain_command
    import hjprofile.cli.import_command
    import hjprofile.cli.results
    import hjprofile.cli.run_command
    import hjprofile.cli.solving
    import hjprofile.cli.studies  # noqa: F401  each has commands
    from hjprofile.cli.common import app

    try:
        outcome = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        code = outcome if isinstance(outcome, int) else 0  # a command that reports its failures returns its exit code
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of stdout has ended; Python's flush at exit must not fail
        drop_stdout()
        code = 1
    except CycloptsError as error:
        complain(f"hjprofile: {error}", "the-command-line")
        code = 2
    except KeyboardInterrupt:
        heed_no_more()
        complain(INTERRUPTED, "interrupted")
        code = 1
    except FAILURES as error:
        heed_no_more()
        code = report(error, (sys.argv[1:] if arguments is None else arguments)[0])
    heed_no_more()
    if arguments is None:
        gc.freeze()  # the interpreter need not look for cycles among a million objects before it ends
    sys.exit(code)


def _own_process() -> None:
    """Prepare a process that belongs to the command alone: open streams, signals, garbage collection."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # a closed stream: the next file would take its number and receive the output
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
    leave_when_asked(with_pointer(INTERRUPTED, "interrupted"))
    gc.disable()  # a collection during the imports costs time and frees nothing
