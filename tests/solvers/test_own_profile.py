"""A profile of a class of the user, with every solver, against the same slope from the package."""

import numpy as np
import pytest

import hjprofile as hj

GRID = hj.Grid(left=-8.0, cells=200)


class Tent(hj.Profile):
    """q rises from 0 at a to h at b, jumps back to 0 there: the same as points."""

    def __init__(self, a, b, h):
        self.a, self.b, self.h = a, b, h

    def W(self, x, law):
        s = np.clip(x, self.a, self.b) - self.a
        return 0.5 * self.h * s**2 / (self.b - self.a)

    def start(self, tail=1e-6):
        return self.a

    def excess(self, x, law):
        return np.where((x < self.a) | (x > self.b), 0.0, self.h * (x - self.a) / (self.b - self.a))

    def breaks(self, law):
        return np.array([[self.a, 0.0, 0.0], [self.b, self.h, 0.0]])

    def marks(self):
        return np.array([self.a, self.b])


OWN, SAME = Tent(-5.0, -3.0, 1.5), hj.points([-5.0, -3.0], [0.0, 1.5])
SOLVERS = {
    "hj": lambda p, grid: hj.solve_hj(p, grid),
    "conservative": lambda p, grid: hj.solve_conservative(p, grid),
    "fronts": lambda p, grid: hj.track_fronts(p, grid, fronts=400),
    "characteristics": lambda p, grid: hj.solve_characteristics(p, grid, 1e-8),
    "inverse": lambda p, grid: hj.solve_inverse(p, grid, 400),
    "auto": lambda p, grid: hj.solve(p, 1e-3, grid),
}


@pytest.mark.parametrize("law", [hj.rational(), hj.expression("4*q/(1+q)")], ids=["rational", "other units"])
@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_accepts_it(name, law):
    """f'(0) = 4 makes the exact methods compute in other units."""
    end = 1.0 / float(law.derivative(0.0))
    own, same = (SOLVERS[name](hj.Problem(law, slope, end, 3), GRID) for slope in (OWN, SAME))
    assert own.done
    # equal data, but auto and fronts may divide them differently
    assert np.abs(own.u - same.u).max() < (1e-3 if name == "auto" else 1e-8)
    assert own.case["profile"] == {"kind": "python", "file": __name__, "function": "Tent"}


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "characteristics"])
def test_windows_of_the_whole_line(name):
    grid = hj.Grid(left=-8.0, cells=200, right=2.0)
    own, same = (SOLVERS[name](hj.Problem(hj.rational(), slope, 0.5, 3, line="whole"), grid) for slope in (OWN, SAME))
    assert np.abs(own.u - same.u).max() < (1e-3 if name == "auto" else 1e-8)


def test_it_is_stored_and_read(tmp_path):
    run = hj.solve_hj(hj.Problem(hj.rational(), OWN, 0.5, 3), GRID)
    hj.write_run(run, tmp_path / "run", vtk=False, plots=False)
    assert np.array_equal(hj.load_run(tmp_path / "run").u, run.u)
    assert repr(OWN) == "Tent()"


def test_it_is_checked():
    with pytest.raises(hj.InputError, match="left must be at most"):
        hj.solve_hj(hj.Problem(hj.rational(), OWN, 0.5), hj.Grid(-4.0, 40))
    with pytest.raises(hj.InputError, match="does not rise"):
        hj.solve_hj(hj.Problem(hj.rational(), Tent(-5.0, -3.0, -1.5), 0.5), GRID)


class Wrong(Tent):
    """A tent with a mistake in one part; `mistake` is the factor of `excess`, or of one side of the jump."""

    def __init__(self, mistake, part):
        super().__init__(-5.0, -3.0, 1.5)
        self.mistake, self.part = mistake, part

    def excess(self, x, law):
        return super().excess(x, law) * (self.mistake if self.part == "excess" else 1.0)

    def breaks(self, law):
        rows = super().breaks(law)
        if self.part == "breaks":
            rows[1, 1] *= self.mistake
        return rows


@pytest.mark.parametrize("part", ["excess", "breaks"])
@pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)
def test_parts_that_contradict_each_other(solver, part):
    """Half, twice, or 5 % more than the slope of W: fronts would solve one profile, and grids another."""
    for mistake in (0.5, 2.0, 1.05):
        problem = hj.Problem(hj.rational(), Wrong(mistake, part), 0.5, 3)
        with pytest.raises(hj.InputError, match=rf"contradict each other near x = -[345]\S*: {part} gives q = "):
            solver(problem, GRID)


def test_parts_that_agree_are_accepted_at_any_scale():
    """Also where the steps of the test do not resolve W."""
    for width in (2.0, 1e-2, 1e-4, 1e-6, 1e-9):
        hj.Problem(hj.rational(), Tent(-3.0 - width, -3.0, 1.5), 0.5, 3).check(GRID)
