"""Processes that a command has beside its own: they heed no interrupt, and leave with it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from hjprofile.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor


MOST_WORKERS = 1000  # processes of one machine


@contextmanager
def drawing_helper(wanted: bool) -> Iterator[Executor | None]:
    """A process that draws pictures: it loads what that takes while this one solves. None where it would not help."""
    import threading

    alone = hasattr(os, "fork") and threading.active_count() == 1  # a fork beside other threads may hang
    if not (wanted and alone and (os.cpu_count() or 1) > 1):
        yield None
        return
    import multiprocessing
    import warnings
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(1, multiprocessing.get_context("fork"), _prepare, (os.getpid(),)) as helper:
        with warnings.catch_warnings():  # Python 3.12 and later warn of BLAS's threads too, which stand a fork
            warnings.simplefilter("ignore", DeprecationWarning)
            helper.submit(int)  # so that it starts now
        yield helper


@contextmanager
def processes(workers: int | None) -> Iterator[Executor]:
    """Workers for a sweep, one for each processor by default. Raises InputError if there were none.

    Each is a process begun anew: a fork takes locks along that nobody will open.
    """
    import multiprocessing
    import signal
    from concurrent.futures import CancelledError, ProcessPoolExecutor

    class Workers(ProcessPoolExecutor):
        def submit(self, *task: Any, **named: Any) -> Any:  # it starts processes, which inherit what is blocked
            before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
            try:
                return super().submit(*task, **named)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"--workers {workers} must be from 1 to {MOST_WORKERS}", about="the-command-line")
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    pool = Workers if hasattr(signal, "pthread_sigmask") else ProcessPoolExecutor
    with pool(workers or own, multiprocessing.get_context("spawn"), _ward, (os.getpid(),)) as executor:
        try:
            yield executor
        except BaseException:
            with suppress(RuntimeError, CancelledError):  # it may be broken already
                last = executor.submit(int)
                executor.shutdown(wait=False, cancel_futures=True)
                last.exception()  # by now it has let go of what was cancelled, over which it would stumble
            for process in multiprocessing.active_children():
                process.terminate()  # what they are at would only be thrown away
            raise


def _prepare(parent: int) -> None:
    _ward(parent)
    with suppress(Exception):  # who asks for a picture is told why there is none
        import hjprofile.output.plots.runs  # noqa: F401


def _ward(parent: int) -> None:
    """A process that heeds no interrupt and leaves with its parent."""
    import signal
    import threading

    def leave_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)  # it was killed: nobody else would tell

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent has a sentence for it
    threading.Thread(target=leave_with_parent, daemon=True).start()
