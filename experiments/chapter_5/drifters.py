"""Section 5.5.1 of Alam 2018: where drifters end up, where to drop them, and how they get away.

    python -m experiments.chapter_5.drifters [FILE.nc] [--out DIR]

Without a file it takes the synthetic currents of `data/ocean/gyres.nc`, which have the size of the
source's: 21 x 29 cells of 1 km, three layers and 24 hours. The source's own currents, of the
Southern California Bight in July 2011, are not public. Where a number of the source stands beside
one of ours, it is *of another sea*: it shows what is usual, and cannot agree.

Of several hours the first is that of all results of one moment. Steps take as long as the mean
current of the layer needs to cross a cell.

Writes a CSV file for every table, and figures: `flow.png` (5.6), `behaviour.png` (5.7),
`absorption.png` (5.8), `views.png` (5.9), `layers_*h.png` (5.10 to 5.15), `voyage.png` and
`voyage_stack.png` (5.16), `coverage.png`, `sensitivity.png`, `replay.png` and `ridges.png`. Exit
status 1 if some cell is not reached from the deployment cells, if two ways to the fewest drifters
disagree, or if a simulated probability is five standard errors from the predicted one.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from jaxcell.base.runtime import configure_jax
from jaxcell.drift import (
    CoverageCurve,
    VisibleDeployment,
    visible_deployment,
)

from ..shared.report import emit, say
from . import drifters_check_figures, drifters_figures, drifters_layers
from .drifters_checks import (
    DRIFTERS,
    SAILING,
    Check,
    Ridges,
    Rows,
    Voyages,
    replays,
    ridge_rows,
    voyage_rows,
    voyages,
)
from .drifters_sea import GYRES, Layer, Ocean, goal_of
from .drifters_tables import (
    SOURCE,
    SOURCE_VIEWS,
    Moment,
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
ERRORS = 5
MOST_GROUPS = 12
WIDTH = 120


@dataclasses.dataclass(frozen=True, eq=False)
class Results:
    """The results."""

    ocean: Ocean
    surface: Layer
    views: VisibleDeployment
    sight: float
    "Range of the cameras, in metres."
    view: dict[str, Any]
    deployment: Rows
    curves: dict[str, CoverageCurve]
    moments: list[Moment]
    layers: Rows
    reached: Rows
    by_step: Rows
    by_rho: Rows
    replays: Rows
    checks: list[Check]
    borders: Rows
    ridges: list[Ridges]
    voyages: dict[str, Voyages]
    "By what happens at the edge."
    voyage: Rows
    failures: list[str]
    "Of voyages that were not found."
    seconds: dict[str, float]


def asked(options: argparse.Namespace) -> tuple[Ocean, Layer, int]:
    """The currents, the surface at the first moment, and the cell of the goal.

    **Raises:** `ValueError` and `OSError` for a file, a place or a number that cannot be used.
    """
    ocean = Ocean.of(options)
    surface = ocean.layer(ocean.records[0])
    return ocean, surface, goal_of(ocean) if options.goal is None else ocean.cell(*options.goal)


def study(ocean: Ocean, surface: Layer, goal: int, seed: int) -> Results:
    console = Console(stderr=True)
    seconds: dict[str, float] = {}
    began = time.perf_counter()
    part = "views"
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("views", total=7)

        def next_part(name: str) -> None:
            nonlocal began, part
            now = time.perf_counter()
            seconds[part] = now - began
            began, part = now, name
            progress.update(task, advance=1, description=name)

        record = ocean.records[0]
        sight = REACH * 1000 * surface.cells_km()
        views = visible_deployment(surface.water, sight, surface.behaviour.groups)
        view = view_row(surface, views, sight)
        next_part("deployment")
        deployment, curves = deployment_rows(ocean, record)
        next_part("layers")
        moments, layers, reach = [], [], []
        for one in ocean.records:
            found, behaviour, reached = moment(ocean, one)
            moments.append(found)
            layers += behaviour
            reach += reached
        next_part("sensitivity")
        by_step, by_rho = step_rows(ocean, record), rho_rows(ocean, record)
        next_part("replay")
        replay_rows, checks = replays(ocean, record, seed)
        next_part("ridges")
        borders, ridges = ridge_rows(ocean, record)
        next_part("voyage")
        sailed, voyage, failures = {}, [], []
        for edge in EDGES:
            try:
                sailed[edge] = voyages(ocean, record, goal, edge)
            except RuntimeError as stalled:
                failures.append(f"edge '{edge}': {stalled}")
            else:
                voyage += voyage_rows(edge, sailed[edge], ocean.starts, seed)
        next_part("")
    return Results(
        ocean=ocean,
        surface=surface,
        views=views,
        sight=sight,
        view=view,
        deployment=deployment,
        curves=curves,
        moments=moments,
        layers=layers,
        reached=reach,
        by_step=by_step,
        by_rho=by_rho,
        replays=replay_rows,
        checks=checks,
        borders=borders,
        ridges=ridges,
        voyages=sailed,
        voyage=voyage,
        failures=failures,
        seconds=seconds,
    )


# Tables and figures.


def report_surface(results: Results, out: Path) -> None:
    ocean, surface = results.ocean, results.surface
    currents, water = ocean.currents, surface.water
    say(
        f"""{currents.attrs["source"]}: {water.number.shape[0]} x {water.number.shape[1]} cells of
        {surface.cells_km():.3g} km, {currents.sizes["layer"]} layers,
        {currents.sizes["time"]} records. East: {currents.attrs["east_from"]}. North:
        {currents.attrs["north_from"]}. {currents.attrs["notes"]}"""
    )
    hour = ocean.hour(ocean.records[0])
    of_surface = [
        behaviour_row(f"surface, {hour:g} h", surface),
        SOURCE,
    ]
    emit("Long-term behaviour (Figure 5.7)", of_surface, out / "behaviour.csv", ".3g")
    say(
        """Single, multiple: the transient groups with one and with several domiciles. Held: the
        transient cells from which it takes more than a year to a persistent group. Where times are
        missing, they are beyond numbers of 64 bits: an eddy leaks so little that it is not
        persistent, and so much that no drifter will see it. Locked: the groups of one cell that
        water flows out of, which the grid made. Self: the cells whose images they are."""
    )
    if surface.diagnosis.warning:
        say(f"Warning: {surface.diagnosis.warning}.")
    groups = group_rows(surface)
    emit("Groups (Figures 5.7(b), 5.8)", groups[:MOST_GROUPS], out / "groups.csv", ".3g")
    if len(groups) > MOST_GROUPS:
        say(f"These are the largest {MOST_GROUPS} of {len(groups)} groups.")
    emit("Cameras (Figure 5.9)", [results.view, SOURCE_VIEWS], out / "views.csv")
    say(
        f"""Cameras see {REACH} cells far. Greedy: cells from which all is seen; kept: those of them
        where drifters are dropped. Fewest: by a mixed-integer program."""
    )


def report_deployment(results: Results, out: Path) -> bool:
    """Says whether the deployments reach all cells, and are as small as they can be."""
    emit("Drifters from which all cells may be visited", results.deployment, out / "deployment.csv")
    say(
        """Alg. 5.2 has a drifter in every persistent and for every transient group. Fewest: what
        may be reached at all, whatever the group, by components of the map and by a mixed-integer
        program. Greedy: one after the other, each where it adds most."""
    )
    every = results.deployment
    return all(row["all"] for row in every) and all(
        row["MILP"] in (None, row["fewest"]) for row in every
    )


def report_layers(results: Results, out: Path) -> None:
    emit("Layers (Figures 5.10, 5.12, 5.14)", results.layers, out / "layers.csv", ".3g")
    emit("Cells reached (Figures 5.11, 5.13, 5.15)", results.reached, out / "reached.csv")
    say(
        """In layers: by drifters that are dropped at the start and stay in the layer to which they
        go down at once. Free: by a drifter that goes up and down whenever it likes."""
    )
    emit("Sensitivity to the step", results.by_step, out / "steps.csv", ".3g")
    emit("Sensitivity to rho", results.by_rho, out / "rho.csv", ".3g")


def report_checks(results: Results, out: Path) -> None:
    emit("The map beside simulated drifters", results.replays, out / "replay.csv", ".2f")
    times = ", ".join(f"{hour:.3g}" for hour in results.checks[0].found.hours)
    say(
        f"""After whole steps, {times} h. Wrong: the share of {DRIFTERS:,} drifters that the map has
        in another cell; noise: that between two halves of the drifters; cells: how far they are
        apart on the mean. Where drifters gather in a point, a map still spreads them over the cells
        around it."""
    )
    if results.borders:
        emit("Ridges at the borders of groups", results.borders, out / "ridges.csv", ".3g")
        say(
            """Borders near: the share of the cells at a border between the domains of attraction
            that have a ridge of the finite-time Lyapunov exponent in the cell or beside it; all
            near: that of all cells, what borders would have that knew nothing of ridges."""
        )
    else:
        say("Drifters of all cells end in the same group, so that there is no border for ridges.")


def report_voyage(results: Results, out: Path) -> bool:
    """Says whether the simulated drifters do as predicted."""
    for failure in results.failures:
        say(f"There is no voyage with {failure}.")
    if not results.voyage:
        return True
    goal = next(iter(results.voyages.values())).goal
    specs = {"errors": ".1f", "after, h": ".3g", "median, h": ".3g"}
    title = f"Voyage to {results.ocean.place(goal)} (Figure 5.16)"
    emit(title, results.voyage, out / "voyage.csv", ".3f", **specs)
    starts = "; ".join(results.ocean.place(start) for start in results.ocean.starts)
    say(
        f"""Edge uniform: as in the source, nothing leaves the grid; exit: drifters may. Least,
        mean: the probability of arriving at all, over all cells; median: of the hours that it takes
        if they do. Then for the starts, {starts}: the probability, the hours if it arrives, and the
        probability of arriving within {SAILING} steps, beside the share of {DRIFTERS:,} simulated
        drifters, with its distance in standard errors."""
    )
    return all((row["errors"] or 0) < ERRORS for row in results.voyage)


def draw(results: Results, out: Path) -> None:
    ocean, surface = results.ocean, results.surface
    drifters_figures.flow(surface, out / "flow.png")
    drifters_figures.behaviour(surface, out / "behaviour.png")
    drifters_figures.absorption(surface, out / "absorption.png")
    drifters_figures.views(surface, results.views, results.sight, out / "views.png")
    drifters_check_figures.coverage(results.curves, surface.water.cells, out / "coverage.png")
    drifters_check_figures.sensitivity(results.by_step, results.by_rho, out / "sensitivity.png")
    drifters_check_figures.replays(surface.water, results.checks, out / "replay.png")
    drifters_check_figures.ridges(results.ridges, out / "ridges.png")
    for one in results.moments:
        name = f"layers_{ocean.hour(one.record):g}h.png"
        drifters_layers.moment(ocean, one, out / name)
    if results.voyages:
        found = next(iter(results.voyages.values()))
        drifters_layers.voyage(ocean, ocean.records[0], found, out / "voyage.png")
        drifters_layers.stack(ocean, ocean.records[0], found, 0, out / "voyage_stack.png")


def numbers(count: int, names: str) -> Any:
    """Make a reader of a number of values with commas between them."""

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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, nargs="?", default=GYRES, help="NetCDF with currents")
    parser.add_argument("--out", type=Path, default=Path("runs/chapter_5/drifters"))
    parser.add_argument("--hours", type=float, nargs="+", default=[1.0, 12.0, 24.0])
    parser.add_argument("--depths", type=float, nargs="+", help="metres; up to three by default")
    parser.add_argument("--step", type=float, help="hours; by default the time to cross a cell")
    parser.add_argument("--rho", type=float, default=0.8, help="probability of the image")
    parser.add_argument("--spread", default="turned", choices=("turned", "all", "sampled"))
    parser.add_argument("--start", type=place, action="append", metavar="LON,LAT")
    parser.add_argument("--goal", type=numbers(3, "LON,LAT,DEPTH"), metavar="LON,LAT,DEPTH")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def main() -> int:
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    configure_jax()
    began = time.perf_counter()
    try:
        ocean, surface, goal = asked(options)
    except (ValueError, OSError) as wrong:
        print(wrong, file=sys.stderr)
        return 2
    results = study(ocean, surface, goal, options.seed)
    found = time.perf_counter() - began
    draw(results, options.out)
    report_surface(results, options.out)
    covers = report_deployment(results, options.out)
    report_layers(results, options.out)
    report_checks(results, options.out)
    arrives = report_voyage(results, options.out)
    every = ", ".join(f"{name} {t:.0f}" for name, t in results.seconds.items())
    print(
        f"Data and figures in {options.out}; {time.perf_counter() - began:.0f} s, of which "
        f"{found:.0f} for the numbers ({every})."
    )
    return 0 if covers and arrives else 1


if __name__ == "__main__":
    raise SystemExit(main())
