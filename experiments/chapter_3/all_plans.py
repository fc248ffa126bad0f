"""Figures 3.6, 3.11 and 3.12 of Alam 2018: plans of a bouncing robot between all pairs of cells.

    python -m experiments.chapter_3.all_plans

Robots have eight directions and bouncing angles 45, 90 and 135 deg. The weights are 1 and 100, and
collisions are `endpoint`.

The source shows its maps as pictures only, and its histograms without numbers. Its lab (Figure 3.5)
has 384 cells, one obstacle inside and one at the wall. The source has the starts and goals of two
plans, and snapshots (Figures 3.7 and 3.8) show their turns. The bottom row must therefore have
eight free squares, the obstacle at the wall, and one free square. If both obstacles are rectangles,
many such maps give both plans with these turns, and a few also give the order of the histogram of
the source (`--search` lists these). `lab` is the map among them with the fewest pairs without a
path. `room` is the only one of 900 random rooms of 432 cells whose histogram has the order of
Figure 3.12. `complex` is `data/maps/complex.json`, in place of Figure 3.9; the source has no
histogram for it. All three maps are stand-ins for the maps of the source.

A pair may have several cheapest plans, with different numbers of angles. One of them is counted.

The script writes `all_plans.nc`, `all_plans.png`, and the plans of each map in `plans_*.zarr`.
"""

import itertools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from rich.console import Console

import jaxcell
from jaxcell.base.runtime import configure_jax
from jaxcell.bounce import AllPlans, Plan, all_plans, plan, replay
from jaxcell.space import CellSpace, Motion

from ..shared.data import MAPS, squares
from ..shared.figures import draw_room, plt, save
from ..shared.options import experiment_parser, read_options
from ..shared.report import show


DIRECTIONS = 8
BOUNCES_DEG = (45, 90, 135)
WEIGHTS = {"keep": 1, "change": 100}
COLLISION = "endpoint"
OPTIONS = {**WEIGHTS, "motion": Motion(collision=COLLISION)}
METHODS = ("exact", "layered")
GRIDS = {
    "lab": """
        ...........
        ......#....
        ........##.
        ........##.
        ........##.""",
    "room": """
        ........
        ......#.
        ......#.
        ........
        ..##..#.
        .###..#.
        ......#.
        ........""",
}
# The numbers of angles in section 3.5.2, from the most to the least frequent.
ORDER = {"lab": (1, 2, 3, 0), "room": (3, 2, 1, 0)}
FIGURE = {"lab": "Figure 3.11", "room": "Figure 3.12", "complex": "not in the source"}


class Query(NamedTuple):
    """A plan of Figure 3.6 in the lab, with cells counted from 0, and its turns."""

    figure: str
    start: int
    goal: int
    turns: tuple[int, ...]


QUERIES = (
    Query("3.6(a)", 8, 0, (90, 90, 90, 90)),
    Query("3.6(b)", 103, 8, (135, 135, 135, 135, 90)),
)


def environments() -> dict[str, CellSpace]:
    """Make the cells of the three maps."""
    spaces = {name: CellSpace.of_grid(squares(grid), DIRECTIONS) for name, grid in GRIDS.items()}
    return spaces | {"complex": CellSpace.load(MAPS / "complex.json")}


def turns(plan: Plan) -> tuple[int, ...]:
    return tuple(np.rad2deg(plan.turns).round().astype(int).tolist())


def histogram(plans: AllPlans) -> np.ndarray:
    """Count the pairs of different cells without a path, and with a plan of 0, 1, 2, 3 angles."""
    used = plans.angles_used()
    np.fill_diagonal(used, -2)
    return np.bincount(used.ravel() + 2, minlength=len(BOUNCES_DEG) + 3)[1:]


def ordered(counts: np.ndarray, order: tuple[int, ...]) -> bool:
    return bool((np.diff(counts[1:][list(order)]) < 0).all())


def study() -> tuple[xr.Dataset, dict[str, AllPlans]]:
    """Compute the plans of all maps by both searches, and count them."""
    bounces = np.deg2rad(BOUNCES_DEG)
    spaces = environments()
    counts, different, seconds, kept = [], [], [], {}
    for name, cells in spaces.items():
        all_plans(cells, bounces, **OPTIONS)  # compiles
        began = time.perf_counter()
        exact = all_plans(cells, bounces, **OPTIONS)
        costs = exact.costs()
        exact.actions()
        seconds.append(time.perf_counter() - began)
        layered = all_plans(cells, bounces, method="layered", **OPTIONS)
        counts.append([histogram(exact), histogram(layered)])
        different.append((costs != layered.costs()).sum())
        kept[name] = exact
    pairs = {"long_name": "pairs of different cells; angles_used -1: no path"}
    differ = {"long_name": "pairs whose plan has a different cost in the layered search"}
    times = {"long_name": "time for costs and first actions of all pairs", "units": "s"}
    angles = np.arange(-1, len(BOUNCES_DEG) + 1)
    data = xr.Dataset(
        {
            "plans": (("environment", "search", "angles_used"), counts, pairs),
            "pairs_that_differ": ("environment", different, differ),
            "cells": ("environment", [cells.size for cells in spaces.values()]),
            "seconds": ("environment", seconds, times),
        },
        {"environment": list(spaces), "search": list(METHODS), "angles_used": angles},
        {
            "title": "Plans of a bouncing robot between all pairs of cells",
            "source": "jaxcell; after Alam 2018, section 3.5.2, Figures 3.11 and 3.12; own maps",
            "jaxcell_version": jaxcell.__version__,
            "directions": DIRECTIONS,
            "bounces_deg": BOUNCES_DEG,
            "collision": COLLISION,
            **WEIGHTS,
            **{f"map {name}": "\n".join(text.split()) for name, text in GRIDS.items()},
        },
    )
    return data, kept


def report(data: xr.Dataset, plans: AllPlans) -> None:
    """Print the histograms, the plans of Figure 3.6, and times."""
    rows, different, times = [], [], []
    for name in data.environment.values.tolist():
        here = data.sel(environment=name)
        cells = int(here.cells)
        for method in METHODS:
            counts = here.plans.sel(search=method).values
            agrees = "-"
            if name in ORDER:
                order = " > ".join(map(str, ORDER[name]))
                agrees = f"{order}: {'agrees' if ordered(counts, ORDER[name]) else 'DISAGREES'}"
            row = {"environment": f"{name}, {cells:,} cells ({FIGURE[name]})", "search": method}
            names = ("no path", "0", "1", "2", "3")
            row |= dict(zip(names, map(float, counts), strict=True))
            rows.append(row | {"order of the source": agrees})
        different.append(f"{name} {int(here.pairs_that_differ):,} of {cells**2:,}")
        times.append(f"{name} {1e3 * float(here.seconds):.0f} ms")
    show("Plans by the number of angles that they use", rows, ",.0f")
    rows = []
    for query in QUERIES:
        query_plan = plans.plan(query.start, query.goal)
        same = "the same" if turns(query_plan) == query.turns else str(turns(query_plan))
        row = {"figure": query.figure, "start and goal": f"{query.start}, {query.goal}"}
        rows.append(row | {"turns": str(query.turns), "ours": same, "cost": str(query_plan.cost)})
    show("The plans of Figure 3.6, on our map in place of the lab", rows)
    print(f"Pairs whose plan has a different cost in the layered search: {', '.join(different)}.")
    print(f"Time for costs and first actions of all pairs: {', '.join(times)}.")
    print(
        "The source shows its maps as pictures only. lab and room were chosen to agree with the\n"
        "source, so their agreement is no evidence."
    )


def lab_candidates() -> Iterator[np.ndarray]:
    """Yield maps of 48 free squares: a rectangle stands after eight bottom squares, one inside."""
    for wide, rows in itertools.product(range(1, 5), range(4, 9)):
        columns = 9 + wide
        for high, width in itertools.product(range(1, rows - 1), range(1, columns - 1)):
            height, rest = divmod(rows * columns - 48 - wide * high, width)
            if rest or height < 1:
                continue
            for y, x in itertools.product(range(1, rows - height), range(1, columns - width)):
                if x + width < 8 or x > 8 + wide or y > high:
                    free = np.ones((rows, columns), bool)
                    free[:high, 8 : 8 + wide] = False
                    free[y : y + height, x : x + width] = False
                    yield free


def search() -> None:
    """Print the maps that give the plans of Figure 3.6 and the order of Figure 3.11."""
    bounces = np.deg2rad(BOUNCES_DEG)
    tried, both, fitting = 0, 0, []
    with Console(stderr=True).status("searching") as shown:
        for free in lab_candidates():
            tried += 1
            shown.update(f"searching: {tried} maps, {both} with both plans ...")
            cells = CellSpace.of_grid(free, DIRECTIONS)
            answers = [plan(cells, bounces, q.start, q.goal, **OPTIONS) for q in QUERIES]
            if any(turns(a) != q.turns for a, q in zip(answers, QUERIES, strict=True)):
                continue
            both += 1
            counts = histogram(all_plans(cells, bounces, **OPTIONS))
            if ordered(counts, ORDER["lab"]):
                fitting.append((counts.tolist(), free))
    print(f"{tried} maps, {both} with both plans, {len(fitting)} of these with the order:")
    for counts, free in sorted(fitting, key=lambda one: one[0]):
        print(f"\nno path {counts[0]:,}; 0, 1, 2, 3 angles: {counts[1:]}")
        print("\n".join("".join(".#"[not square] for square in row) for row in free[::-1]))


def draw(data: xr.Dataset, plans: AllPlans, path: Path) -> None:
    """Draw the histograms, the plans of Figure 3.6, and the map `room`."""
    figure, panels = plt.subplots(2, 3, figsize=(13, 7.4), layout="constrained")
    spaces = environments()
    for axes, (name, cells) in zip(panels[0], spaces.items(), strict=True):
        counts = data.plans.sel(environment=name).values[:, 1:]
        for shift, method, row, color in zip(
            (-0.2, 0.2), METHODS, counts, ("#0072b2", "#e69f00"), strict=True
        ):
            bars = axes.bar(np.arange(4) + shift, row / 1e3, 0.4, color=color, label=method)
            axes.bar_label(bars, [f"{n / 1e3:.3g}" for n in row], fontsize=8)
        axes.set_xticks(range(4))
        axes.set_xlabel("bouncing angles used")
        axes.set_ylabel("plans, thousands")
        axes.set_title(f"{name}: {cells.size:,} cells ({FIGURE[name]})", fontsize=10)
        axes.legend(frameon=False, loc="upper left")
        axes.margins(y=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    lab, cells = panels[1], spaces["lab"]
    for axes, query in zip(lab, QUERIES, strict=False):
        query_plan = plans.plan(query.start, query.goal)
        _draw_plan(axes, cells, query_plan)
        degrees = ", ".join(f"{turn}°" for turn in turns(query_plan))
        axes.set_title(f"lab, Figure {query.figure}: turns {degrees}", fontsize=10)
    draw_room(lab[2], spaces["room"].free, grid=True)
    lab[2].set_title("room", fontsize=10)
    figure.suptitle("Cheapest plans between all pairs of cells (our maps in place of the source's)")
    save(figure, path)


def _draw_plan(axes, cells: CellSpace, query_plan: Plan) -> None:
    draw_room(axes, cells.free, grid=True)
    again = replay(cells, query_plan.start, query_plan.actions, motion=OPTIONS["motion"])
    assert (again == query_plan.visited).all()
    x, y, _ = cells.centre(query_plan.visited)
    corners = np.flatnonzero(np.append(query_plan.actions != 0, True))
    for a, b in zip(np.append(0, corners[:-1]), corners, strict=True):
        if a != b and (x[a] != x[b] or y[a] != y[b]):
            arrow = {"arrowstyle": "->", "color": "#0072b2", "linewidth": 2}
            axes.annotate("", (x[b], y[b]), (x[a], y[a]), arrowprops=arrow)
    axes.plot(x[0], y[0], "o", color="#d55e00", label="start")
    axes.plot(x[-1], y[-1], "s", color="#009e73", label="goal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2, frameon=False)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_3/all_plans")
    parser.add_argument("--search", action="store_true", help="only list maps like the lab")
    options = read_options(parser)
    configure_jax()
    if options.search:
        search()
        return
    data, plans = study()
    report(data, plans["lab"])
    data.to_netcdf(options.out / "all_plans.nc")
    for name, one in plans.items():
        one.save(options.out / f"plans_{name}.zarr")
    draw(data, plans["lab"], options.out / "all_plans.png")
    print(f"Data and figure in {options.out}")


if __name__ == "__main__":
    main()
