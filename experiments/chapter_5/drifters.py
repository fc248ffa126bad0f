"""Section 5.5.1 of Alam 2018: long-term behaviour of drifters, their deployment, and voyages.

    python -m experiments.chapter_5.drifters [FILE.nc] [--out DIR]

The default file `data/ocean/gyres.nc` has synthetic currents of the size of the source's: 21 x 29
cells of 1 km, three layers and 24 hours. The currents of the source, of the Southern California
Bight in July 2011, are not public. Numbers of the source beside ours are *for another sea*: they
show what is usual, and cannot agree.

Results for a single moment are for the first of `--hours`. A step is the time in which the mean
current of the layer crosses a cell.

The script writes a CSV file for every table, and figures: `flow.png` (5.6), `behaviour.png` (5.7),
`absorption.png` (5.8), `views.png` (5.9), `layers_*h.png` (5.10 to 5.15), `voyage.png` and
`voyage_stack.png` (5.16), `coverage.png`, `sensitivity.png`, `replay.png` and `ridges.png`. The
exit status is 1 if a cell is not reached from the deployment cells, if two methods disagree on the
fewest drifters, or if a probability of arriving is another by a matrix of this script.

Drifters are simulated by this script, which shares the reader of the file with the maps and nothing
else. Arrivals are found again from the map of the drift and the actions of the policy. Ridges and
groups are both of the library; no check is made of them.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from jaxcell.base.runtime import configure_jax
from jaxcell.drift import visible_deployment

from ..shared.options import experiment_parser, read_options
from ..shared.report import Rows, emit, say
from . import drifters_check_figures, drifters_figures, drifters_layers
from .drifters_checks import DRIFTERS, SAILING, replays, ridge_rows, voyage_rows, voyages
from .drifters_sea import GYRES, Layer, Ocean, goal_of
from .drifters_tables import (
    SOURCE,
    SOURCE_VIEWS,
    behaviour_row,
    deployment_rows,
    group_rows,
    moment,
    rho_rows,
    step_rows,
    view_row,
)


REACH = 6
EDGES = ("uniform", "exit")
# Rounding of probabilities.
ROUNDING = 1e-9
MOST_GROUPS = 12


def surface_layer(ocean: Ocean, surface: Layer, out: Path) -> None:
    """Report the long-term behaviour of the surface, and cameras that see it."""
    currents, water = ocean.currents, surface.water
    say(
        f"""{currents.attrs["source"]}: {water.number.shape[0]} x {water.number.shape[1]} cells of
        {surface.cells_km():.3g} km, {currents.sizes["layer"]} layers,
        {currents.sizes["time"]} records. East: {currents.attrs["east_from"]}. North:
        {currents.attrs["north_from"]}. {currents.attrs["notes"]}"""
    )
    hour = ocean.hour(ocean.records[0])
    rows = [behaviour_row(f"surface, {hour:g} h", surface), SOURCE]
    emit("Long-term behaviour (Figure 5.7)", rows, out / "behaviour.csv", ".3g")
    say(
        """Single, multiple: the transient groups with one domicile and with several. Held: the
        transient cells with more than a year until a persistent group. Missing times exceed 64-bit
        numbers: an eddy loses so little water that no drifter will leave it, but it is not
        persistent. Locked: the groups of one cell that water flows out of, an effect of the grid.
        Self: the cells that are their own images."""
    )
    if surface.diagnosis.warning:
        say(f"Warning: {surface.diagnosis.warning}.")
    groups = group_rows(surface)
    emit("Groups (Figures 5.7(b), 5.8)", groups[:MOST_GROUPS], out / "groups.csv", ".3g")
    if len(groups) > MOST_GROUPS:
        say(f"These are the largest {MOST_GROUPS} of {len(groups)} groups.")
    sight = REACH * 1000 * surface.cells_km()
    views = visible_deployment(water, sight, surface.behaviour.groups)
    rows = [view_row(surface, views, sight), SOURCE_VIEWS]
    emit("Cameras (Figure 5.9)", rows, out / "views.csv")
    say(
        f"""Cameras see {REACH} cells far. Greedy: cells that together see all cells; kept: those of
        them at which drifters are deployed. Fewest: by a mixed-integer program."""
    )
    drifters_figures.flow(surface, out / "flow.png")
    drifters_figures.behaviour(surface, out / "behaviour.png")
    drifters_figures.absorption(surface, out / "absorption.png")
    drifters_figures.views(surface, views, sight, out / "views.png")


def deployment(ocean: Ocean, out: Path) -> bool:
    """Report deployments; returns `True` if they reach all cells, and methods agree."""
    rows, curves = deployment_rows(ocean, ocean.records[0])
    emit("Drifters from which all cells may be visited", rows, out / "deployment.csv")
    say(
        """Alg. 5.2 has a drifter in every persistent group and for every transient group. Fewest:
        the fewest drifters that may reach all cells, by components of the map and by a
        mixed-integer program. Greedy: one drifter after another, each where it adds most cells."""
    )
    drifters_check_figures.coverage(curves, ocean.waters[0].cells, out / "coverage.png")
    return all(row["all"] and row["MILP"] in (None, row["fewest"]) for row in rows)


def layers(ocean: Ocean, out: Path) -> None:
    """Report all layers at all moments, and the sensitivity to two parameters."""
    rows: Rows = []
    reached: Rows = []
    for record in ocean.records:
        one, behaviour, reach = moment(ocean, record)
        rows += behaviour
        reached += reach
        drifters_layers.moment(ocean, one, out / f"layers_{ocean.hour(record):g}h.png")
    emit("Layers (Figures 5.10, 5.12, 5.14)", rows, out / "layers.csv", ".3g")
    emit("Cells reached (Figures 5.11, 5.13, 5.15)", reached, out / "reached.csv")
    say(
        """In layers: by drifters that are deployed at the start, sink to their layer at once, and
        stay in it. Free: by a drifter that goes up and down at any time."""
    )
    steps, rhos = step_rows(ocean, ocean.records[0]), rho_rows(ocean, ocean.records[0])
    emit("Sensitivity to the step", steps, out / "steps.csv", ".3g")
    emit("Sensitivity to rho", rhos, out / "rho.csv", ".3g")
    drifters_check_figures.sensitivity(steps, rhos, out / "sensitivity.png")


def checks(ocean: Ocean, surface: Layer, seed: int, out: Path) -> None:
    """Compare maps with simulated drifters, and borders of groups with ridges."""
    rows, compared = replays(ocean, ocean.records[0], seed)
    emit("Maps and simulated drifters", rows, out / "replay.csv", ".2f")
    times = ", ".join(f"{hour:.3g}" for hour in compared[0].hours)
    say(
        f"""After whole steps, {times} h. Wrong: the total variation between the map and
        {DRIFTERS:,} drifters; noise: between two halves of the drifters; cells: the mean distance
        between the two. Where drifters gather in a point, a map spreads them over the cells around
        it."""
    )
    borders, ridges = ridge_rows(ocean, ocean.records[0])
    if borders:
        emit("Ridges at the borders of groups", borders, out / "ridges.csv", ".3g")
        say(
            """Borders near: the share of the cells at a border between domains of attraction that
            have a ridge of the finite-time Lyapunov exponent in the cell or beside it. All near:
            the same share of all cells, as expected of borders that are independent of ridges."""
        )
    else:
        say("Drifters of all cells end in the same group, so there are no borders.")
    drifters_check_figures.replays(surface.water, compared, out / "replay.png")
    drifters_check_figures.ridges(ridges, out / "ridges.png")


def voyage(ocean: Ocean, goal: int, out: Path) -> bool:
    """Report voyages to a goal; returns `True` if two methods agree on arrivals."""
    record, found, rows = ocean.records[0], {}, []
    for edge in EDGES:
        try:
            found[edge] = voyages(ocean, record, goal, edge)
        except RuntimeError as error:
            say(f"There is no voyage with edge '{edge}': {error}.")
        else:
            rows += voyage_rows(edge, found[edge], ocean)
    if not rows:
        return True
    specs = {"after, h": ".3g", "median, h": ".3g"}
    title = f"Voyage to {ocean.place(goal)} (Figure 5.16)"
    emit(title, rows, out / "voyage.csv", ".3f", **specs)
    starts = "; ".join(ocean.place(start) for start in ocean.starts)
    say(
        f"""Edge uniform: as in the source, no drifter leaves the grid; exit: drifters may leave it.
        Least, mean: the probability of ever arriving, over all cells; median: of the expected hours
        of arriving drifters. Then, for the starts {starts}: the probability, the expected hours of
        arriving drifters, and the probability of arriving within {SAILING} steps, once more by a
        matrix that is made from the actions."""
    )
    one = next(iter(found.values()))
    drifters_layers.voyage(ocean, record, one, out / "voyage.png")
    drifters_layers.stack(ocean, record, one, 0, out / "voyage_stack.png")
    within = f"{SAILING}, steps"
    return all(row["again"] is None or abs(row["again"] - row[within]) < ROUNDING for row in rows)


def numbers(count: int, names: str) -> Callable[[str], tuple[float, ...]]:
    """Make a reader of `count` numbers with commas between them."""

    def read(text: str) -> tuple[float, ...]:
        try:
            found = tuple(float(part) for part in text.split(","))
        except ValueError:
            found = ()
        if len(found) != count:
            raise argparse.ArgumentTypeError(f"expected {names}, got {text!r}")
        return found

    return read


def arguments() -> argparse.Namespace:
    place = numbers(2, "LON,LAT")
    parser = experiment_parser(__doc__, "runs/chapter_5/drifters", seed=0)
    parser.add_argument("file", type=Path, nargs="?", default=GYRES, help="NetCDF with currents")
    parser.add_argument("--hours", type=float, nargs="+", default=[1.0, 12.0, 24.0])
    parser.add_argument("--depths", type=float, nargs="+", help="metres; up to three by default")
    parser.add_argument("--step", type=float, help="hours; by default the time to cross a cell")
    parser.add_argument("--rho", type=float, default=0.8, help="probability of the image")
    parser.add_argument("--spread", default="turned", choices=("turned", "all", "sampled"))
    parser.add_argument("--start", type=place, action="append", metavar="LON,LAT")
    parser.add_argument("--goal", type=numbers(3, "LON,LAT,DEPTH"), metavar="LON,LAT,DEPTH")
    return read_options(parser)


def main() -> int:
    options = arguments()
    configure_jax()
    began = time.perf_counter()
    try:
        ocean = Ocean.of(options)
        goal = goal_of(ocean) if options.goal is None else ocean.cell(*options.goal)
        surface = ocean.layer(ocean.records[0])
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    surface_layer(ocean, surface, options.out)
    complete = deployment(ocean, options.out)
    layers(ocean, options.out)
    checks(ocean, surface, options.seed, options.out)
    arrives = voyage(ocean, goal, options.out)
    print(f"Data and figures in {options.out}; {time.perf_counter() - began:.0f} s.")
    return 0 if complete and arrives else 1


if __name__ == "__main__":
    raise SystemExit(main())
