"""The variables of a run with their CF attributes, as a dataset of xarray and as a table of pandas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas
    import xarray

Field = tuple[tuple[str, ...], np.ndarray, dict[str, str]]  # dimensions, values, CF attributes

FIELDS: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {  # name -> dimensions, CF attributes
    "time": (("time",), {"long_name": "supplied mass of grains", "units": "1", "axis": "T"}),
    "x": (("node",), {"long_name": "distance from the crest, uphill positive", "units": "1", "axis": "X"}),
    "x_cell": (("cell",), {"long_name": "midpoints of the cells", "units": "1", "axis": "X"}),
    "u": (("time", "node"), {"long_name": "height of the standing profile", "units": "1"}),
    "q": (("time", "cell"), {"long_name": "excess slope du/dx - 1, mean over the cell", "units": "1"}),
    "K": (("time", "node"), {"long_name": "grain flux relative to the supply", "units": "1"}),
}
COORDINATES = "time", "x", "x_cell", "supplied_volume", "distance", "distance_cell"
INDEX = {"node": "x", "cell": "x_cell"}  # dimension of the file -> the coordinate that indexes it in xarray


def dataset(fields: Mapping[str, Field], attributes: Mapping[str, Any]) -> xarray.Dataset:
    """Return a dataset whose dimensions are indexed by their positions."""
    import xarray

    arrays = {n: (tuple(INDEX.get(d, d) for d in dims), *rest) for n, (dims, *rest) in fields.items()}
    coordinates = {name: arrays.pop(name) for name in [*arrays] if name in COORDINATES}
    return xarray.Dataset(arrays, coordinates, attributes)


def table(fields: Mapping[str, Field]) -> pandas.DataFrame:
    """Return a table with a row for each saved time and node; cell means are in the row of the node on their right."""
    import pandas

    time, x = fields["time"][1], fields["x"][1]
    columns = {}
    for name, (dims, values, _) in fields.items():
        if name == "q":
            columns[name] = np.insert(values, 0, np.nan, axis=1)
        elif name not in INDEX.values() and "cell" not in dims and name != "time":
            columns[name] = values[:, None] if dims == ("time",) else values
    index = pandas.MultiIndex.from_product([time, x], names=["time", "x"])
    shape = time.size, x.size
    return pandas.DataFrame({name: np.broadcast_to(a, shape).ravel() for name, a in columns.items()}, index)
