"""The auxiliary processes of a command, which ignore interrupts and end with it."""

from __future__ import annotations

import gc
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from hjprofile.errors import InputError, RunError
from hjprofile.interrupts import SIGNALS, answered, undone, watched

if TYPE_CHECKING:
    from concurrent.futures import Executor, ProcessPoolExecutor


MOST_WORKERS = 1000  # processes of one machine


@contextmanager
def drawing_helper(wanted: bool) -> Iterator[Executor | None]:
    """Provide a process that imports the drawing libraries while this one solves; None if it would not help."""
    alone = hasattr(os, "fork") and watched()  # a fork of a process with other threads may hang
    if not (wanted and alone and (os.cpu_count() or 1) > 1):
        yield None
        return
    import multiprocessing

    with undone(_kill), _workers()(1, multiprocessing.get_context("fork"), _prepare, (os.getpid(),)) as helper:
        with _forking():
            helper.submit(int)  # starts the process now
        yield helper


def by_a_fork(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Call a function in a fork of the drawing helper, which has all its imports and data.

    Return a function that waits for the result; it raises EOFError if the fork has ended without one.
    """
    import multiprocessing

    context, parent = multiprocessing.get_context("fork"), os.getpid()
    reader, writer = context.Pipe(duplex=False)

    def work() -> None:
        _ward(parent)  # a fork has no threads of its parent, and holds `reader`, so it would wait for a lost parent
        writer.send(function(*arguments))

    with writer, _forking():
        context.Process(target=work, daemon=True).start()
    return reader.recv


@contextmanager
def _forking() -> Iterator[None]:
    """Start a fork. Python 3.12 and later warn of all threads, but those of a command and of its helper are safe."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        yield


@contextmanager
def processes(workers: int | None) -> Iterator[Executor]:
    """Provide workers for a sweep, one for each processor by default. Raise InputError for another number.

    Each worker is spawned, because a fork inherits locks that nobody releases.
    """
    import multiprocessing
    from concurrent.futures import CancelledError

    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"--workers {workers} must be from 1 to {MOST_WORKERS}", about="the-command-line")
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    context = multiprocessing.get_context("spawn")
    with undone(_kill), answered(signal.default_int_handler):
        with _workers()(workers or own, context, _ward, (os.getpid(),)) as executor:
            try:
                yield executor
            except BaseException as error:
                with suppress(RuntimeError, CancelledError, TimeoutError):  # the pool may be broken already, or busy
                    last = executor.submit(int)
                    executor.shutdown(wait=False, cancel_futures=True)
                    last.exception(0.5)  # the pool has then removed the cancelled calls, which would make it fail
                _kill()  # their results are not needed
                if isinstance(error, KeyboardInterrupt):
                    raise RunError("interrupted; no partial file was left", "interrupted") from None
                raise
        del executor
        gc.collect()  # a process that ends with the semaphores of a pool causes a warning


def _workers() -> type[ProcessPoolExecutor]:
    """Return a pool of processes whose workers ignore interrupts from their very start."""
    from concurrent.futures import ProcessPoolExecutor

    if not hasattr(signal, "pthread_sigmask"):
        return ProcessPoolExecutor

    class Workers(ProcessPoolExecutor):
        def __init__(self, *options: Any):
            with _unheard():
                super().__init__(*options)

        def submit(self, *task: Any, **named: Any) -> Any:
            with _unheard():
                return super().submit(*task, **named)

    return Workers


@contextmanager
def _unheard() -> Iterator[None]:
    """Hold back signals from the processes that start in this context; this process receives a signal afterwards."""
    heard: list[int] = []
    try:
        with answered(lambda number, _: heard.append(number)):
            before = signal.pthread_sigmask(signal.SIG_BLOCK, set(SIGNALS) - {signal.SIGTERM})
            try:
                yield
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
    finally:
        if heard:
            signal.raise_signal(heard[0])


def _kill() -> None:
    import multiprocessing

    for process in multiprocessing.active_children():
        process.kill()


def _prepare(parent: int) -> None:
    _ward(parent)
    with suppress(Exception):  # the request for a picture reports the reason
        import hjprofile.output.plots.runs  # noqa: F401


def _ward(parent: int) -> None:
    """Make this process ignore interrupts and end with its parent."""
    import threading

    def leave_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)  # the parent was killed

    signal.set_wakeup_fd(-1)  # a fork inherits it from its parent
    for s in SIGNALS:  # the parent reports them, and ends a worker by SIGTERM
        signal.signal(s, signal.SIG_DFL if s == signal.SIGTERM else signal.SIG_IGN)
    threading.Thread(target=leave_with_parent, daemon=True).start()
