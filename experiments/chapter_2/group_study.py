"""Figure 2.7 of Alam 2018: periodic groups and longest transients in randomly furnished rooms.

    python -m experiments.chapter_2.group_study --runs 100

The room has 200 x 125 unit cells and 360 directions, the bouncing angle is 90 deg, and collisions
are `endpoint`. `jaxcell.space.maps.random_rooms` describes the obstacles of the environments E1 to
E4.

The script writes `group_study.nc` and `group_study.png`.
"""

import math
import os
import time
from multiprocessing.pool import ThreadPool
from pathlib import Path

import numpy as np
import xarray as xr

import jaxcell
from jaxcell import bounce
from jaxcell.space import ENDPOINT
from jaxcell.space.maps.random_rooms import DIRECTIONS, ENVIRONMENTS, place

from ..shared.figures import draw_boxes, draw_room, plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import show, tracked


BOUNCE_DEG = 90
# The number of rooms in a batch.
BATCH = 10


def groups_and_transients(free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the number of periodic groups and the longest transient of each room.

    **Arguments:**

    - `free`: the free squares, `[rooms, rows, columns]`.
    """
    data = bounce.grid_groups(free, math.radians(BOUNCE_DEG), DIRECTIONS, motion=ENDPOINT)
    return data.count, data.longest_transient


def study(runs: int, seed: int) -> xr.Dataset:
    """Compute the groups and transients of `runs` rooms of each environment."""
    names = list(ENVIRONMENTS)
    pairs = [(i, run) for run in range(runs) for i in range(len(names))]
    placements = [place(seed, names[i], run) for i, run in pairs]
    free = [placement.free for placement in placements]
    batches = [np.array(free[i : i + BATCH]) for i in range(0, len(free), BATCH)]
    with ThreadPool(os.cpu_count()) as pool:
        results = pool.imap(groups_and_transients, batches)
        parts = list(tracked(results, "batches of rooms", len(batches)))
    both = np.concatenate(parts, axis=1)
    groups, transient, side = np.zeros((3, len(names), runs), np.int32)
    corner = np.full((len(names), runs, 3, 2), -1, np.int32)
    for n, (i, run) in enumerate(pairs):
        groups[i, run], transient[i, run] = both[:, n]
        side[i, run] = placements[n].side
        corner[i, run, : len(placements[n].corners)] = placements[n].corners
    dims = ("environment", "run")
    longest = {"long_name": "length of the longest transient trajectory", "units": "mappings"}
    corners = {"long_name": "lower left corner, -1 if there is no such obstacle"}
    kinds = ["square", "rectangle", "rectilinear"]
    return xr.Dataset(
        {
            "groups": (dims, groups, {"long_name": "number of periodic groups"}),
            "longest_transient": (dims, transient, longest),
            "corner": ((*dims, "obstacle", "axis"), corner, corners),
            "square_side": (dims, side, {"long_name": "side of the square", "units": "cells"}),
        },
        {"environment": names, "obstacle": kinds, "axis": ["x", "y"]},
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


def report(data: xr.Dataset) -> None:
    """Print a table, and compare it with section 2.5.1 of the source."""
    rows = []
    for name in data.environment.values.tolist():
        row = {"environment": name}
        for quantity, short in (("groups", "groups"), ("longest_transient", "transient")):
            values = data[quantity].sel(environment=name).values
            for label, statistic in {"min": np.min, "median": np.median, "max": np.max}.items():
                row[f"{short}, {label}"] = float(statistic(values))
        rows.append(row)
    show("Periodic groups and longest transients", rows, ",.0f")

    middle = data.groups.median("run").values
    spread = (data.groups.max("run") - data.groups.min("run")).values
    longest = data.longest_transient.median("run").values
    side = data.square_side.sel(environment="E4").values
    trend = np.corrcoef(side, data.groups.sel(environment="E4").values)[0, 1]
    rises = middle[0] < middle[1] < middle[2]
    quartiles = data.longest_transient.quantile([0.25, 0.75], "run")
    fence = quartiles[1] + 1.5 * (quartiles[1] - quartiles[0])
    outliers = int((data.longest_transient > fence).sum())
    print("Statements of section 2.5.1 on the number r of groups, and our results:")
    print(
        f"- r increases with the addition of obstacles: {'yes' if rises else 'no'}, medians "
        f"{middle[0]:,.0f}, {middle[1]:,.0f}, {middle[2]:,.0f} with 1, 2, 3 obstacles;"
    )
    print(
        f"- r changes with the scaling of an obstacle: its range is {spread[3]:,} in E4 and "
        f"{spread[0]:,} in E1; its correlation with the side is {trend:+.2f};"
    )
    print(
        "- the longest transient varies with both: medians "
        f"{', '.join(f'{x:,.0f}' for x in longest)} in E1 to E4;"
    )
    print(f"- the longest transients have some outliers: {outliers} above the whiskers.")
    print("The source shows its numbers and the sizes of its obstacles as pictures only.")


def draw(data: xr.Dataset, seed: int, path: Path) -> None:
    """Draw a room of each environment, and the results as boxes."""
    names = list(data.environment.values)
    figure = plt.figure(figsize=(9, 6.2), layout="constrained")
    rooms, boxes = figure.subfigures(2, 1, height_ratios=[1, 2.2])
    for i, axes in enumerate(rooms.subplots(1, len(names))):
        draw_room(axes, place(seed, names[i], 0).free)
        axes.set_title(f"{names[i]}, placement 0")
    panels = boxes.subplots(1, 2)
    for letter, quantity, axes in zip("ab", ("groups", "longest_transient"), panels, strict=True):
        draw_boxes(axes, data[quantity].values.T, "#9ecae1", tick_labels=names)
        unit = data[quantity].attrs.get("units")
        axes.set_title(f"({letter}) {data[quantity].attrs['long_name']}", fontsize=10)
        axes.set(xlabel="environment", ylabel=unit or "groups")
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", alpha=0.3)
    figure.suptitle(
        f"Room of 200 x 125 cells, {DIRECTIONS} directions, bounce {BOUNCE_DEG}°, "
        f"{data.sizes['run']} placements of each kind"
    )
    save(figure, path)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/group_study", seed=0)
    parser.add_argument(
        "--runs", type=at_least(2), default=5, help="placements of each environment"
    )
    options = read_options(parser)

    began = time.perf_counter()
    results = study(options.runs, options.seed)
    seconds = time.perf_counter() - began
    report(results)
    results.to_netcdf(options.out / "group_study.nc")
    draw(results, options.seed, options.out / "group_study.png")
    print(f"{results.groups.size} placements in {seconds:.1f} s; data and figure in {options.out}")


if __name__ == "__main__":
    main()
