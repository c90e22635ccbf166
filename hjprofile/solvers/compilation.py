"""Notice of the compilation of loops, which happens at their first call unless the cache on disk holds them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event


class _Listener(event.Listener):  # type: ignore[misc]
    """Pass the begin and the end of the outermost compilations on; those of called loops are parts of them."""

    def __init__(self, notice: Callable[[bool], None]):
        self.notice, self.depth = notice, 0

    def on_start(self, event: Any) -> None:
        self.depth += 1
        if self.depth == 1:
            self.notice(True)

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0:
            self.notice(False)


@contextmanager
def noticed(notice: Callable[[bool], None]) -> Iterator[None]:
    """Call `notice` with True when a compilation begins in this context, and with False when it ends.

    Loops that are loaded from the cache are not compiled.
    """
    with event.install_listener("numba:compile", _Listener(notice)):
        yield
