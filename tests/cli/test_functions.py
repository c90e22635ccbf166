"""Every command has its function in Python, and both return the same."""

import csv
from pathlib import Path

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.closed_forms import closed_form
from hjprofile.studies import dependence, stability


@pytest.fixture
def small(monkeypatch):
    """Studies of a fraction of a second."""
    for name, values in (
        ("CELLS", 60), ("STEPS", 100), ("CFL", (0.5, 1.0, 2.0)), ("VISCOSITY", (0.5, 1.0)), ("VISCOSITY_AT", (0.45,)),
        ("SMALLEST", (0.1,)), ("EXPONENTS", (1.0,)), ("REFRESH", (1,)), ("BISECTIONS", 1), ("CUTS", (0.1,)),
    ):  # fmt: skip
        monkeypatch.setattr(stability, name, values)
    for name, value in (("PAIRS", 1), ("CELLS", 80), ("WAVES", 1)):
        monkeypatch.setattr(dependence, name, value)


def test_stability(small, in_tmp, call):
    code, out, _ = call("stability", "travelling_kink", "--out", "there")
    found = hj.stability("travelling_kink")
    assert code == 0 and out.startswith(f"{found}\n")
    rows = list(csv.reader(Path("there/stability.csv").read_text().splitlines()))[1:]
    assert [row[1:3] + row[4:5] for row in rows] == [[t.method, t.parameter, t.outcome] for t in found.rows]
    low, high, proved = found.limits["godunov"]
    assert low < high and proved == 1.0


def test_dependence(small, in_tmp, call):
    case = hj.load_case("two_kinks")
    found = hj.dependence(case.problem, case.grid, name=case.name)
    code, out, _ = call("dependence", "two_kinks", "--out", "there")
    assert code == 0 and found.holds and all(line in out for line in str(found).splitlines())
    rows = list(csv.reader(Path("there/dependence.csv").read_text().splitlines()))[1:]
    assert [[row[1], float(row[5])] for row in rows] == [[d.study, d.distance] for d in found.rows]
    (titles,) = {d.case for d in hj.dependence(case.problem, case.grid).rows}
    assert titles == case.problem.title


def test_exact_is_none_where_no_closed_form_is_known():
    law, kink = hj.rational(), hj.kinks([-2.0], [0.8])
    form = hj.exact(hj.Problem(law, kink, end=1.0))
    exact = hj.track_fronts(hj.Problem(law, kink, end=1.0), hj.Grid(-3.0, 60), fronts=1600)
    assert np.abs(form.u(1.0, exact.x) - exact.u[-1]).max() < 1e-5  # the error of these fronts is 1e-6
    layer, given = (
        hj.Problem(law, kink, 1.0, supply_flux=0.1),
        hj.Problem(law, kink, 1.0, coefficient=hj.coefficient("1 - x")),
    )
    assert closed_form(layer) is not None  # that of slow erosion, which it does not follow
    assert hj.exact(layer) is None and hj.exact(given) is None
    assert hj.exact(hj.Problem(law, hj.steady(0.4), 1.0)).kink(0.5) != 0.0
    with pytest.raises(hj.InputError, match="must be of the type Problem"):
        hj.exact(kink)


def test_explain(call):
    text = hj.explain("A folder of another case")
    assert call("explain", "a-folder-of-another-case")[1] == f"A folder of another case\n\n{text}\n"
    for wrong in ("nonsense", 3):
        with pytest.raises(hj.InputError, match="heading"):
            hj.explain(wrong)
