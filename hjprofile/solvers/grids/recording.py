"""Records of a run on a grid: rows at the saved times, and the checkpoint fields of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.scheme import Scheme
from hjprofile.solvers.run import Array
from hjprofile.solvers.states import Callback, Snapshot, stopped_by
from hjprofile.solvers.stop import Stop


class Recording(NamedTuple):
    """The saved states of a run, with a summary of its steps."""

    times: Array
    W: Array
    q: Array
    K: Array
    stop: Stop | None  # None: the run reached the end
    steps: int
    step_range: tuple[float, float]
    wall_seconds: float


class Recorder:
    """Rows of t, W, q and K at the saved times; `stop` is the reason if the callback asks for the end of the run."""

    checkpoint_fields: tuple[str, ...] = ("saved_rows",)

    def __init__(self, times: int, grid: Grid, callback: Callback | None = None):
        self.grid, self.callback = grid, callback
        self.stop: Stop | None = None
        self.columns = [
            np.empty((times, *shape)) for shape in ((), (grid.cells + 1,), (grid.cells,), (grid.cells + 1,))
        ]
        self.rows = 0

    def save(self, t: float, scheme: Scheme) -> None:
        for i, value in enumerate((t, scheme.W, scheme.q, scheme.K)):
            if self.rows == len(self.columns[i]):  # the last good state of a run that stopped after all saved times
                self.columns[i] = np.concatenate([self.columns[i], [value]])
            self.columns[i][self.rows] = value
        self.rows += 1

    def show(self) -> None:
        """Show the last row to the callback."""
        if self.callback:
            t, W, q, K = (column[self.rows - 1] for column in self.columns)
            state = Snapshot(float(t), self.grid.nodes, self.grid.centres, self.grid.nodes + W, q, K)
            self.stop = stopped_by(self.callback, state)

    @property
    def saved_rows(self) -> Array:
        return np.hstack([column[: self.rows].reshape(self.rows, column[0].size) for column in self.columns])

    @saved_rows.setter
    def saved_rows(self, rows: Array) -> None:
        self.rows = len(rows)
        widths = np.cumsum([1] + [column.shape[1] for column in self.columns[1:]])
        for column, part in zip(self.columns, np.split(rows, widths[:-1], axis=1), strict=True):
            column[: self.rows] = part.reshape(column[: self.rows].shape)


def remember(parts: Mapping[str, Any]) -> dict[str, Array]:
    """Return the checkpoint fields of the parts of a run, by "part.name"."""
    return {
        f"{part}.{name}": np.asarray(getattr(holder, name))
        for part, holder in parts.items()
        for name in holder.checkpoint_fields
    }


def recall(parts: Mapping[str, Any], stored: Mapping[str, Array]) -> None:
    """Set the checkpoint fields of the parts of a run to their stored values."""
    for part, holder in parts.items():
        for name in holder.checkpoint_fields:
            value, current = stored[f"{part}.{name}"], getattr(holder, name)
            if isinstance(current, np.ndarray):
                setattr(holder, name, np.array(value))
            else:
                setattr(holder, name, tuple(value.tolist()) if isinstance(current, tuple) else value.item())
