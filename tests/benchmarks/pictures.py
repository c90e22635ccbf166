"""The pictures of runs in the docs, as commands draw them: `python tests/benchmarks/pictures.py`, in some seconds."""

import re
import tempfile
from pathlib import Path

import hjprofile as hj
from hjprofile.output.plots import style
from hjprofile.output.plots.animation import animation
from hjprofile.output.plots.comparison import draw_comparison
from hjprofile.output.plots.norm_panels import draw_norms
from hjprofile.output.plots.runs import draw_diagram, draw_factor, draw_profiles

DOCS = Path(__file__).resolve().parents[2] / "docs"
FIGURES = DOCS / "figures"


def raw_export():
    """Solve the case that `import` makes of the export in the tutorial."""
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"<!-- file: export.txt -->\n```text\n(.*?)```", page, flags=re.S)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "export.txt"
        source.write_text(text, encoding="utf-8")
        made = hj.import_survey(source, Path(folder) / "export.toml", critical_slope=0.36, length=12.0)
        case = hj.load_case(made.case, {"solver.method": "auto", "solver.tolerance": 1e-3})
        return hj.solve_case(case)


def main():
    hillslope, two_kinks = (hj.solve_case(hj.load_case(name)) for name in ("hillslope", "two_kinks"))
    coarse = hj.solve_case(hj.load_case("two_kinks", {"solver.method": "lax-friedrichs"}))
    drawings = {
        "hillslope": draw_profiles(hillslope),
        "hillslope_diagram": draw_diagram(hillslope),
        "factor": draw_factor(hillslope),
        "norms": draw_norms(hillslope),
        "raw_export": draw_profiles(raw_export()),
        "two_kinks": draw_diagram(two_kinks),
        "comparison": draw_comparison(two_kinks, coarse, ("two_kinks", "lax-friedrichs")),
    }
    for name, figure in drawings.items():
        (FIGURES / f"{name}.png").write_bytes(style.encode(figure, "png"))
    (FIGURES / "hillslope.gif").write_bytes(animation(hillslope, ".gif"))


if __name__ == "__main__":
    main()
