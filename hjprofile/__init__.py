"""hjprofile: slow erosion of granular slopes, a nonlocal Hamilton-Jacobi equation with its cross-checks.

u_t + K f(u_x - 1) = 0,  x <= 0,     K(t,x) = exp ∫_x^0 f(u_x - 1) dξ
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from hjprofile.error_page import explain as explain
    from hjprofile.errors import InputError as InputError
    from hjprofile.errors import RunError as RunError
    from hjprofile.output.plots.animation import animate as animate
    from hjprofile.output.plots.comparison import plot_comparison as plot_comparison
    from hjprofile.output.plots.user_axes import plot as plot
    from hjprofile.output.store import load_run as load_run
    from hjprofile.output.store import write_run as write_run
    from hjprofile.output.study_files import write_study as write_study
    from hjprofile.output.sweep_results import sweep as sweep
    from hjprofile.output.vtk import export_vtk as export_vtk
    from hjprofile.problem import Problem as Problem
    from hjprofile.problem.case import Case as Case
    from hjprofile.problem.case import load_case as load_case
    from hjprofile.problem.case_files import shipped_cases as shipped_cases
    from hjprofile.problem.coefficient import Coefficient as Coefficient
    from hjprofile.problem.coefficient import coefficient as coefficient
    from hjprofile.problem.coefficient import stored_coefficient as stored_coefficient
    from hjprofile.problem.erosion import ErosionLaw as ErosionLaw
    from hjprofile.problem.erosion import erosion_law as erosion_law
    from hjprofile.problem.erosion import expression as expression
    from hjprofile.problem.erosion import log as log
    from hjprofile.problem.erosion import power as power
    from hjprofile.problem.erosion import rational as rational
    from hjprofile.problem.given import profile as profile
    from hjprofile.problem.grid import Grid as Grid
    from hjprofile.problem.new_case import new_case as new_case
    from hjprofile.problem.profile_base import Profile as Profile
    from hjprofile.problem.profiles import bumps as bumps
    from hjprofile.problem.profiles import kinks as kinks
    from hjprofile.problem.profiles import points as points
    from hjprofile.problem.profiles import steady as steady
    from hjprofile.problem.profiles import steps as steps
    from hjprofile.problem.survey import read_survey as read_survey
    from hjprofile.problem.survey import survey as survey
    from hjprofile.problem.survey_import import import_survey as import_survey
    from hjprofile.solvers.closed_forms import exact as exact
    from hjprofile.solvers.criteria import until_eroded as until_eroded
    from hjprofile.solvers.criteria import until_kinks as until_kinks
    from hjprofile.solvers.criteria import until_steady as until_steady
    from hjprofile.solvers.method_table import methods as methods
    from hjprofile.solvers.run import Run as Run
    from hjprofile.solvers.solve import solve as solve
    from hjprofile.solvers.solve import solve_case as solve_case
    from hjprofile.solvers.solve import solve_characteristics as solve_characteristics
    from hjprofile.solvers.solve import solve_conservative as solve_conservative
    from hjprofile.solvers.solve import solve_hj as solve_hj
    from hjprofile.solvers.solve import solve_inverse as solve_inverse
    from hjprofile.solvers.solve import track_fronts as track_fronts
    from hjprofile.solvers.states import Snapshot as Snapshot
    from hjprofile.studies.accuracy import Comparison as Comparison
    from hjprofile.studies.accuracy import compare as compare
    from hjprofile.studies.accuracy import observed_order as observed_order
    from hjprofile.studies.calibration import Calibration as Calibration
    from hjprofile.studies.calibration import fit as fit
    from hjprofile.studies.chart import Chart as Chart
    from hjprofile.studies.chart import chart as chart
    from hjprofile.studies.consistency import check as check
    from hjprofile.studies.consistency import check_consistency as check_consistency
    from hjprofile.studies.dependence import Dependence as Dependence
    from hjprofile.studies.dependence import dependence as dependence
    from hjprofile.studies.slow_erosion import slow_erosion as slow_erosion
    from hjprofile.studies.stability import Stability as Stability
    from hjprofile.studies.stability import stability as stability
    from hjprofile.studies.statements import Statements as Statements
    from hjprofile.studies.statements import statements as statements
    from hjprofile.studies.verdict import Consistency as Consistency

_MODULES = {
    "error_page": ("explain",),
    "errors": ("InputError", "RunError"),
    "studies.accuracy": ("Comparison", "compare", "observed_order"),
    "studies.calibration": ("Calibration", "fit"),
    "studies.chart": ("Chart", "chart"),
    "studies.consistency": ("check", "check_consistency"),
    "studies.dependence": ("Dependence", "dependence"),
    "studies.slow_erosion": ("slow_erosion",),
    "studies.stability": ("Stability", "stability"),
    "studies.statements": ("Statements", "statements"),
    "studies.verdict": ("Consistency",),
    "output.plots.animation": ("animate",),
    "output.plots.comparison": ("plot_comparison",),
    "output.plots.user_axes": ("plot",),
    "output.store": ("load_run", "write_run"),
    "output.study_files": ("write_study",),
    "output.sweep_results": ("sweep",),
    "output.vtk": ("export_vtk",),
    "problem": ("Problem",),
    "problem.case": ("Case", "load_case"),
    "problem.case_files": ("shipped_cases",),
    "problem.new_case": ("new_case",),
    "problem.coefficient": ("Coefficient", "coefficient", "stored_coefficient"),
    "problem.erosion": ("ErosionLaw", "erosion_law", "expression", "log", "power", "rational"),
    "problem.grid": ("Grid",),
    "problem.given": ("profile",),
    "problem.profile_base": ("Profile",),
    "problem.profiles": ("bumps", "kinks", "points", "steady", "steps"),
    "problem.survey": ("read_survey", "survey"),
    "problem.survey_import": ("import_survey",),
    "solvers.closed_forms": ("exact",),
    "solvers.criteria": ("until_eroded", "until_kinks", "until_steady"),
    "solvers.method_table": ("methods",),
    "solvers.run": ("Run",),
    "solvers.states": ("Snapshot",),
    "solvers.solve": (
        "solve", "solve_case", "solve_characteristics", "solve_conservative", "solve_hj", "solve_inverse",
        "track_fronts",
    ),
}  # fmt: skip
_HOME = {name: f"hjprofile.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used. `hjprofile --help` needs none of them."""
    if name not in _HOME:
        raise AttributeError(f"module 'hjprofile' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
