"""The methods by what they can do, their schemes, and methods with a fault built in."""

from dataclasses import replace

from hjprofile.solvers import methods
from hjprofile.solvers.grids.setup import Setup
from hjprofile.solvers.method import Feature, Form
from hjprofile.solvers.methods import FLUXES, METHODS, named
from hjprofile.solvers.solve import solve_with

HJ_METHODS, CONSERVATIVE_METHODS = named(Form.HEIGHT), named(Form.SLOPE)
GRID_METHODS = (*HJ_METHODS, *CONSERVATIVE_METHODS)
(LAYER_METHOD,) = (name for name, method in METHODS.items() if Feature.LAYER in method.supports)
CARRY_STEPS = [name for name, method in METHODS.items() if Feature.LINEAR_GROWTH in method.supports]
TWINS = {name: flux.twin for name, flux in FLUXES.items()}


def solve_by(problem, grid, method, **options):
    """A run of a method on a grid, by its name."""
    return solve_with(METHODS[method], problem, grid, **options)


def scheme_of(problem, grid, method):
    """Its scheme, set up with the problem's profile."""
    return METHODS[method].setup_for(problem).scheme(problem, grid, None)


def with_fault(monkeypatch, name, **changes):
    """Builds changes of its flux into a method on a grid."""
    method = METHODS[name]
    flux = replace(method.flux, **changes)
    height = method.form is Form.HEIGHT
    make = methods._for_height(methods.HamiltonJacobi, flux) if height else methods._for_slope(methods.FirstOrder, flux)
    monkeypatch.setitem(methods._TABLE, name, replace(method, flux=flux, setup=Setup(make, method.setup.guarantees)))
