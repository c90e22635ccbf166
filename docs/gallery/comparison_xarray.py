"""
How far apart are the results of several methods?
=================================================

Each run becomes a dataset of xarray, and ``xarray.concat`` joins them along a new
dimension. Differences are then selections by name, time and position.
"""

import matplotlib.pyplot as plt
import xarray as xr

import hjprofile as hj

profile = hj.kinks(positions=[-7.0, -5.0], amplitudes=[0.4, 1.2])
problem = hj.Problem(hj.rational(), profile, end=4.0, snapshots=5)
grid = hj.Grid(left=-10.0, cells=500)
runs = [
    hj.track_fronts(problem, grid),  # exact for kinks
    hj.solve_hj(problem, grid, method="lax-friedrichs"),
    hj.solve_hj(problem, grid, method="godunov"),
    hj.solve_conservative(problem, grid),
]
solver = xr.Variable("solver", [run.method for run in runs])
data = xr.concat([run.to_xarray() for run in runs], dim=solver)
print(dict(data.sizes))

# %%
# Fronts are exact for this problem, so that differences from them are errors. The new
# dimension is not called ``method``, because ``sel`` has an argument of this name.

error = data.u.sel(solver=solver[1:]) - data.u.sel(solver="fronts")
error.attrs = {"long_name": "error of the height u", "units": "exchange lengths"}
for name in error.solver.values:
    final = error.sel(solver=name, time=4.0)
    largest, at_1 = abs(final).max().item(), final.sel(x=-1.0).item()
    print(f"{name:15} largest error {largest:.4f}, error at x = -1 {at_1:+.6f}")

# %%
# The errors are largest at the kink. xarray labels the vertical axis.

print(f"the kink is at x = {runs[0].kinks_at(-1)[0].x:.2f}")
fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
error.sel(time=4.0).plot.line(x="x", ax=ax)
ax.set_title("t = 4")
ax.set_xlabel("x (exchange lengths; crest at 0)")
plt.show()
