"""Figures 3.6, 3.11 and 3.12 of Alam 2018: plans of a bouncing robot between all pairs of cells.

    python -m experiments.chapter_3.all_plans

Eight directions, bouncing angles 45, 90 and 135 deg, weights 1 and 100, `endpoint` collisions.

The source shows its maps as pictures only, and its histograms without numbers. Of the lab (Figure
3.5) it tells that there are 384 cells, one obstacle inside and one at the wall, and where two plans
begin and end; snapshots (Figures 3.7 and 3.8) tell their turns. That fixes the bottom row: eight
free squares, the obstacle at the wall, one more. Of the maps of this kind with a rectangle for each
obstacle, many give both plans with these turns, and a few of these order the histogram as the
source does (`--search` lists them). `lab` is the one of the few with the fewest pairs that have no
path: a stand-in. So is `room` for Figure 3.10, the only one of 900 rooms of 432 cells, drawn at
random, whose histogram is ordered as in Figure 3.12. `complex` is `data/maps/complex.json`, a
stand-in for Figure 3.9, of which the source has no histogram.

A pair may have several cheapest plans, with different numbers of angles; one of them is counted.

Writes `all_plans.nc`, `all_plans.png`, and the plans of each map in `plans_*.nc`.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import jaxcell
from jaxcell.base.runtime import configure_jax
from jaxcell.bounce import AllPlans, Plan, all_plans, plan, replay
from jaxcell.space import CellSpace, Motion, Workspace

from ..shared.data import MAPS
from ..shared.options import experiment_parser, read_options


if TYPE_CHECKING:
    import xarray as xr

DIRECTIONS = 8
BOUNCES_DEG = (45, 90, 135)
WEIGHTS = {"keep": 1, "change": 100}
COLLISION = "endpoint"
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
# Numbers of angles, the commonest first, as section 3.5.2 tells.
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


def of_grid(free: np.ndarray) -> CellSpace:
    return CellSpace.of_grid(free, DIRECTIONS)


def environments() -> dict[str, CellSpace]:
    rows = {name: text.split()[::-1] for name, text in GRIDS.items()}
    spaces = {
        name: of_grid(np.array([[square == "." for square in row] for row in grid]))
        for name, grid in rows.items()
    }
    complex_map = Workspace.load(MAPS / "complex.json")
    return {**spaces, "complex": CellSpace.of(complex_map, 1.0, DIRECTIONS)}


def turns(found: Plan) -> tuple[int, ...]:
    return tuple(np.rad2deg(found.turns).round().astype(int).tolist())


def histogram(plans: AllPlans) -> np.ndarray:
    """Count the pairs of different cells without a path, or with a plan of 0, 1, 2, 3 angles."""
    used = plans.angles_used()
    np.fill_diagonal(used, -2)
    return np.bincount(used.ravel() + 2, minlength=len(BOUNCES_DEG) + 3)[1:]


def ordered(counts: np.ndarray, order: tuple[int, ...]) -> bool:
    return bool((np.diff(counts[1:][list(order)]) < 0).all())


def study() -> tuple["xr.Dataset", dict[str, AllPlans]]:
    import xarray as xr

    bounces = np.deg2rad(BOUNCES_DEG)
    spaces = environments()
    counts = np.zeros((len(spaces), len(METHODS), len(BOUNCES_DEG) + 2), np.int64)
    dearer = np.zeros(len(spaces), np.int64)
    seconds = np.zeros(len(spaces))
    kept = {}
    for i, (name, cells) in enumerate(spaces.items()):
        options = {**WEIGHTS, "motion": Motion(collision=COLLISION)}
        all_plans(cells, bounces, **options)  # compiles
        began = time.perf_counter()
        exact = all_plans(cells, bounces, **options)
        costs = exact.costs()
        exact.actions()
        seconds[i] = time.perf_counter() - began
        layered = all_plans(cells, bounces, method="layered", **options)
        counts[i] = histogram(exact), histogram(layered)
        dearer[i] = (costs != layered.costs()).sum()
        kept[name] = exact
    data = xr.Dataset(
        {
            "plans": (
                ("environment", "search", "angles_used"),
                counts,
                {"long_name": "pairs of different cells; angles_used -1: no path"},
            ),
            "pairs_that_differ": (
                "environment",
                dearer,
                {"long_name": "pairs that cost another sum in the layered search"},
            ),
            "cells": ("environment", [cells.size for cells in spaces.values()]),
            "seconds": (
                "environment",
                seconds,
                {"long_name": "time for costs and first actions of all pairs", "units": "s"},
            ),
        },
        {
            "environment": list(spaces),
            "search": list(METHODS),
            "angles_used": np.arange(-1, len(BOUNCES_DEG) + 1),
        },
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


def report(data: "xr.Dataset", plans: AllPlans) -> None:
    table = Table(title="Plans by the number of angles that they use", box=SIMPLE_HEAD)
    table.add_column("environment", no_wrap=True)
    table.add_column("search")
    for heading in ("no path", "0", "1", "2", "3"):
        table.add_column(heading, justify="right")
    table.add_column("the source's order")
    for name in data.environment.values.tolist():
        one = data.sel(environment=name)
        for method in METHODS:
            counts = one.plans.sel(search=method).values
            agrees = "-"
            if name in ORDER:
                told = " > ".join(map(str, ORDER[name]))
                agrees = f"{told}: {'so here' if ordered(counts, ORDER[name]) else 'NOT HERE'}"
            who = f"{name}, {int(one.cells):,} cells ({FIGURE[name]})"
            first = method == METHODS[0]
            table.add_row(who if first else "", method, *(f"{n:,}" for n in counts), agrees)
        table.add_section()
    Console(width=120).print(table)

    table = Table(title="The plans of Figure 3.6, in the stand-in for the lab", box=SIMPLE_HEAD)
    for heading in ("figure", "from, to", "turns in the source", "ours", "cost"):
        table.add_column(heading)
    for query in QUERIES:
        found = plans.plan(query.start, query.goal)
        same = "the same" if turns(found) == query.turns else str(turns(found))
        row = (query.figure, f"{query.start}, {query.goal}", str(query.turns), same, found.cost)
        table.add_row(*map(str, row))
    Console(width=120).print(table)
    differ = ", ".join(
        f"{name} {int(n):,} of {int(cells) ** 2:,}"
        for name, n, cells in zip(
            data.environment.values, data.pairs_that_differ, data.cells, strict=True
        )
    )
    print(f"Pairs whose plan costs another sum in the layered search: {differ}.")
    seconds = dict(zip(data.environment.values, data.seconds.values.tolist(), strict=True))
    times = ", ".join(f"{name} {1e3 * value:.0f} ms" for name, value in seconds.items())
    print(f"Costs and first actions of all pairs: {times}.")
    print(
        "The source shows its maps as pictures only. lab and room are stand-ins, chosen to agree\n"
        "with what it tells; that they do is no evidence."
    )


def lab_candidates() -> Iterator[np.ndarray]:
    """Maps of 48 squares: a rectangle at the bottom after eight squares, and one inside."""
    for wide in range(1, 5):
        columns = 9 + wide
        for rows in range(4, 9):
            for high in range(1, rows - 1):
                area = rows * columns - 48 - wide * high
                for width in range(1, min(area, columns - 2) + 1):
                    if area % width:
                        continue
                    height = area // width
                    for y in range(1, rows - height):
                        for x in range(1, columns - width):
                            beside = x + width < 8 or x > 8 + wide or y > high
                            if not beside:
                                continue
                            free = np.ones((rows, columns), bool)
                            free[:high, 8 : 8 + wide] = False
                            free[y : y + height, x : x + width] = False
                            yield free


def search() -> None:
    """Lists the maps that give the plans of Figure 3.6, and the order of Figure 3.11."""
    bounces = np.deg2rad(BOUNCES_DEG)
    tried, both, found = 0, 0, []
    with Console(stderr=True).status("searching") as shown:
        for free in lab_candidates():
            tried += 1
            shown.update(f"searching: {tried} maps, {both} with both plans ...")
            cells = of_grid(free)
            options = {**WEIGHTS, "motion": Motion(collision=COLLISION)}
            answers = [plan(cells, bounces, q.start, q.goal, **options) for q in QUERIES]
            if any(turns(a) != q.turns for a, q in zip(answers, QUERIES, strict=True)):
                continue
            both += 1
            counts = histogram(all_plans(cells, bounces, **options))
            if ordered(counts, ORDER["lab"]):
                found.append((counts.tolist(), free))
    print(f"{tried} maps, {both} with both plans, {len(found)} of these with the order:")
    for counts, free in sorted(found, key=lambda one: one[0]):
        print(f"\nno path {counts[0]:,}; 0, 1, 2, 3 angles: {counts[1:]}")
        print("\n".join("".join(".#"[not square] for square in row) for row in free[::-1]))


def draw(data: "xr.Dataset", plans: AllPlans, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

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
        found = plans.plan(query.start, query.goal)
        _draw_plan(axes, cells, found)
        degrees = ", ".join(f"{turn}°" for turn in turns(found))
        axes.set_title(f"lab, Figure {query.figure}: turns {degrees}", fontsize=10)
    _draw_map(lab[2], spaces["room"])
    lab[2].set_title("room", fontsize=10)
    figure.suptitle("Cheapest plans between all pairs of cells (stand-ins for the source's maps)")
    figure.savefig(path, dpi=150)


def _draw_map(axes, cells: CellSpace) -> None:
    rows, columns = cells.free.shape
    axes.imshow(
        cells.free, origin="lower", cmap="gray", vmin=-0.4, vmax=1, extent=(0, columns, 0, rows)
    )
    axes.set_xticks(range(columns + 1))
    axes.set_yticks(range(rows + 1))
    axes.grid(color="0.85", linewidth=0.6)
    axes.tick_params(length=0, labelbottom=False, labelleft=False)


def _draw_plan(axes, cells: CellSpace, found: Plan) -> None:
    _draw_map(axes, cells)
    assert (
        replay(cells, found.start, found.actions, motion=Motion(collision=COLLISION))
        == found.visited
    ).all()
    x, y, _ = cells.centre(found.visited)
    corners = np.flatnonzero(np.append(found.actions != 0, True))
    for a, b in zip(np.append(0, corners[:-1]), corners, strict=True):
        if a != b and (x[a] != x[b] or y[a] != y[b]):
            arrow = {"arrowstyle": "->", "color": "#0072b2", "linewidth": 2}
            axes.annotate("", (x[b], y[b]), (x[a], y[a]), arrowprops=arrow)
    axes.plot(x[0], y[0], "o", color="#d55e00", label="start")
    axes.plot(x[-1], y[-1], "s", color="#009e73", label="goal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2, frameon=False)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_3/all_plans")
    parser.add_argument("--search", action="store_true", help="list maps like the lab, and stop")
    options = read_options(parser)
    configure_jax()
    if options.search:
        search()
        return 0
    data, plans = study()
    report(data, plans["lab"])
    data.to_netcdf(options.out / "all_plans.nc")
    for name, one in plans.items():
        one.save(options.out / f"plans_{name}.zarr")
    draw(data, plans["lab"], options.out / "all_plans.png")
    print(f"Data and figure in {options.out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
