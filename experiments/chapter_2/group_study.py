"""Figure 2.7 of Alam 2018: periodic groups and longest transients in randomly furnished rooms.

    python -m experiments.chapter_2.group_study --runs 100

A room of 200 x 125 unit cells with 360 directions, bouncing angle 90 deg, `endpoint` collisions;
`jaxcell.space.maps.random_rooms` says what stands in the environments E1 to E4.

Writes `group_study.nc` and `group_study.png`.
"""

import math
import os
import time
from collections.abc import Iterable, Iterator
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import jaxcell
from jaxcell import bounce
from jaxcell.space import ENDPOINT
from jaxcell.space.maps.random_rooms import DIRECTIONS, ENVIRONMENTS, place

from ..shared.options import at_least, experiment_parser, read_options


if TYPE_CHECKING:
    import xarray as xr

BOUNCE_DEG = 90
# Rooms that are mapped together.
BATCH = 10


def groups_and_transients(free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of periodic groups, and length of the longest transient trajectory, of each room."""
    found = bounce.grid_groups(free, math.radians(BOUNCE_DEG), DIRECTIONS, motion=ENDPOINT)
    return found.count, found.longest_transient


Item = TypeVar("Item")


def with_progress(items: Iterable[Item], total: int, title: str) -> Iterator[Item]:
    """Shows a progress bar on a terminal once the work has taken two seconds."""
    console = Console(stderr=True)
    began = time.monotonic()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=total, visible=False)
        for item in items:
            yield item
            progress.update(task, advance=1, visible=time.monotonic() - began > 2)


def study(runs: int, seed: int) -> "xr.Dataset":
    import xarray as xr

    names = list(ENVIRONMENTS)
    pairs = [(i, run) for run in range(runs) for i in range(len(names))]
    placements = [place(seed, names[i], run) for i, run in pairs]
    free = [placement.free for placement in placements]
    batches = [np.array(free[i : i + BATCH]) for i in range(0, len(free), BATCH)]
    with ThreadPool(os.cpu_count()) as pool:
        found = pool.imap(groups_and_transients, batches)
        parts = list(with_progress(found, len(batches), "batches of rooms"))
    both = np.concatenate(parts, axis=1)
    groups, transient, side = np.zeros((3, len(names), runs), np.int32)
    corner = np.full((len(names), runs, 3, 2), -1, np.int32)
    for n, (i, run) in enumerate(pairs):
        groups[i, run], transient[i, run] = both[:, n]
        side[i, run] = placements[n].side
        corner[i, run, : len(placements[n].corners)] = placements[n].corners
    dims = ("environment", "run")
    return xr.Dataset(
        {
            "groups": (dims, groups, {"long_name": "number of periodic groups"}),
            "longest_transient": (
                dims,
                transient,
                {"long_name": "length of the longest transient trajectory", "units": "mappings"},
            ),
            "corner": (
                (*dims, "obstacle", "axis"),
                corner,
                {"long_name": "lower left corner, -1 where there is no such obstacle"},
            ),
            "square_side": (dims, side, {"long_name": "side of the square", "units": "cells"}),
        },
        {
            "environment": names,
            "obstacle": ["square", "rectangle", "rectilinear"],
            "axis": ["x", "y"],
        },
        {
            "title": "Periodic groups in randomly furnished rooms",
            "source": "jaxcell; after Alam 2018, section 2.5.1 and Figure 2.7",
            "jaxcell_version": jaxcell.__version__,
            "room": "200 x 125 cells, static obstacle [70, 100] x [0, 20]",
            "directions": DIRECTIONS,
            "bounce_deg": BOUNCE_DEG,
            "collision": "endpoint",
            "seed": seed,
        },
    )


def report(found: "xr.Dataset") -> None:
    table = Table(title="Periodic groups and longest transients", box=SIMPLE_HEAD)
    table.add_column("")
    for quantity in ("groups", "transient"):
        for statistic in ("min", "median", "max"):
            table.add_column(f"{quantity}\n{statistic}", justify="right")
    for name in found.environment.values:
        row = found.sel(environment=name)
        table.add_row(
            name,
            *(
                f"{statistic(row[quantity].values):,.0f}"
                for quantity in ("groups", "longest_transient")
                for statistic in (np.min, np.median, np.max)
            ),
        )
    Console().print(table)

    middle = found.groups.median("run").values
    spread = (found.groups.max("run") - found.groups.min("run")).values
    longest = found.longest_transient.median("run").values
    side = found.square_side.sel(environment="E4").values
    trend = np.corrcoef(side, found.groups.sel(environment="E4").values)[0, 1]
    rises = middle[0] < middle[1] < middle[2]
    quartiles = found.longest_transient.quantile([0.25, 0.75], "run")
    fence = quartiles[1] + 1.5 * (quartiles[1] - quartiles[0])
    outliers = int((found.longest_transient > fence).sum())
    print("Section 2.5.1 says, and here:")
    print(
        f"- r increases with the addition of obstacles: {'yes' if rises else 'no'}, medians "
        f"{middle[0]:,.0f}, {middle[1]:,.0f}, {middle[2]:,.0f} with 1, 2, 3 obstacles;"
    )
    print(
        f"- r changes with the scaling of an obstacle: it spans {spread[3]:,} in E4 and "
        f"{spread[0]:,} in E1; its correlation with the side is {trend:+.2f};"
    )
    print(
        "- the longest transient varies with both: medians "
        f"{', '.join(f'{x:,.0f}' for x in longest)} in E1 to E4;"
    )
    print(f"- the longest transients have some outliers: {outliers} above the whiskers.")
    print("Its numbers are in a picture only, and so are the sizes of its obstacles.")


def draw(found: "xr.Dataset", seed: int, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(found.environment.values)
    figure = plt.figure(figsize=(9, 6.2), layout="constrained")
    rooms, boxes = figure.subfigures(2, 1, height_ratios=[1, 2.2])
    for i, axes in enumerate(rooms.subplots(1, len(names))):
        axes.imshow(
            place(seed, names[i], 0).free, origin="lower", cmap="gray", vmin=-0.4, vmax=1.05
        )
        axes.set(xticks=[], yticks=[], title=f"{names[i]}, placement 0")
    panels = boxes.subplots(1, 2)
    for letter, quantity, axes in zip("ab", ("groups", "longest_transient"), panels, strict=True):
        axes.boxplot(
            found[quantity].values.T,
            tick_labels=names,
            patch_artist=True,
            widths=0.5,
            boxprops={"facecolor": "#9ecae1"},
            medianprops={"color": "#d55e00", "linewidth": 2},
            flierprops={"marker": ".", "markersize": 5},
        )
        unit = found[quantity].attrs.get("units")
        axes.set_title(f"({letter}) {found[quantity].attrs['long_name']}", fontsize=10)
        axes.set(xlabel="environment", ylabel=unit or "groups")
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", alpha=0.3)
    figure.suptitle(
        f"Room of 200 x 125 cells, {DIRECTIONS} directions, bounce {BOUNCE_DEG}°, "
        f"{found.sizes['run']} placements of each kind"
    )
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/group_study", seed=0)
    parser.add_argument(
        "--runs", type=at_least(2), default=5, help="placements of each environment"
    )
    options = read_options(parser)

    began = time.perf_counter()
    found = study(options.runs, options.seed)
    seconds = time.perf_counter() - began
    report(found)
    found.to_netcdf(options.out / "group_study.nc")
    draw(found, options.seed, options.out / "group_study.png")
    print(f"{found.groups.size} placements in {seconds:.1f} s; data and figure in {options.out}")


if __name__ == "__main__":
    main()
