"""
How does an erosion law of your own change the slope?
=====================================================

An erosion law f(q) gives the erosion rate per unit grain flux at the excess slope q. Here f
is a Python function that grows like the square root of q on steep slopes. It is compared
with the rational law q/(1 + q), which is bounded by 1. Both laws have the derivative 1 at
q = 0, so they differ only where the ground is much steeper or gentler than the neutral
slope.
"""

import matplotlib.pyplot as plt
import numpy as np

import hjprofile as hj


def square_root(q):
    """Return the erosion rate; q is an array of excess slopes above -1."""
    return np.sqrt(1 + q) - 1 / np.sqrt(1 + q)


laws = {"rational law": hj.rational(), "own law": hj.erosion_law(square_root)}

# %%
# The same profile, a smooth rise, is solved with both laws to the same tolerance.

profile = hj.bumps(amplitudes=[1.5], centres=[-4.0], widths=[0.7])
runs = {}
for name, law in laws.items():
    run = hj.solve(hj.Problem(law, profile, end=2.0), tolerance=1e-6)
    kink = run.kinks_at(-1)[0]
    print(f"{name}: eroded volume {run.eroded_volume:.4f}, kink at x = {kink.x:.3f}")
    runs[name] = run

# %%
# The own law erodes more, because the rise is steep. Its kink, at which the slope steepens
# abruptly, has moved further uphill. The colours are the same in both panels.

fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.8), layout="constrained")
q = np.linspace(-0.8, 4.0, 200)
for name, law in laws.items():
    left.plot(q, law(q), label=name)
left.set_title("erosion laws")
left.set_xlabel("excess slope q (neutral slopes)")
left.set_ylabel("erosion rate per unit grain flux, f(q)")
left.legend()

start = runs["own law"]
right.plot(start.x, start.u[0] - start.x, "k:", label="t = 0")
for run in runs.values():
    right.plot(run.x, run.u[-1] - run.x)
right.set_title("profile at t = 0 and at t = 2")
right.set_xlabel("x (exchange lengths; crest at 0)")
right.set_ylabel("height above the neutral slope, u - x")
right.legend(loc="upper left")
plt.show()
