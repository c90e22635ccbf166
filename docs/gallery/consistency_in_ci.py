"""
What does a failed consistency test look like?
==============================================

``hj.check`` solves a case by the equation for the height and by the conservation law for
the slope, and compares the two. One line in a test suite is sufficient. This example tests
an erosion law whose derivative f' is given as well: first the correct one, then one with a
missing square.
"""

import matplotlib.pyplot as plt
import numpy as np

import hjprofile as hj


def f(q):
    return q / (1 + q)


derivatives = {"correct": lambda q: 1 / (1 + q) ** 2, "mistake": lambda q: 1 / (1 + q)}
grid = hj.Grid(left=-6.0, cells=400)
cases = {}
for name, derivative in derivatives.items():
    law = hj.erosion_law(f, derivative=derivative)
    problem = hj.Problem(law, hj.bumps([0.5], [-3.0], [0.6]), end=0.5, snapshots=6)
    cases[name] = hj.Case(name, "this script", problem, grid)

# %%
# A test in a test suite consists of the statement ``assert hj.check(case)``. If it fails,
# pytest shows the failed comparisons. Here their names are printed.

for name, case in cases.items():
    found = hj.check(case)
    failed = [comparison.name for comparison in found.comparisons if not comparison.passes]
    print(f"{name}: {found.verdict}; {len(failed)} of {len(found.comparisons)} fail")
    for comparison in failed:
        print(f"    {comparison}")

# %%
# With the mistake, the saved grain flux K does not agree with the law (``saved-K``). Yet no
# run fails, and the two solutions look the same. Their difference shows the mistake.

fig, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 6), layout="constrained")
differences = {}
for name, case in cases.items():
    from_height = hj.solve_hj(case.problem, grid, method="weno5").q[-1]
    from_slope = hj.solve_conservative(case.problem, grid).q[-1]
    differences[name] = from_height - from_slope
    bottom.plot(grid.centres, differences[name], label=name)
    print(f"{name}: largest difference of q {np.abs(differences[name]).max():.4f}")
top.plot(grid.centres, from_height, label="equation for the height")
top.plot(grid.centres, from_slope, "--", label="conservation law")
top.set_title("both solutions, with the mistake")
top.set_ylabel("excess slope q (neutral slopes)")
top.legend(loc="upper left")
bottom.set_title("difference of the two solutions")
bottom.set_xlabel("x (exchange lengths; crest at 0)")
bottom.set_ylabel("difference of q (neutral slopes)")
bottom.legend()
plt.show()
