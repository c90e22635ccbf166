"""Monitor of the a-priori bounds and budgets that every run must satisfy (§1 and §6)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import blocks
from hjprofile.solvers.grids.kernels import watch
from hjprofile.solvers.norms import invariant_variation
from hjprofile.solvers.run import Array, Halt, State, Verdict

ROUNDOFF = 1e-10  # relative rounding error; 1e5 steps sum errors of 1e-16 each, in the worst case all of one sign
HALO = 2  # cells beyond a block whose values its nodes need after a step
EXACT, FIRST_ORDER = "rounding", "first order in dx"  # accuracy to which a method satisfies a bound

# Accuracy to which a method satisfies each bound, None if it is not guaranteed. The first mapping is for monotone
# schemes in conservation form. A local viscosity depends on q, so the scheme is not monotone. Schemes of higher order
# are not monotone either.
Guarantees = Mapping[str, str | None]
MONOTONE: Guarantees = MappingProxyType(
    {
        "mass_budget": EXACT,
        "volume_budget": FIRST_ORDER,
        "minimum_principle": EXACT,
        "signs": EXACT,
        "l1_decay": EXACT,
        "factor_bounds": EXACT,
        "upper_bound": EXACT,
        "tv_growth": FIRST_ORDER,
        "uniform_tv": FIRST_ORDER,
        "flux_maximum": EXACT,
        "flux_variation": EXACT,
        "kruzkov": EXACT,
    }
)
TELESCOPING: Guarantees = MappingProxyType({**MONOTONE, "volume_budget": EXACT})
# a law of linear growth (§11): q and its variation are unbounded, and I does not determine q in a vertical step
STEEP: Guarantees = MappingProxyType({**TELESCOPING, **dict.fromkeys(("upper_bound", "tv_growth", "uniform_tv"))})
STEEP_SECOND_ORDER: Guarantees = MappingProxyType(
    {name: accuracy and FIRST_ORDER for name, accuracy in STEEP.items()}
    | {"mass_budget": EXACT, "volume_budget": EXACT}
    | dict.fromkeys(("flux_maximum", "flux_variation", "kruzkov"))
)
LOCAL: Guarantees = MappingProxyType(
    {**MONOTONE, **dict.fromkeys(("flux_maximum", "flux_variation", "kruzkov"))},
)
HIGHER_ORDER: Guarantees = MappingProxyType(
    {name: accuracy and FIRST_ORDER for name, accuracy in LOCAL.items()} | {"mass_budget": EXACT}
)
# Nothing limits the overshoots of weno5 at a kink. Measured on 1000 random profiles: up to 2.7 times the allowance.
UNLIMITED: Guarantees = MappingProxyType({**HIGHER_ORDER, "uniform_tv": None})
# Bounds for any K. The others use the definition of K by q. With a frozen K they hold to first order in the refresh
# interval, with an unknown constant.
FOR_ANY_FACTOR = ("mass_budget", "signs", "l1_decay", "flux_maximum", "flux_variation", "kruzkov")
# K of the 2x2 model is not K of q, and q < 0 may decrease; with H > 0 slopes are still transported
WITH_LAYER: Guarantees = MappingProxyType(dict.fromkeys(("mass_budget", "volume_budget", "signs", "l1_decay"), EXACT))
STOPPING = ("mass_budget", "volume_budget")  # if a method satisfies them to rounding, a violation stops the run


class BoundsMonitor:
    """Worst margin of each bound that a method guarantees, with its time and position.

    With q(0) the data, q⁺ and q⁻ their positive and negative parts:

    - mass_budget: ∫q changes by the inflow less the lowering of the crest.
    - volume_budget: the eroded volume is ∫(K(left) - 1) dt (§5g): to rounding if the flux telescopes, else within dx ∫∫
      (K f² + max(K f') |q_x|) dx dt, the first-order difference between Σ F dx and K(left) - 1.
    - minimum_principle: q >= min(inf q(0), 0).
    - signs: q of one sign at t = 0 retains its sign.
    - l1_decay: ‖q‖₁ does not increase.
    - factor_bounds: -f'(inf q(0)) ‖q⁻‖₁ <= ln K <= f'(0) ‖q⁺‖₁; the margin is the unused fraction.
    - upper_bound: q/f(q) <= sup(q(0)/f(q(0)) + W(0)) + ‖q⁻‖₁ (3.16); the margin is the unused fraction of the excess
      over 1/f'(0).
    - tv_growth: TV(q) grows by ∫ TV(K f²) dt at most; the margin is the unused fraction.
    - uniform_tv: TV(I), I = W + R(q), is never larger than at t = 0 (§4). On a grid both are known to dx TV(q).
    - flux_maximum, flux_variation, kruzkov: with K frozen at a state, a step of the method's own length does not raise
      sup|F| or TV(F) [decay_sup_flux, decay_tv_flux], and it preserves the order of states, which is Kružkov's
      inequality: |H(q) - H(α)| <= H(max(q, α)) - H(min(q, α)) for the step H and a constant α. With a coefficient that
      does not depend on t, neither may grow over the whole run (except for lax-friedrichs, whose viscosity changes).

    With a prescribed coefficient, and with a frozen K, only FOR_ANY_FACTOR are monitored. Bounds that hold to first
    order have an additional allowance of dx TV(q). With an inflow only the budgets and the smallest q are monitored.

    Raises:
        Halt: if one of STOPPING is satisfied to rounding by the method and violated; with `strict` if any is violated.
    """

    STEPS, SHARE = 1024, 1 / 8  # between two observations: steps, or fraction of the run
    FROZEN_STEPS = 16384
    checkpoint_fields: tuple[str, ...] = (
        "worst", "t", "steps_observed", "steps_frozen", "rate", "budget_error", "budget_allowance", "norm",
        "growth_allowed", "eroded_volume", "toe_outflow", "crest_lowering", "tv_source", "first_volume", "flux_seen",
    )  # fmt: skip

    def __init__(
        self, problem: Problem, grid: Grid, W: Array, guarantees: Guarantees,
        flux: Flux | None = None, strict: bool = False, refresh: float | None = None,
    ):  # fmt: skip
        law, inflow, coefficient = problem.law, problem.profile.inflow, problem.coefficient
        self.law, self.grid, self.inflow, self.flux, self.strict = law, grid, inflow, flux, strict
        self.pause = self.SHARE * problem.end
        q, dx = np.diff(W) / grid.dx, grid.dx
        self.mass, self.norm = float(W[-1] - W[0]), dx * float(np.abs(q).sum())
        self.scale = self.norm + 1.0
        plus, minus = 0.5 * (self.norm + self.mass), 0.5 * (self.norm - self.mass)
        self.floor, top = min(float(q.min()), 0.0), max(float(q.max()), 0.0)
        self.variation = float(np.abs(np.diff(q)).sum()) + (0.0 if inflow else abs(float(q[0])))
        self.R0 = float(law.R(0.0))
        self.sign = 1.0 if self.floor == 0.0 else -1.0 if top == 0.0 else 0.0
        lasting = {"mass_budget", "volume_budget", "minimum_principle"}
        known = guarantees if coefficient is None and refresh is None else FOR_ANY_FACTOR
        self.guarantees = {
            name: accuracy for name, accuracy in guarantees.items()
            if accuracy and name in known and (not inflow or name in lasting) and (self.sign or name != "signs")
            and (flux or name not in ("flux_maximum", "flux_variation", "kruzkov"))
        }  # fmt: skip
        if not inflow:
            R = np.empty(q.size)
            with np.errstate(all="ignore"):
                for a, b in blocks(q.size):
                    R[a:b] = law.R(q[a:b])
                self.highest = float(np.max(R + np.maximum(W[1:], W[:-1]) - W[0])) + minus - self.R0
            self.variation_I = invariant_variation(R, W, self.R0)
            self.ln_K_bound_above = float(law.derivative(0.0)) * plus
            self.ln_K_bound_below = float(law.derivative(self.floor)) * minus
        self.worst = np.tile([np.inf, np.nan, np.nan], (len(self.guarantees), 1))  # margin, time, x
        self.first_volume = np.nan
        self.eroded_volume = self.toe_outflow = self.crest_lowering = self.budget_allowance = 0.0
        self.budget_error = 0.0 if coefficient is None else np.nan
        # sup|F| and TV(F) of the last observation
        self.lasting = flux if flux and flux.lasting and coefficient is not None and coefficient.steady else None
        self.flux_seen = (np.inf, np.inf)
        self.t = self.rate = self.tv_source = self.growth_allowed = 0.0
        self.steps_observed, self.steps_frozen = 0, -self.FROZEN_STEPS

    def wants(self, state: State) -> bool:
        return state.steps - self.steps_observed >= self.STEPS or state.t - self.t >= self.pause

    def observe(self, state: State) -> None:
        """Update the margins of all bounds. Raise Halt if a bound that stops a run is violated."""
        q, dx, t, grid = state.q, self.grid.dx, state.t, self.grid
        ln_K = np.empty(q.size + 1)
        mass, norm, least, most, variation, ln_K_min, ln_K_max, K_f2, tv_source = watch.survey(q, dx, state.law, ln_K)
        variation += 0.0 if self.inflow else abs(float(q[0]))  # the slope is neutral left of these cells
        rate = dx * (K_f2 + state.speed * variation)
        if np.isnan(self.first_volume):
            self.first_volume = state.volume()
        else:
            self.budget_allowance += 0.5 * (t - self.t) * (self.rate + rate)
            with np.errstate(over="ignore"):  # ratio of K across a cell; inf near q = -1, where no bound applies
                K_ratio = np.exp(dx * np.abs(self.law.f(np.array([least, most]))).max())
            self.growth_allowed += (t - self.t) * max(self.tv_source, tv_source) * K_ratio
        self.t, self.rate, self.tv_source, self.steps_observed = t, rate, tv_source, state.steps

        rounding = ROUNDOFF * (self.scale + state.crest_lowering + self.inflow * t)
        dx_tv = dx * variation
        self.crest_lowering, self.toe_outflow = state.crest_lowering, t + state.toe_gain
        self._record("mass_budget", rounding, mass - self.mass + state.crest_lowering - self.inflow * t)
        self.eroded_volume = self.first_volume - state.volume()
        off = abs(self.eroded_volume - state.toe_gain)
        self.budget_error = max(self.budget_error, off)
        small = ROUNDOFF * (1.0 + abs(state.toe_gain) + t + abs(self.first_volume))
        exactly = self.guarantees.get("volume_budget") == EXACT
        self._record("volume_budget", small + (0.0 if exactly else self.budget_allowance), off)

        def place(index: int) -> float:
            return grid.centre(state.first + index)

        self._record("minimum_principle", ROUNDOFF, self.floor - least, dx_tv, lambda: place(int(np.argmin(q))))
        if self.inflow:
            return self._judge(state)
        wrong = -least if self.sign > 0 else most
        self._record("signs", ROUNDOFF, wrong, dx_tv, lambda: place(int(np.argmax(-self.sign * q))))
        self._record("l1_decay", rounding, norm - self.norm, dx_tv)
        self.norm = min(norm, self.norm)
        self._record(
            "factor_bounds", self.ln_K_bound_above + rounding, ln_K_max, dx_tv, lambda: place(int(np.argmax(ln_K[:-1])))
        )
        self._record(
            "factor_bounds", self.ln_K_bound_below + rounding, -ln_K_min, dx_tv,
            lambda: place(int(np.argmin(ln_K[:-1]))),
        )  # fmt: skip
        above = float(self.law.R(most)) - self.R0
        self._record("upper_bound", self.highest + rounding, above, dx_tv, lambda: place(int(np.argmax(q))))
        gain = variation - self.variation
        self._record("tv_growth", self.growth_allowed + rounding, gain, dx_tv, lambda: place(_steepest(q)))
        if "uniform_tv" in self.guarantees:
            gain = watch.invariant_variation(q, dx, state.law) - self.variation_I
            self._record("uniform_tv", rounding, gain, dx_tv + dx * self.variation)
        if "kruzkov" in self.guarantees and state.dt > 0.0 and state.steps - self.steps_frozen >= self.FROZEN_STEPS:
            self.steps_frozen = state.steps
            self._freeze(state, np.exp(ln_K, out=ln_K) if state.K is None else state.K, most, place)
        if "flux_maximum" in self.guarantees and self.lasting and state.K is not None:
            F = watch.frozen_step(q, state.K, dx, 0.0, state.law, self.lasting.kernel(state.bound))[1]
            self._compare(_sizes(F), self.flux_seen, state.K)
            self.flux_seen = _sizes(F)
        return self._judge(state)

    def _compare(self, now: tuple[float, float], before: tuple[float, float], K: Array) -> None:
        """Compare sup|F| and TV(F) with their values before."""
        # rounding of F, and of the differences of K that telescoping fluxes divide by dx
        rounding = ROUNDOFF * now[0] + 1e-15 * float(K.max()) / self.grid.dx
        self._record("flux_maximum", rounding, now[0] - before[0])
        self._record("flux_variation", K.size * rounding + ROUNDOFF * now[1], now[1] - before[1])

    def _freeze(self, state: State, K: Array, most: float, place: Callable[[int], float]) -> None:
        """Check one step with K frozen, from q and from its maximum and minimum with a constant, in blocks of cells."""
        q, dx, law = state.q, self.grid.dx, state.law
        parts = [(max(a - HALO, 0), a, b, min(b + HALO, q.size)) for a, b in blocks(q.size)]
        # the CFL number of the step, with K and f' of the neighbouring cells, must not exceed that of the method
        nearby = max(watch.fastest_nearby(q[i:j], K[i : j + 1], law) for i, _, _, j in parts)
        assert self.flux is not None
        dt, flux = state.dt * min(state.speed / nearby, 1.0), self.flux.kernel(max(state.bound, nearby))
        # the slope of another cell each time; small slopes would need shorter steps if K is large
        alpha = float(q[int(q.size * (0.618 * (state.steps + 1) % 1.0))])
        if float(K.max()) * float(self.law.derivative(alpha)) > state.speed:
            alpha = most
        sizes, next_sizes, excesses = [], [], []
        for i, a, b, j in parts:
            y, rest = q[i:j], (K[i : j + 1], dx, dt, law, flux)
            after, F = watch.frozen_step(y, *rest)
            nodes = slice(a - i, b - i + 1)
            sizes.append(_sizes(F[nodes]))
            next_sizes.append(_sizes(watch.frozen_step(after, *rest)[1][nodes]))
            others = np.full(y.size, alpha), np.maximum(y, alpha), np.minimum(y, alpha)
            constant, upper, lower = (watch.frozen_step(other, *rest)[0] for other in others)
            excess = np.abs(after - constant) - (upper - lower)
            cell, stop = max(a, 1), min(b, q.size - 1)  # the flux at the ends is prescribed
            if cell < stop:
                at = cell + int(np.argmax(excess[cell - i : stop - i]))
                excesses.append((float(excess[at - i]), at))
        self._compare(_joined(next_sizes), _joined(sizes), K)
        worst, at = excesses[int(np.argmax([value for value, _ in excesses]))]  # also if it is NaN
        self._record("kruzkov", ROUNDOFF * (1.0 + most), worst, 0.0, lambda: place(at))

    def _record(
        self, name: str, allowed: float, excess: float, dx_tv: float = 0.0, place: Callable[[], float] = lambda: np.nan
    ) -> None:
        """Record the worst margin; `dx_tv` is an additional allowance of bounds that hold to first order."""
        if name not in self.guarantees:
            return
        allowed += dx_tv if self.guarantees[name] == FIRST_ORDER else 0.0
        margin = 1.0 - max(abs(excess) if name == "mass_budget" else excess, 0.0) / allowed
        row = self.worst[list(self.guarantees).index(name)]
        if not margin >= row[0]:
            row[:] = margin, self.t, place()

    def _judge(self, state: State) -> None:
        """Raise Halt if a violated bound stops the run."""
        for name, verdict in self.bounds.items():
            stopping = name in STOPPING and verdict.allowance == EXACT
            if not verdict.holds and verdict.time == state.t and (self.strict or stopping):
                raise Halt(verdict.broken(name))

    @property
    def bounds(self) -> dict[str, Verdict]:
        """A verdict on each observed bound."""
        return {
            name: Verdict(margin >= 0.0, margin, t, x, accuracy)
            for (name, accuracy), (margin, t, x) in zip(self.guarantees.items(), self.worst.tolist(), strict=True)
            if margin != np.inf  # a NaN does not hold
        }


def _steepest(q: Array) -> int:
    """Return the cell with the largest difference to the next one."""
    d = np.diff(q)
    return int(np.argmax(np.abs(d, out=d)))


def _sizes(F: Array) -> tuple[float, float]:
    """Return sup|F| and TV(F)."""
    return float(np.abs(F).max()), float(np.abs(np.diff(F)).sum())


def _joined(sizes: list[tuple[float, float]]) -> tuple[float, float]:
    """Return sup|F| and TV(F) from those of blocks that have their end nodes in common."""
    largest, variations = zip(*sizes, strict=True)
    return float(np.max(largest)), float(np.sum(variations))
