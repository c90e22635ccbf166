"""Cuts hillslope.csv out of the elevation model `jacksboro_fault_dem.npz` that comes with matplotlib.

The model: 3 arc-seconds, about 36.6 N 84.25 W (Jacksboro fault, Tennessee), heights in metres above sea level.
Row 304 read westwards rises without a break from column 149 to 183.
"""

from pathlib import Path

import numpy as np
from matplotlib.cbook import get_sample_data

ROW, FIRST, LAST = 304, 149, 183
METRES_PER_DEGREE = 111_320.0

model = get_sample_data("jacksboro_fault_dem.npz")
latitude = float(model["ymin"]) - ROW * float(model["dy"])  # the file's ymin is its northern edge
spacing = float(model["dx"]) * METRES_PER_DEGREE * np.cos(np.radians(latitude))
height = model["elevation"][ROW, ::-1][FIRST : LAST + 1]
lines = [
    "# Hillslope at the Jacksboro fault, Tennessee, cut by cut_hillslope.py",
    "# from jacksboro_fault_dem.npz of matplotlib's sample data; metres",
    "x,height",
    *(f"{i * spacing:.2f},{z}" for i, z in enumerate(height)),
]
Path(__file__).with_name("hillslope.csv").write_text("\n".join(lines) + "\n")
