"""Inverse problem: parameters of a case that map the survey before to the survey after.

The method is least squares on heights, in the logarithms of the parameters, because they are positive and the supplied
volume is their product. u(t,x) left of the support never changes, so the heights of both surveys are compared directly.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError, by_last_part, did_you_mean
from hjprofile.problem.case import AnyCase, Case, load_case, resolved_case
from hjprofile.problem.heights import HIGHEST, without_height
from hjprofile.problem.lists import as_numbers
from hjprofile.problem.paths import located
from hjprofile.problem.ranges import number, plain, shown
from hjprofile.problem.units import Units
from hjprofile.solvers.front_tracking import heights_at_end
from hjprofile.solvers.method import Feature, require, requirements
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.run import Array

FRONTS = 1200  # fronts for the heights: on the hillslope their error is 2 cm r.m.s. of 650 m
SLOPE_FRONTS = 400  # fronts for their derivatives: with STEP these differ there by 1 % from those with 1600 fronts
STEP = 3e-3  # central difference in a logarithm: larger ones move kinks past points, smaller ones add noise
RESOLVED = 0.01  # singular values below this fraction of the largest are within the error of the derivatives
WIDEST_HALF = float(np.log(3.0))  # largest half interval of a logarithm, a factor of three; beyond it is nonlinear
IMPROBABLE = 1e-3  # probability below which chi² is reported as too large
SAME = 3e-5  # change of heights, relative to the relief, that is below the error of FRONTS
UNEXPLAINED = 1 / 3  # largest residual of a plausible fit, relative to the change of heights, r.m.s.
ENOUGH = 1e-6  # relative change of chi², or of the parameters, at which a fit stops: hundredths of a standard error
MOST_STEPS = 60
FARTHEST = float(np.log(1e6))  # largest distance of a trial from the starting values, in the logarithm
SECTIONS = "erosion", "profile", "time"
VOLUME = "supplied_volume"
SUPPLIED = "time.supplied"


class Parameter(NamedTuple):
    """A fitted value and its 95 % interval, whose ends are NaN if the surveys do not determine it."""

    name: str
    start: float
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Calibration:
    """The result of a fit; heights and positions in the survey's units if the case has a survey.

    Attributes:
        parameters: the varied ones, in the order of `vary`.
        volume: the supplied volume per unit width, length² critical_slope end; None if the case has no survey, or if
            it was not varied: by one of these three, or by `time.supplied`. A case that states `supplied` holds the
            volume fixed when the length or the critical slope is varied.
        correlation: of the logarithms of the parameters, shape (parameters, parameters).
        x, measured, modelled: the surveyed points on the slope, and the heights of the model there.
        sigma: standard deviation of a measured height: as given, else estimated from the residuals.
        chi2: Σ (modelled - measured)²/sigma²; None if sigma is estimated.
        left_out: number of surveyed points beyond the ends of the slope.
        account: changes of the survey before, or "".
        warnings: a sentence for each parameter that the surveys do not determine, and for each misfit of the model.
        curve: x, height before and height after on a fine grid, shape (3, n), for plots.
        case: the resolved case with the fitted values, ready for TOML; its files by absolute paths.
    """

    title: str
    parameters: Sequence[Parameter]
    volume: Parameter | None
    correlation: Array
    x: Array
    measured: Array
    modelled: Array
    sigma: float
    sigma_given: bool
    chi2: float | None
    left_out: int
    account: str
    warnings: Sequence[str]
    evaluations: int
    wall_seconds: float
    curve: Array
    case: Mapping[str, Any]

    @property
    def rms(self) -> float:
        """The root mean square of the residuals."""
        return float(np.sqrt(np.mean((self.modelled - self.measured) ** 2)))

    @property
    def degrees_of_freedom(self) -> int:
        """The number of points less the number of parameters."""
        return self.x.size - len(self.parameters)


class _Model:
    """Heights after, as a function of the logarithms z of the parameters relative to their starting values."""

    def __init__(self, case: AnyCase, vary: Sequence[str]):
        self.case, self.names = case, plain(vary)
        if not isinstance(self.names, list) or not all(isinstance(name, str) for name in self.names):
            raise InputError(f'vary = {shown(vary)} must be a list of keys, as in ["time.end"]')
        self.first = load_case(case)
        self.path = case if isinstance(case, str | Path) else self.first.source  # for messages
        self.table = _resolved(self.first)
        offered = {
            f"{section}.{key}": value
            for section in SECTIONS
            for key, value in self.table[section].items()
            if isinstance(value, float) and value > 0.0
        }
        units = self.first.problem.profile.units
        if units and self.first.problem.end > 0.0:
            offered[SUPPLIED] = self.first.supplied or units.volume * self.first.problem.end
        for name in self.names:
            if name not in offered:
                hint = did_you_mean(name, by_last_part(offered)) or ";"
                if "," in name:
                    hint = " (--vary once for each);"
                raise InputError(
                    f"{self.path}: {name} cannot be varied{hint} the positive numbers of this case are "
                    f"{', '.join(offered)}"
                )
        if not self.names or len(set(self.names)) < len(self.names):
            raise InputError(f"{self.path}: a fit needs at least one parameter, and each of them only once")
        taken = METHODS["fronts"].supports - {Feature.WHOLE_LINE}
        require(f"{self.path}: a fit, made by fronts,", taken, requirements(self.first.problem, self.first.refresh))
        self.start = np.array([offered[name] for name in self.names])
        self.surveyed = units is not None
        self.units = units or Units(1.0, 1.0, 0.0, 0.0)
        self.evaluations = 0

    def overrides(self, z: Array) -> dict[str, Any]:
        """Return values by dotted key. The left end of the domain retains its position in the survey's units."""
        values: dict[str, Any] = dict(zip(self.names, (self.start * np.exp(z)).tolist(), strict=True))
        left = self.first.grid.left
        if self.surveyed:
            left *= self.units.length / values.get("profile.length", self.units.length)
        return values | {"domain.left": left, "time.snapshots": 1}

    @np.errstate(all="ignore")  # a distant trial may leave the range of numbers, which raises InputError or RunError
    def heights(self, z: Array, x: Array, end: float | None = None, fronts: int = 0) -> Array:
        """Return the heights at x, in the survey's units, at the end or at another time `end`."""
        self.evaluations += 1
        changed = self.overrides(z)
        if end is not None:
            changed.pop(SUPPLIED, None)
            changed["time.end"] = end
        case = load_case(self.case, changed)
        units = case.problem.profile.units or self.units
        place = np.clip(units.place(x), case.grid.left, 0.0)
        return units.height(heights_at_end(case.problem, case.grid.left, place, fronts or FRONTS))

    def before(self, x: Array) -> Array:
        """Return the heights of the case's own profile at x, in the survey's units."""
        place = np.minimum(self.units.place(x), 0.0)
        return self.units.height(place + self.first.problem.profile.W(place, self.first.problem.law))

    def residuals(self, z: Array, x: Array, measured: Array) -> Array:
        """Return modelled less measured heights; infinite if the model has no solution, which reduces the next step."""
        if np.abs(z).max() > FARTHEST:
            return np.full(x.size, np.inf)
        try:
            return self.heights(z, x) - measured
        except (InputError, RunError):
            return np.full(x.size, np.inf)

    def jacobian(self, z: Array, x: Array) -> Array:
        """Return ∂heights/∂z by central differences, shape (points, parameters)."""
        ahead, back = (
            np.stack([self.heights(z + h, x, fronts=SLOPE_FRONTS) for h in sign * STEP * np.eye(z.size)], axis=1)
            for sign in (1.0, -1.0)
        )
        return (ahead - back) / (2.0 * STEP)

    def powers_in_volume(self) -> Array:
        """Return d ln(supplied volume)/dz.

        The volume is length² critical_slope end, unless the case or the fit states the volume itself.
        """
        powers = {"profile.length": 2.0, "profile.critical_slope": 1.0, "time.end": 1.0}
        if SUPPLIED in self.names or (self.first.supplied is not None and "time.end" not in self.names):
            powers = {SUPPLIED: 1.0}
        return np.array([powers.get(name, 0.0) for name in self.names])

    def fitted(self, z: Array) -> dict[str, Any]:
        """Return the resolved case with the fitted values; saved times retain their fractions of the end."""
        table = _resolved(load_case(self.case, self.overrides(z)))
        snapshots, end = self.table["time"]["snapshots"], self.table["time"]["end"]
        if isinstance(snapshots, list):
            snapshots = [t / end * table["time"]["end"] for t in snapshots]
        table["time"]["snapshots"] = snapshots
        for section in ("erosion", "profile"):
            if "file" in table[section]:
                table[section]["file"] = str(located(Path(self.first.source).parent, table[section]["file"]).resolve())
        return table


def _resolved(case: Case) -> dict[str, Any]:
    """Return the resolved case as a table."""
    return resolved_case(case.problem, case.grid, case.method, case.cfl, case.tolerance, case.refresh)


def fit(case: AnyCase, x: Array, height: Array, vary: Sequence[str], sigma: float | None = None) -> Calibration:
    """Fit parameters of a case so that its profile at `time.end` matches the surveyed points (x, height).

    - `case`: a path, the name of a shipped case, the tables of a case file, or a `Case`; its own profile is the survey
      before.
    - `x`, `height`: positions, increasing, and heights of the survey after, shape (points,). They are in the survey's
      units if the profile is a survey, else dimensionless.
    - `vary`: dotted keys of positive numbers of the sections [erosion], [profile] and [time], as in
      "profile.critical_slope". The fit starts from their values in the case.
    - `sigma`: standard deviation of a measured height, in the unit of `height`; by default estimated from the
      residuals.

    Return a `Calibration`. Its intervals are those of the model linearised in the logarithms of the parameters. Raise
    InputError for invalid input, and RunError if the fit does not converge.

    >>> import numpy as np
    >>> import hjprofile as hj
    >>> truth = hj.load_case("travelling_kink", {"time.end": 1.2})
    >>> run = hj.track_fronts(truth.problem, truth.grid)
    >>> x = np.linspace(-6.0, 0.0, 60)
    >>> found = hj.fit("travelling_kink", x, np.interp(x, run.x, run.u[-1]), vary=["time.end"])
    >>> round(found.parameters[0].value, 4)
    1.2
    """
    from scipy.optimize import least_squares
    from scipy.special import chdtrc, ndtri, stdtrit

    sigma = None if sigma is None else number("sigma", sigma)
    started = time.perf_counter()
    model = _Model(case, vary)
    at, measured, fine = _on_the_slope(model, x, height)
    zero = np.zeros(len(model.names))
    model.heights(zero, at)  # raises the error of the case if it cannot be solved
    unit = sigma or 1.0
    found = least_squares(
        lambda z: model.residuals(z, at, measured) / unit, zero, lambda z: model.jacobian(z, at) / unit,
        ftol=ENOUGH, xtol=ENOUGH, max_nfev=MOST_STEPS,
    )  # fmt: skip
    z, residual = found.x, unit * found.fun
    values = model.start * np.exp(z)
    if found.status < 1:
        reached = ", ".join(f"{n} = {v:.6g}" for n, v in zip(model.names, values, strict=True))
        raise RunError(
            f"{model.path}: the fit does not converge in {MOST_STEPS} steps; it has reached {reached}; start nearer to "
            "the solution, or vary fewer parameters"
        )

    freedom = at.size - z.size
    spread = sigma or float(np.sqrt(np.sum(residual**2) / freedom))
    reach = spread * float(ndtri(0.975) if sigma else stdtrit(freedom, 0.975))
    covariance, correlation, blind = _covariance(unit * found.jac, model.names)
    half = reach * np.sqrt(np.diag(covariance))
    hidden = {name for names, _ in blind for name in names}
    warnings = [sentence for _, sentence in blind]
    for i, name in enumerate(model.names):
        if half[i] > WIDEST_HALF and name not in hidden:
            hidden.add(name)
            warnings.append(_undetermined(i, model.names, correlation))
    chi2 = float(np.sum((residual / sigma) ** 2)) if sigma else None
    if chi2 is not None and chdtrc(freedom, chi2) < IMPROBABLE:
        warnings.append(
            f"the model does not fit the survey after within sigma: chi² per degree of freedom is "
            f"{chi2 / freedom:.3g}, but 1 is expected; the intervals are too narrow"
        )
    warnings += _of_two_surveys(model, at, measured, residual, np.size(x) - at.size, sigma)
    parameters = [
        _parameter(name, start, value, np.nan if name in hidden else h)
        for name, start, value, h in zip(model.names, model.start, values, half, strict=True)
    ]
    volume, powers = None, model.powers_in_volume()
    if model.surveyed and powers.any():
        start = model.units.volume * model.first.problem.end
        h = reach * float(np.sqrt(powers @ covariance @ powers))
        known = not hidden.intersection(n for n, power in zip(model.names, powers, strict=True) if power)
        volume = _parameter(VOLUME, start, start * float(np.exp(powers @ z)), h if known else np.nan)
    return Calibration(
        title=model.first.problem.title, parameters=parameters, volume=volume, correlation=correlation,
        x=at, measured=measured, modelled=measured + residual, sigma=spread, sigma_given=sigma is not None, chi2=chi2,
        left_out=np.size(x) - at.size, account=model.first.problem.profile.account, warnings=warnings,
        curve=np.array([fine, model.heights(z, fine, end=0.0), model.heights(z, fine)]), case=model.fitted(z),
        evaluations=model.evaluations, wall_seconds=time.perf_counter() - started,
    )  # fmt: skip


def _on_the_slope(model: _Model, x: Array, height: Array) -> tuple[Array, Array, Array]:
    """Return the points between the ends of the survey before, or of the domain, and a fine x.

    Raise InputError if the points are too few.
    """
    x, height = (v if (v := as_numbers(given)) is not None else np.array(np.nan) for given in (x, height))
    fits = x.ndim == 1 and x.shape == height.shape and np.all(np.abs([x, height]) <= HIGHEST)
    if not (fits and np.all(np.diff(x) > 0)):
        raise InputError("the survey after must be two lists of the same number of finite numbers, x increasing")
    if (none := without_height(x, height)).any():
        i = int(np.argmax(none))
        raise InputError(f"the survey after has {height[i]:g} at x = {x[i]:g}, which is not a measured height; omit it")
    begin = model.first.problem.profile.start() if model.surveyed else model.first.grid.left
    crest = float(model.units.x(0.0))
    toe = crest - float(f"{crest - float(model.units.x(begin)):.9g}")  # without rounding: 0 is printed as 0
    first, last = min(toe, crest), max(toe, crest)
    hair = 1e-9 * (last - first)  # the ends have been divided by the length and multiplied again
    on = (x >= first - hair) & (x <= last + hair)
    if np.count_nonzero(on) <= len(model.names):
        raise InputError(
            f"{model.path}: {np.count_nonzero(on)} of the {x.size} points of the survey after lie on the slope, from "
            f"x = {first:g} to {last:g}; a fit of {len(model.names)} parameters needs at least {len(model.names) + 1}"
        )
    return x[on], height[on], np.linspace(first, last, 1001)


def _of_two_surveys(
    model: _Model, x: Array, measured: Array, residual: Array, beyond: int, sigma: float | None
) -> list[str]:
    """Return warnings if the surveys are equal or do not match. `beyond` is the number of points off the slope."""
    from scipy.special import chdtrc

    warnings = []
    if beyond > x.size:
        warnings.append(
            f"{beyond} of the {beyond + x.size} points of the survey after lie beyond the slope; check that both "
            "surveys have the same location, unit and origin of x"
        )
    change = measured - model.before(x)
    size, rms = (float(np.sqrt(np.mean(v**2))) for v in (change, residual))
    if size <= SAME * np.ptp(measured) or (sigma and chdtrc(x.size, np.sum((change / sigma) ** 2)) >= IMPROBABLE):
        warnings.append(
            f"the surveys do not differ: their difference, {size:.2g} r.m.s., is within "
            + ("sigma" if sigma else "rounding")
            + "; no parameter can be fitted"
        )
    elif rms > UNEXPLAINED * size:
        warnings.append(
            f"the residuals, {rms:.3g} r.m.s., are {rms / size:.0%} of the change between the surveys; check that "
            "both have the same unit, datum and location. If they have, the model does not explain the change"
        )
    return warnings


def _parameter(name: str, start: float, value: float, half: float) -> Parameter:
    """Return a Parameter with its interval in the logarithm."""
    return Parameter(name, float(start), float(value), float(value * np.exp(-half)), float(value * np.exp(half)))


def _covariance(jacobian: Array, names: Sequence[str]) -> tuple[Array, Array, list[tuple[set[str], str]]]:
    """Return (JᵀJ)⁻¹, its correlations, and the parameters that the heights do not determine, with a sentence each."""
    norms = np.sqrt(np.sum(jacobian**2, axis=0))
    blind = [
        ({n}, f"{n} has no effect on the surveyed heights near its value")
        for n, s in zip(names, norms, strict=True)
        if s == 0.0
    ]
    scale = np.where(norms > 0.0, norms, 1.0)
    _, singular, rows = np.linalg.svd(jacobian / scale, full_matrices=False)
    for row in rows[singular < RESOLVED * singular[0]]:
        i, j = sorted(np.argsort(np.abs(row))[-2:])
        involved = {n for n, v in zip(names, row, strict=True) if abs(v) > 0.1}
        if len(involved) == 1:  # it has no effect, which is reported above
            continue
        blind.append(
            (involved, f"{names[i]} and {names[j]} cannot be distinguished by these surveys, because a change of "
             "one compensates that of the other; fix one of them")
        )  # fmt: skip
    floor = np.maximum(singular, 1e-12)
    inverse = (rows.T / floor**2) @ rows
    spread = np.sqrt(np.diag(inverse))
    return inverse / np.outer(scale, scale), inverse / np.outer(spread, spread), blind


def _undetermined(i: int, names: Sequence[str], correlation: Array) -> str:
    """Return a sentence on a parameter whose interval is too wide, with the parameter that correlates with it."""
    sentence = f"{names[i]} is not determined by these surveys: its interval exceeds a factor of three"
    others = np.abs(correlation[i])
    others[i] = 0.0
    j = int(np.argmax(others))
    if others[j] > 0.9:
        sentence += f"; {names[j]} can replace it (correlation {correlation[i, j]:.3f})"
    return sentence
