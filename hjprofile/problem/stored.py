"""The reader of the netCDF file of a stored run, with its checks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.problem.grid import FEWEST_CELLS
from hjprofile.problem.ranges import Array

DIMENSIONS = {
    "time": ("time",), "x": ("node",), "x_cell": ("cell",),
    "u": ("time", "node"), "q": ("time", "cell"), "K": ("time", "node"),
}  # fmt: skip
LARGEST = 1e100  # of absolute values except K: differences and squares of such numbers are finite
LARGEST_K = 1e300  # a run in which K spans more decades cannot start
ROUNDING = 1e-9  # relative to the largest value: the arrays of every method agree to 1e-15


def read_profile(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return name -> array of the variables in DIMENSIONS, and name -> value of the global attributes.

    Raise OSError if there is no such file, and ValueError with the fault if it does not hold a run.
    """
    from scipy.io import netcdf_file

    try:
        with netcdf_file(path, "r", mmap=False) as file:
            arrays = {name: np.array(file.variables[name][:]) for name in DIMENSIONS}
            dimensions = {name: file.variables[name].dimensions for name in DIMENSIONS}
            attributes = dict(file._attributes)
    except OSError:
        raise
    except Exception as error:  # scipy raises many different exceptions
        raise ValueError(f"{path.name} is damaged ({type(error).__name__}: {error})") from None
    if dimensions != DIMENSIONS or any(array.dtype != ">f8" for array in arrays.values()):
        raise ValueError(f"{path.name} has variables of other dimensions or types than a run")
    arrays = {name: array.astype(float) for name, array in arrays.items()}
    if fault := _fault_of(arrays):
        raise ValueError(f"{path.name}: {fault}")
    return arrays, attributes


@np.errstate(all="ignore")
def _fault_of(arrays: dict[str, Array]) -> str:
    """Return a sentence on the first fault of a stored run, or ""."""
    time, x, x_cell, u, q, K = (arrays[name] for name in DIMENSIONS)
    cells = x_cell.size
    sizes = {"time": time.size, "node": cells + 1, "cell": cells}
    for name, array in arrays.items():
        if array.shape != tuple(sizes[dimension] for dimension in DIMENSIONS[name]):
            return f"{name} has the shape {array.shape}, which does not match the other variables"
        if not np.all(np.isfinite(array)):
            return f"{name} holds a value that is not a finite number"
        largest = LARGEST_K if name == "K" else LARGEST
        if array.size and np.abs(array).max() > largest:
            return f"{name} holds a value beyond {largest:g}"
    if not time.size or cells < FEWEST_CELLS:
        return f"it has {time.size} saved times and {cells} cells; a run has at least 1 and {FEWEST_CELLS}"
    if time[0] < 0.0 or np.any(np.diff(time) <= 0.0):
        return "the saved times do not increase from 0 or more"
    dx = (x[-1] - x[0]) / cells
    even = ROUNDING * max(np.abs(x).max(), dx)
    if not (dx > 0.0 and np.abs(np.diff(x) - dx).max() <= even and np.abs(x[:-1] + 0.5 * dx - x_cell).max() <= even):
        return "the nodes are not those of equal cells, or x_cell does not hold the midpoints of the cells"
    if q.min() <= -1.0 or K.min() < 0.0:
        return "q is not above -1, or K is negative"
    if np.abs(np.diff(u, axis=1) - np.diff(x) * (1.0 + q)).max() > ROUNDING * (np.abs(u).max() + dx * np.abs(q).max()):
        return "q is not the slope of u less 1"
    return ""
