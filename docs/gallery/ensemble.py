"""
How uncertain is the profile if two parameters are uncertain?
=============================================================

The exchange length and the neutral slope of a hillslope are known only approximately. Each
member of an ensemble has its own two values and receives the same volume of grains. joblib
runs the members on all processors. The result is the median of the change of height at each
position, and the band that contains 90 % of the members there.
"""

import matplotlib.pyplot as plt
import numpy as np
from joblib import Parallel, delayed

import hjprofile as hj

file = hj.shipped_cases()["hillslope"].with_name("hillslope.csv")
supplied = 30840.0  # volume per metre of width, in m²
ground = np.linspace(0.0, 2536.0, 400)  # metres


def change(length, critical_slope):
    """Return the change of height on the ground, in metres."""
    slope = hj.survey(file, critical_slope=critical_slope, length=length, unit="m")
    end = supplied / slope.units.volume
    run = hj.track_fronts(hj.Problem(hj.rational(), slope, end, snapshots=2), fronts=400)
    height = run.units.height(run.u)
    return np.interp(ground, run.units.x(run.x), height[-1] - height[0])


# %%
# The exchange length varies by a factor of 1.4 and the neutral slope by 0.01, each one
# standard deviation.

rng = np.random.default_rng(5)
lengths = 200.0 * 1.4 ** rng.standard_normal(100)
critical_slopes = rng.normal(0.257, 0.01, 100)
members = [delayed(change)(*pair) for pair in zip(lengths, critical_slopes, strict=True)]
changes = np.array(Parallel(n_jobs=-1)(members))

low, median, high = np.quantile(changes, [0.05, 0.5, 0.95], axis=0)
print(f"the crest falls by {-median[-1]:.0f} m; 90 %: {-high[-1]:.0f} to {-low[-1]:.0f} m")
most = np.argmax(median)
print(f"largest deposit {median[most]:.0f} m; 90 %: {low[most]:.0f} to {high[most]:.0f} m")

# %%
# The lowering of the crest is the most uncertain result. The largest deposit is less
# uncertain.

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.fill_between(ground, low, high, color="C0", alpha=0.3, label="90 % of the members")
ax.plot(ground, median, "C0", label="median")
ax.axhline(0.0, color="k", linewidth=0.8)
ax.set_xlabel("distance along the profile (m)")
ax.set_ylabel("change of height (m)")
ax.legend()
plt.show()
