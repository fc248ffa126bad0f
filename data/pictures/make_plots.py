"""Make the plot of the page on recurrent sets, and the sheet of plots of the gallery, `plots.png`.

python data/pictures/make_plots.py [FOLDER] [STYLE]
"""

import sys
from pathlib import Path

import jax
import matplotlib
from PIL import Image


jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402

from jaxcell import study  # noqa: E402


PLAN = {"start": "0.5,1.5,0", "goal": "15.5,12.5,90"}
PLOTS = (
    (study.Groups(map="@cafe", bounce=(90.0,)), "group", {}),
    (study.Localize(map="@lab_a", bounce=135.0), "belief_size", {}),
    (study.LocalizeAnywhere(map="@lab_b", bounce=135.0, robots=200), "median_extent", {}),
    (
        study.Cover(
            map="@complex", directions=72, bounce=(80.0, 125.0), errors="turn=5deg", reliability=0.8
        ),
        "mixture",
        {},
    ),
    (study.Navigate(map="@complex", bounce=(90.0, 180.0), **PLAN), "visited", {}),
    (study.Team(map="@complex", robots=4, bounce=135.0), "first_visit", {}),
    (study.PatrolGraph(file="@eight"), "stationary", {}),
    (study.PatrolMap(map="@depot", robots=2, runs=200), "captures_probability", {}),
    (study.Drift(file="@gyres", depths=(0,)), "absorption_time", {}),
    (study.Drift(file="@gyres", depths=(0,)), "curve_covered", {}),
    (study.Dynamics(system="duffing"), "basin", {}),
    (study.Dynamics(system="pendulum", params=("T=0.05:0.95:8",)), "fraction", {}),
)


def main(folder: Path, style: str) -> None:
    """Make all plots in a style of matplotlib."""
    with plt.style.context(style):
        figure, axes = plt.subplots(4, 3, figsize=(15, 16), layout="constrained")
        for (question, name, options), ax in zip(PLOTS, axes.ravel(), strict=True):
            question.run().plot(name, ax=ax, **options)
            ax.set_title(f"{question.name}\n{ax.get_title()}", fontsize=10)
        figure.savefig(folder / "plots.png", dpi=70)
    sets = study.Morse(system="pendulum", depth=4).run()
    sets.plot().figure.savefig(folder / "morse.png", dpi=80, bbox_inches="tight")
    Image.open(folder / "plots.png").convert("RGB").quantize(128).save(folder / "plots.png")


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    main(folder, sys.argv[2] if len(sys.argv) > 2 else "default")
