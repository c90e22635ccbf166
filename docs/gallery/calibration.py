"""
Which parameters do two surveys determine?
==========================================

A slope was surveyed before and after a supply of grains. ``hj.fit`` varies the supplied
mass and the neutral slope until the computed slope matches the second survey. No second
survey of the shipped hillslope exists, so the example makes one: with known parameters, by
another method than that of the fit, and with an error of half a metre.
"""

import matplotlib.pyplot as plt
import numpy as np

import hjprofile as hj

truth = {"time.end": 2.2, "profile.critical_slope": 0.265}
case = hj.load_case("hillslope", truth)
run = hj.solve_conservative(case.problem, hj.Grid(left=-13.0, cells=4000))
x = np.arange(0.0, 2537.0, 40.0)  # metres
height = np.interp(x, run.units.x(run.x), run.units.height(run.u[-1]))
height += np.random.default_rng(1).normal(0.0, 0.5, x.size)

# %%
# The fit starts from the values of the case file, a supplied mass of 3 and a neutral slope
# of 0.257. Each interval is one of 95 %.

found = hj.fit("hillslope", x, height, vary=list(truth))
for p in found.parameters:
    print(f"{p.name} = {p.value:.4f}, {p.low:.4f} to {p.high:.4f} (true {truth[p.name]})")
correlation = found.correlation[0, 1]
print(f"correlation {correlation:.2f}, standard deviation of a height {found.sigma:.2f} m")

# %%
# The left panel shows the change of height between the surveys. The ellipse in the right
# panel touches the ends of both intervals. The more the parameters are correlated, the
# narrower it is.

end, slope = found.parameters
angle = np.linspace(0.0, 2 * np.pi, 200)
turned = angle - np.arccos(correlation)
ellipse_end = end.value + 0.5 * (end.high - end.low) * np.cos(angle)
ellipse_slope = slope.value + 0.5 * (slope.high - slope.low) * np.cos(turned)

at, before, after = found.curve
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
left.plot(x, height - np.interp(x, at, before), "k.", label="measured")
left.plot(at, after - before, "C1", label="fitted")
left.set_xlabel("distance along the profile (m)")
left.set_ylabel("change of height (m)")
left.legend()
right.plot(ellipse_end, ellipse_slope, "C1", label="95 % intervals")
right.plot(end.value, slope.value, "C1o", label="fitted values")
right.plot(*truth.values(), "k*", markersize=10, label="true values")
right.set_xlabel("supplied mass t")
right.set_ylabel("neutral slope (height over length)")
right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))
plt.show()
