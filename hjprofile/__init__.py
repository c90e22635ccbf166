"""hjprofile: slow erosion of granular slopes, a nonlocal Hamilton-Jacobi equation with its cross-checks.

    u_t + K f(u_x - 1) = 0,  x <= 0,     K(t,x) = exp ∫_x^0 f(u_x - 1) dξ
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from hjprofile.problem import Problem as Problem
    from hjprofile.problem.case import Case as Case
    from hjprofile.problem.case import load_case as load_case
    from hjprofile.problem.case import shipped_cases as shipped_cases
    from hjprofile.problem.erosion import ErosionLaw as ErosionLaw
    from hjprofile.problem.erosion import expression as expression
    from hjprofile.problem.erosion import from_function as erosion_law
    from hjprofile.problem.erosion import log as log
    from hjprofile.problem.erosion import power as power
    from hjprofile.problem.erosion import rational as rational
    from hjprofile.problem.errors import InputError as InputError
    from hjprofile.problem.errors import RunError as RunError
    from hjprofile.problem.grid import Grid as Grid
    from hjprofile.problem.profiles import bumps as bumps
    from hjprofile.problem.profiles import from_function as profile
    from hjprofile.problem.profiles import kinks as kinks
    from hjprofile.problem.profiles import points as points
    from hjprofile.problem.profiles import steady as steady
    from hjprofile.problem.profiles import steps as steps
    from hjprofile.problem.profiles import survey as survey
    from hjprofile.solvers.methods import solve_case as solve_case
    from hjprofile.solvers.methods import solve_conservative as solve_conservative
    from hjprofile.solvers.methods import solve_hj as solve_hj
    from hjprofile.solvers.run import Run as Run

# name -> module, and the name there where it differs: nothing is imported before it is asked for
_PUBLIC: dict[str, tuple[str, str]] = {
    "Problem": ("hjprofile.problem", "Problem"),
    "Case": ("hjprofile.problem.case", "Case"),
    "load_case": ("hjprofile.problem.case", "load_case"),
    "shipped_cases": ("hjprofile.problem.case", "shipped_cases"),
    "ErosionLaw": ("hjprofile.problem.erosion", "ErosionLaw"),
    "rational": ("hjprofile.problem.erosion", "rational"),
    "log": ("hjprofile.problem.erosion", "log"),
    "power": ("hjprofile.problem.erosion", "power"),
    "expression": ("hjprofile.problem.erosion", "expression"),
    "erosion_law": ("hjprofile.problem.erosion", "from_function"),
    "InputError": ("hjprofile.problem.errors", "InputError"),
    "RunError": ("hjprofile.problem.errors", "RunError"),
    "Grid": ("hjprofile.problem.grid", "Grid"),
    "kinks": ("hjprofile.problem.profiles", "kinks"),
    "bumps": ("hjprofile.problem.profiles", "bumps"),
    "points": ("hjprofile.problem.profiles", "points"),
    "steps": ("hjprofile.problem.profiles", "steps"),
    "steady": ("hjprofile.problem.profiles", "steady"),
    "survey": ("hjprofile.problem.profiles", "survey"),
    "profile": ("hjprofile.problem.profiles", "from_function"),
    "Run": ("hjprofile.solvers.run", "Run"),
    "solve_hj": ("hjprofile.solvers.methods", "solve_hj"),
    "solve_conservative": ("hjprofile.solvers.methods", "solve_conservative"),
    "solve_case": ("hjprofile.solvers.methods", "solve_case"),
}

__all__ = [*_PUBLIC, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        module, attribute = _PUBLIC[name]
        return getattr(import_module(module), attribute)
    raise AttributeError(f"module 'hjprofile' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
