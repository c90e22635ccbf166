"""The flux of grains that is supplied at the crest of a rolling layer, as a function of the supplied mass (§2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem.expressions import arithmetic
from hjprofile.problem.kinds import NUMBER, TEXT, Kind
from hjprofile.problem.paths import located
from hjprofile.problem.ranges import RANGES, Array, number
from hjprofile.problem.schema import Key, Table, to_table
from hjprofile.problem.user_code import evaluating, load_function, over_arrays

ABOUT = "a-layer"  # heading of the page on errors
PROBE = np.array([0.0, 0.25, 0.5])  # t at which a function is tried with an array
GAUSS = np.polynomial.legendre.leggauss(4)  # for the mean of 1/ε over a time step, exact to order 8


@dataclass(frozen=True, eq=False, repr=False)
class SupplyFlux:
    """A supply flux ε that depends on the supplied mass t.

    Attributes:
        function: t -> ε, for arrays.
        table: the `[layer]` table of a case file that makes this supply flux again.
        content: a hash of the file that holds the function; "" if `table` holds everything; None for a function that
            is in no file.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, supply_flux="0.1*(1 + t)")
    >>> print(problem.supply_flux.values([0.0, 1.0]))
    [0.1 0.2]
    """

    function: Callable[[Any], Any]
    table: Mapping[str, Any]
    content: str | None = ""

    def __repr__(self) -> str:
        return str(self)

    def __reduce__(self) -> tuple[Any, ...]:
        if self.content == "" and "supply_flux" in self.table:
            return supply_flux, ("supply_flux", self.table["supply_flux"])
        return type(self), (self.function, self.table, self.content)

    def values(self, t: Any) -> Array:
        """Return ε at supplied masses t, an array of any shape.

        Raise RunError with t if ε is not a positive number there.
        """
        t = np.asarray(t, dtype=float)
        with evaluating("the supply flux", RunError):
            flux = np.broadcast_to(np.asarray(self.function(t.copy()), dtype=float), t.shape)
        allowed = RANGES["supply_flux(t)"]
        wrong = ~np.atleast_1d(allowed.holds(flux))
        if wrong.any():
            first = int(np.argmax(wrong))
            raise RunError(
                f"supply_flux = {flux.flat[first]:.6g} at t = {t.flat[first]:.6g} is not {allowed.words}", ABOUT
            )
        return flux

    def means(self, t: float, dt: float, steps: int) -> Array:
        """Return the mean of ε over each of `steps` time steps of length dt from t on, shape (steps,).

        It is the mean over physical time, dt/∫dt/ε, because physical time grows by dt/ε. A step then has both its exact
        supplied mass and its exact physical length. Raise RunError as `values` does.
        """
        nodes, weights = GAUSS
        at = t + dt * (np.arange(steps)[:, None] + 0.5 * (1.0 + nodes))
        return 1.0 / (0.5 * weights @ (1.0 / self.values(at)).T)

    def check(self, end: float) -> None:
        """Raise InputError unless ε is a positive number at t = 0 and t = `end`."""
        try:
            self.values(np.array([0.0, end]))
        except RunError as error:
            raise InputError(str(error), ABOUT) from None

    def __str__(self) -> str:
        text = self.table.get("supply_flux")
        return repr(text) if text else f"the function {self.table['function']}"


def supply_flux(name: str, flux: Any) -> float | SupplyFlux:
    """Return a supply flux from a number, an expression in t, or a Python function of t.

    `name` begins the messages. Raise InputError for a number out of range, another expression or another type.
    """
    if isinstance(flux, SupplyFlux):
        return flux
    if isinstance(flux, str):
        text = flux.strip()
        return SupplyFlux(arithmetic(text, "t", name=name).value, {"supply_flux": text})
    if callable(flux):
        table = {"file": getattr(flux, "__module__", None) or "", "function": getattr(flux, "__name__", "supply_flux")}
        return SupplyFlux(over_arrays(flux, PROBE), table, None)
    return number(name, flux, key="supply_flux")


def _read(value: Any) -> float | str:
    found: float | str = value if isinstance(value, str) else NUMBER.read(value)
    return found


LAYER = (
    Key("supply_flux", Kind("a finite number or an expression in t", _read), 0.0, check=supply_flux),
    Key("file", TEXT, None),
    Key("function", TEXT, None),
)


def from_layer(table: Table, base: Path) -> float | SupplyFlux:
    """Return the supply flux of a `[layer]` section; paths in it are relative to `base`. Note its faults."""
    values = table.take(LAYER)
    file, function = values["file"], values["function"]
    if not table.sound:
        return 0.0
    if file is None and function is None:
        found: float | SupplyFlux = values["supply_flux"]
        return found
    if file is None or function is None or "supply_flux" in table.values:
        table.error("a supply flux is either supply_flux, or file and function of a Python function of t")
        return 0.0
    with table.noting():
        loaded = load_function(located(base, file), function)
        return SupplyFlux(over_arrays(loaded.function, PROBE), {"file": file, "function": function}, loaded.content)
    return 0.0


def layer_table(flux: float | SupplyFlux) -> dict[str, Any]:
    """Return the `[layer]` section of a resolved case."""
    return dict(flux.table) if isinstance(flux, SupplyFlux) else to_table(LAYER, {"supply_flux": flux})


def in_words(flux: float | SupplyFlux) -> str:
    """Return the text of a supply flux for a message."""
    return str(flux) if isinstance(flux, SupplyFlux) else f"{flux:g}"
