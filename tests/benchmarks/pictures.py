"""The pictures of runs in the docs, as commands draw them: `python tests/benchmarks/pictures.py`, in some seconds."""

from pathlib import Path

import hjprofile as hj
from hjprofile.output.plots import style
from hjprofile.output.plots.animation import animation
from hjprofile.output.plots.comparison import draw_comparison
from hjprofile.output.plots.runs import draw_diagram, draw_factor, draw_profiles

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"


def main():
    hillslope, two_kinks = (hj.solve_case(hj.load_case(name)) for name in ("hillslope", "two_kinks"))
    coarse = hj.solve_case(hj.load_case("two_kinks", {"solver.method": "lax-friedrichs"}))
    drawings = {
        "hillslope": draw_profiles(hillslope),
        "hillslope_diagram": draw_diagram(hillslope),
        "factor": draw_factor(hillslope),
        "two_kinks": draw_diagram(two_kinks),
        "comparison": draw_comparison(two_kinks, coarse, ("two_kinks", "lax-friedrichs")),
    }
    for name, figure in drawings.items():
        (FIGURES / f"{name}.png").write_bytes(style.encode(figure, "png"))
    (FIGURES / "hillslope.gif").write_bytes(animation(hillslope, ".gif"))


if __name__ == "__main__":
    main()
