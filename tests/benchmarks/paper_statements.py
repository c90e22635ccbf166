"""Draws docs/figures/invariant.png and prints the table of the statements of the source paper for verification.md."""

from pathlib import Path

import hjprofile as hj
from hjprofile.output.plots.statement_pictures import invariant_picture
from hjprofile.studies.statements import CELLS

FIGURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "invariant.png"
SHOWN = "breaking_bump"
CASES = (
    "breaking_bump", "two_kinks", "deposit", "log_law", "hillslope", "to_the_critical_slope", "travelling_kink",
    "user_law", "steady_slope", "drying_channel",
)  # fmt: skip
COLUMNS = "q_in_time", "flux_growth", "other_k", "variation_apart", "k_in_time", "variation_of_q"


def main():
    for name in CASES:
        case = hj.load_case(name)
        found = hj.statements(case.problem, hj.Grid(case.grid.left, min(case.grid.cells, CELLS)))
        assert found.holds, name
        shares = [f"{one.value / one.bound:.3g}" if one.applies else "" for one in map(found.__getitem__, COLUMNS)]
        last = found["invariant"]
        change = f"{last.value:.1e} of {last.bound:.1e}" if last.applies else ""
        print("|", " | ".join([f"`{name}`", str(sum(one.applies for one in found.results)), *shares, change]), "|")
        if name == SHOWN:
            FIGURE.write_bytes(invariant_picture(name, found.characteristics))


if __name__ == "__main__":
    main()
