"""The signals that ask a process to end: Ctrl-C, the SIGTERM of a batch system, the SIGHUP of a closed terminal."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
PATIENCE = 1.0  # seconds that the cleanup of a process may take
_undo: list[Callable[[], object]] = []
_early: list[int] = []


def leave_when_asked(sentence: str) -> None:
    """Make a signal end this process from now on, with exit code 1 and the sentence on stderr.

    A separate thread ends the process. An exception in the main thread would be late, because compiled code must return
    to Python first. A callback or an import could also swallow it or turn it into another exception.
    """
    for s in _heeded():
        signal.signal(s, _wake)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_leave, args=(reading, sentence), name=__name__, daemon=True).start()
    os.write(writing, bytes(_early))


def heed_no_more() -> None:
    """Ignore signals, because the process is about to end."""
    for s in SIGNALS:
        if signal.getsignal(s) is _wake:
            signal.signal(s, signal.SIG_IGN)


@contextmanager
def answered(answer: Callable[..., Any]) -> Iterator[None]:
    """Call `answer` in the main thread at the first signal in this context, and restore the former handlers then."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}

    def restore() -> None:
        if before:
            signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
        while before:
            signal.signal(*before.popitem())

    def first(number: int, frame: Any) -> None:
        restore()
        answer(number, frame)

    wakeup = signal.set_wakeup_fd(-1)
    try:
        for s in _heeded():
            before[s] = signal.getsignal(s)
            signal.signal(s, first)
        yield
    finally:
        restore()


@contextmanager
def undone(undo: Callable[[], object]) -> Iterator[None]:
    """Call `undo`, from another thread, if a signal ends the process in this context."""
    _undo.append(undo)
    try:
        yield
    finally:
        _undo.remove(undo)


def watched() -> bool:
    """Return True if no other thread runs, except the one that waits for signals, which is harmless for a fork."""
    others = set(threading.enumerate()) - {threading.current_thread()}
    return all(thread.name == __name__ for thread in others)


def _heeded() -> list[int]:
    """Return the signals that are not ignored by the parent of the process (nohup, a shell's `&`)."""
    return [s for s in SIGNALS if signal.getsignal(s) not in (signal.SIG_IGN, None)]


def _wake(number: int, _: Any) -> None:
    """Note an early signal. Later the interpreter itself wakes the thread that waits for signals."""
    _early.append(number)


def _leave(reading: int, sentence: str) -> NoReturn:
    """Wait for a signal, then end the process."""
    while os.read(reading, 1)[0] not in SIGNALS:
        pass

    def end() -> NoReturn:
        with suppress(OSError):
            os.write(2, f"{sentence}\n".encode())
        os._exit(1)

    late = threading.Timer(PATIENCE, end)
    late.daemon = True
    late.start()
    for undo in (*reversed(_undo), sys.stdout.flush):  # printed output is not lost with the process
        with suppress(Exception):
            undo()
    end()
