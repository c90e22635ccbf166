"""
How fast does a slope approach the travelling wave?
===================================================

On the whole line, one kink with its decay on the right travels uphill with constant speed
and shape. A rise of the slope approaches such a wave of the same mass. The example begins
with a smooth rise and measures the distance from the wave while grains are supplied.
"""

import matplotlib.pyplot as plt
import numpy as np

import hjprofile as hj

rise = hj.bumps(amplitudes=[0.8], centres=[0.0], widths=[0.7])
problem = hj.Problem(hj.rational(), rise, end=20.0, snapshots=41, line="whole")
run = hj.track_fronts(problem, hj.Grid(left=-4.0, cells=2000, right=34.0), fronts=800)

# %%
# Under the rational law the wave is q = A exp(s - x) on the right of its kink at s, and
# q = 0 on the left. Its amplitude A is equal to its mass, the integral of q. The kink of
# the wave is put at the kink of the run. The distance is the integral of the absolute
# difference of the two slopes.

height = run.u - run.x  # above the neutral slope; its derivative is q
mass = height[0, -1] - height[0, 0]
times, distances, excess = [], [], []
for i, t in enumerate(run.time):
    for kink in run.kinks_at(i):  # none at the start
        wave = mass * (1 - np.exp(-np.maximum(run.x - kink.x, 0.0)))
        times.append(t)
        distances.append(np.abs(np.diff(height[i] - wave)).sum())
        excess.append(kink.q_right - mass)
print(f"mass of the rise, and amplitude of the wave: {mass:.4f}")
print(f"at t = {times[-1]:g} the jump exceeds the amplitude by {excess[-1]:.3f}")
print(f"and the distance from the wave is {distances[-1]:.3f}")

# %%
# The approach is slow: the excess of the jump over the amplitude decreases like 1/t.

fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.8), layout="constrained")
for i in (0, 8, 24, 40):
    left.plot(run.x_cell, run.q[i], label=f"t = {run.time[i]:g}")
left.set_xlabel("x (exchange lengths)")
left.set_ylabel("excess slope q (neutral slopes)")
left.legend()
right.loglog(times, distances, "o", markersize=3, label="distance of q")
right.loglog(times, excess, "s", markersize=3, label="excess of the jump")
right.loglog(times, 1 / np.array(times), "k-", linewidth=0.8, label="1/t")
right.set_xlabel("supplied mass t")
right.set_ylabel("distance from the wave")
right.legend()
plt.show()
