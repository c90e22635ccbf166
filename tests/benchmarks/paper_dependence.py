"""Draws docs/figures/dependence.png and prints what §9, says of the shipped cases."""

from pathlib import Path

import hjprofile as hj
from hjprofile.output.plots.study_pictures import dependence_picture
from hjprofile.studies.dependence import dependence, summary

FIGURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "dependence.png"
SHOWN = "breaking_bump"


def main():
    for name in ("breaking_bump", "two_kinks", "deposit", "log_law", "hillslope"):
        case = hj.load_case(name)
        distances = dependence(name, case.problem, case.grid)
        print(name, *summary(distances)[0], sep="\n  ")
        if name == SHOWN:
            FIGURE.write_bytes(dependence_picture(distances))


if __name__ == "__main__":
    main()
