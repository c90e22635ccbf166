"""
How much material leaves a surveyed slope?
==========================================

A slope was surveyed, and a known volume of grains is supplied at its crest. How much
material leaves at the toe, and how far does the crest fall? The survey is the hillslope
that comes with hjprofile. Its neutral slope and its exchange length are assumed values. For
a slope of your own, replace the file and the three numbers.
"""

import matplotlib.pyplot as plt

import hjprofile as hj

file = hj.shipped_cases()["hillslope"].with_name("hillslope.csv")  # x and height in metres
slope = hj.survey(file, critical_slope=0.257, length=200.0, unit="m")
supplied = 30840.0  # volume per metre of width, in m²

# %%
# The problem is dimensionless, and ``units`` converts from and to the survey. The tolerance
# is an error of the dimensionless height: 1e-4 is 5 mm here.

problem = hj.Problem(hj.rational(), slope, end=supplied / slope.units.volume, snapshots=2)
run = hj.solve(problem, tolerance=1e-4)

leaves = run.toe_outflow * run.units.volume
deposited = -run.eroded_volume * run.units.volume
crest_fall = run.crest_lowering * run.units.rise
error = run.error_estimate * run.units.rise
print(f"supplied at the crest: {supplied:.0f} m²")
print(f"leaves at the toe: {leaves:.0f} m², stays on the slope: {deposited:.0f} m²")
print(f"the crest falls by {crest_fall:.1f} m")
print(f"estimated error of the heights: {1000 * error:.1f} mm")

# %%
# The supply is the sum of the outflow and of the net deposit. The upper part of the slope,
# which is steeper than the neutral slope, is eroded. The gentler reach below it receives
# the deposit.

x, height = run.units.x(run.x), run.units.height(run.u)
change = height[-1] - height[0]

fig, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 6), layout="constrained")
top.plot(slope.surveyed.x, slope.surveyed.height, "k.", label="survey")
top.plot(x, height[-1], "C1", label="after the supply")
top.set_ylabel("height (m)")
top.legend()
bottom.fill_between(x, change, where=change > 0, color="C0", label="deposit")
bottom.fill_between(x, change, where=change < 0, color="C3", label="erosion")
bottom.set_xlabel("distance along the profile (m)")
bottom.set_ylabel("change of height (m)")
bottom.legend()
plt.show()
