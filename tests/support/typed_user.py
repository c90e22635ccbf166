"""What a user writes, for `mypy --strict`: the public names have types that a checker can follow. Nothing runs it."""

from typing import assert_type

import numpy as np

import hjprofile as hj

laws = [hj.rational(), hj.log(), hj.power(2.0), hj.expression("q/(1+q)"), hj.erosion_law(lambda q: q / (1 + q))]
profiles = [
    hj.kinks(positions=[-7.0, -5.0], amplitudes=[0.4, 1.2]),
    hj.bumps([1.0], [-2.0], [0.5]),
    hj.steps([-2.0, -1.0], [1.0]),
    hj.points([-2.0, -1.0], [1.0, 0.0]),
    hj.profile(lambda x: 1.1 * x),
]
problem = hj.Problem(laws[0], profiles[0], end=8.0, coefficient=hj.coefficient("1 + 0.1*x"))
grid = hj.Grid(left=-10.0, cells=2000)

run = hj.solve_hj(problem, grid, method="godunov", cfl=0.5)
assert_type(run, hj.Run)
assert_type(hj.compare(run, hj.solve_conservative(problem, grid)), hj.Comparison)
runs = [hj.track_fronts(problem, grid, fronts=100), hj.solve_characteristics(problem, grid, 1e-8)]
assert_type(runs[0].status, str)
assert_type(hj.solve(problem, tolerance=1e-6).error_estimate, float | None)
for event in run.events:
    print(event.time + 1.0, event.event.upper())
if run.units:
    print(run.units.x(run.x), run.units.volume + 1.0)
print(run.to_xarray().u.isel(time=0))

case = hj.load_case("two_kinks")
assert_type(case, hj.Case)
assert_type(hj.check(case).passes, bool)
hj.write_run(hj.solve_case(case), "results")
assert_type(hj.load_run("results"), hj.Run)
assert_type(hj.fit("hillslope", np.zeros(3), np.zeros(3), ["time.end"]), hj.Calibration)
print(hj.sweep("two_kinks", {"time.end": [1.0, 2.0]}).quantity("crest_lowering").max())
assert_type(hj.observed_order([1.0, 2.0], [0.5, 0.25]), float)


def low(t: float, state: hj.Snapshot) -> bool:
    return bool(state.u[-1] < 2.0 and t > 1.0)


stopped = hj.solve_hj(problem, grid, callback=low)
hj.track_fronts(problem, callback=hj.until_kinks(1))
more = hj.Problem(hj.log(), stopped.restart(), end=1.0)
print(stopped.at(0.5).q.max(), stopped.sample([-2.0, -1.0]).u.shape, more.profile)
stopped.plot()
hj.plot(stopped, kind="flux")
hj.plot_comparison(runs[0], runs[1]).savefig("apart.png")
assert_type(hj.chart({"erosion": {"law": "rational"}}), hj.Chart)
hj.write_study([hj.check(case)], "results/check")
made = hj.import_survey("gps.txt", length=4.0, uphill="left")
hj.solve_case(made.case)
form = hj.exact(problem)
if form is not None:
    print(form.u(1.0, grid.nodes))
