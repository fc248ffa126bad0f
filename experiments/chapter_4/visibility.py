"""Sections 4.5.3 to 4.5.6 of Alam 2018: patrols with limited sight, and how vulnerable they are.

    python -m experiments.chapter_4.visibility

It takes half a minute.

The source gives its two maps as pictures without measures, so that these are maps of our own of
their size: the depot, 15 x 15 with 188 free cells, for two robots that know nothing of each other,
and the harbour, 18 x 16 with 253, for three around a base station. All see 6 cells far. Where a
number of the source stands beside one of ours, it is *of another map*: it shows what is usual, and
cannot agree. The exact law of the first arrival is what the others are held against.

An adversary attacks a cell that the base station does not watch, while each robot is in any of its
cells from which that one is not seen; it is caught if a robot comes in time to a cell that sees it.

Writes a CSV file for every table, and figures: `covers_*.png` (4.7, 4.8, 4.10 to 4.12),
`policies_*.png` (4.2, 4.9, 4.13), `targets.png` (4.14, 4.16), `arrivals.png` (4.15, 4.17),
`vulnerability.png` and `sweeps.png`. Exit status 1 if a map has not the size of the source's, if a
cell is left unseen, or if a simulated probability is four standard errors from the exact one.
"""

import argparse
import dataclasses
import math
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from jaxcell.base.runtime import configure_jax
from jaxcell.optimize import Commitment
from jaxcell.patrol.map import Reassignment, Vulnerability
from jaxcell.space import visible_cells

from ..shared.report import emit, say
from . import visibility_figures
from .visibility_site import REACH, Site, in_all_regions, policy_sets
from .visibility_tables import (
    ATTACKS,
    BY_TIME,
    LONG,
    REPEATS,
    SHORT,
    TABLES_4_6,
    Rows,
    by_robots,
    by_share,
    capture_rows,
    cover_rows,
    evaluate,
    game_rows,
    mixture_of,
    play,
    policy_rows,
    range_rows,
    reassignments,
    timed,
)


FREE = {"depot": 188, "harbour": 253}
# The robot that is lost in the figure.
LOST = 1
MOST_ROBOTS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Results:
    """The results."""

    sites: tuple[Site, Site]
    "The depot and the harbour."
    sight: tuple[float, float]
    "Seconds for what the cells of the depot see, mean and standard deviation."
    covers: Rows
    policies: Rows
    lost: Rows
    reassigned: list[Reassignment]
    "By the robot that is lost."
    caught: list[np.ndarray]
    "Of each site, by attack time and cell."
    found: list[list[Vulnerability]]
    "Of each site, at a typical cell and the weakest."
    capture: Rows
    ranges: Rows
    sets: dict[str, np.ndarray]
    "Capture by policies for the depot, in a short and in a long attack, by cell."
    mixtures: list[Commitment]
    game: Rows
    by_robots: Rows
    by_share: Rows


def study(runs: int, seed: int) -> Results:
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("patrols", total=8)

        def next_part(name: str) -> None:
            progress.update(task, advance=1, description=name)

        sites = (Site.distributed("depot", 2), Site.centralized("harbour", 3))
        depot, harbour = sites
        sight = timed(lambda: visible_cells(depot.cells, REACH))
        covers = [row for site in sites for row in cover_rows(site)]
        next_part("policies")
        policies = [row for site in sites for row in policy_rows(site)]
        next_part("a robot is lost")
        lost, reassigned = reassignments(harbour)
        next_part("all cells")
        caught = [site.caught(ATTACKS) for site in sites]
        read = harbour.caught(ATTACKS, in_all_regions(harbour))
        next_part("some cells")
        found = [evaluate(site, of, runs, seed) for site, of in zip(sites, caught, strict=True)]
        next_part("mixtures")
        sets = {name: depot.caught((SHORT, LONG), of) for name, of in policy_sets(depot).items()}
        mixtures = play(sets)
        next_part("numbers of robots")
        robots = by_robots(depot, MOST_ROBOTS)
        next_part("shares")
        shares = by_share(depot)
    ranges = [
        *range_rows(caught[0][:, depot.targets], "depot"),
        *range_rows(caught[1][:, harbour.targets], "harbour"),
        *range_rows(read[:, harbour.targets], "harbour, each robot in all regions"),
    ]
    return Results(
        sites=sites,
        sight=sight,
        covers=covers,
        policies=policies,
        lost=lost,
        reassigned=reassigned,
        caught=caught,
        found=found,
        capture=[r for s, f in zip(sites, found, strict=True) for r in capture_rows(s, f)],
        ranges=ranges,
        sets=sets,
        mixtures=mixtures,
        game=game_rows(depot, sets, mixtures),
        by_robots=robots,
        by_share=shares,
    )


# Tables and figures.


def report_patrols(results: Results, out: Path) -> None:
    emit("Covers (Table 4.4)", results.covers, out / "covers.csv", ratio=".2f")
    mean, deviation = (1000 * seconds for seconds in results.sight)
    say(
        f"""Fewest: the exact minimum, by a mixed-integer program. Times: mean and standard
        deviation of {REPEATS} calls. The source does not say whether its times hold what the cells
        see; here that is {mean:.1f} ± {deviation:.1f} ms more for the depot, once for all robots.
        """
    )
    specs = {"commute": ".0f", "at h = 0": ".0f", "gap": ".0e", "s": ".4f", "std": ".4f"}
    emit("Policies (Table 4.5)", results.policies, out / "policies.csv", ".1f", **specs)
    say(
        """Commute: its mean over pairs of vertices, in steps, and what it would be without an
        emphasis. The source's first graph has 1046 edges on 188 cells, both directions counted. It
        has 188 vertices for each centralized policy too, as many as in all regions together; the
        989 edges there are an odd number, and more than the 4 x 188 that such a graph can have."""
    )
    emit("A robot of the harbour is lost", results.lost, out / "lost.csv")
    say(
        f"""Least and mean: the probability of capture over the cells that the base station does not
        watch, for attacks of {SHORT} and of {LONG} steps. Silence: the steps without a report that
        a robot at work exceeds in at most 1 of 100 cases. Until the work is shared out, there are
        cells that no robot comes to see."""
    )


def report_capture(results: Results, out: Path) -> bool:
    """Says whether all simulations are of the exact law."""
    emit("Capture at one cell (Tables 4.6, 4.7)", results.capture, out / "capture.csv", ".4f")
    every = [one for of_site in results.found for one in of_site]
    for one in every:
        if one.fit is None:
            print(f"There is no fit for cell {one.target}: {one.failure}\n")
    fits = [one for one in every if one.fit is not None]
    fitted = max((np.abs(one.fitted - one.exact).max() for one in fits), default=math.nan)
    at_any = max((largest_gap(one) for one in fits), default=math.nan)
    simulated = [np.abs(one.simulated - one.exact).max() for one in every]
    errors = max(standard_errors(one) for one in every)
    say(
        f"""The simulated shares are within {max(simulated):.4f} of the exact law, which is
        {errors:.1f} standard errors. The fit, from which the source reads its numbers, is off by up
        to {fitted:.4f}, and at other times by up to {at_any:.4f}. Robots that begin next to the
        boundary are there in a step; four parameters do not hold both that and the long tail."""
    )
    emit("Capture at all cells", results.ranges, out / "ranges.csv", ".4f")
    for name, (told, source) in TABLES_4_6.items():
        readings = dict.fromkeys(row["of"] for row in results.ranges)
        for reading in (of for of in readings if of.startswith(name)):
            low, _, high = (
                [row[t] for t in BY_TIME] for row in results.ranges if row["of"] == reading
            )
            held = zip(ATTACKS, low, source, high, strict=True)
            inside = ", ".join(f"t = {t}" for t, a, p, b in held if a <= p <= b)
            print(f"{told} lies among the cells of '{reading}' for {inside or 'no t'}.")
    print()
    return errors <= 4


def standard_errors(one: Vulnerability) -> float:
    """By how many the simulation is off, at most."""
    runs = np.asarray(one.arrivals.time).size
    deviation = np.sqrt(one.exact * (1 - one.exact) / runs)
    return float((np.abs(one.simulated - one.exact) / np.maximum(deviation, 1e-12)).max())


def largest_gap(one: Vulnerability) -> float:
    """Between the fit and the exact law, at any time."""
    exact = np.cumsum(one.law)
    return float(np.abs(np.asarray(one.fit.law.cdf(np.arange(exact.size) + 0.5)) - exact).max())


def report_game(results: Results, out: Path) -> None:
    emit("Policies for the depot, and the best mixtures", results.game, out / "game.csv")
    best = {
        attack: max(row[f"least, {attack}"] for row in results.game[: len(results.sets)])
        for attack in (SHORT, LONG)
    }
    some = [name for name in results.sets if not name.startswith("toward")]
    few = play({name: results.sets[name] for name in some})
    for attack, one, all_of_them in zip((SHORT, LONG), few, results.mixtures, strict=True):
        say(
            f"""Attacks of {attack} steps: the best policies alone catch {best[attack]:.4f} at their
            weakest cell; the best mixture of those with different h, {one.value:.4f}; the best of
            all, {all_of_them.value:.4f}."""
        )
    say(
        """Policies with another h are weak in the same corners, so that mixing those alone gains
        nothing. It takes policies that are weak elsewhere, though alone they are worse."""
    )
    emit("Depot, by the number of robots", results.by_robots, out / "robots.csv")
    emit("Depot, by h", results.by_share, out / "shares.csv", share=".2f", commute=".0f")
    most = max(results.by_share, key=lambda row: row[f"least, {LONG}"])
    say(
        f"""An emphasis on the tour makes capture less likely on the mean. The weakest cell gains
        little, and most with h = {most["share"]}. The walk is reversible: it does not go around
        the tour, but back and forth on it, and leaves it less often."""
    )


def draw(results: Results, out: Path) -> None:
    depot, harbour = results.sites
    robots = [f"Robot {i} (Figure 4.{6 + i})" for i in (1, 2)]
    regions = [f"Region {k} (Figure 4.{9 + k})" for k in (1, 2, 3)]
    visibility_figures.covers(depot, robots, out / "covers_depot.png")
    visibility_figures.covers(harbour, regions, out / "covers_harbour.png")
    visibility_figures.policies(depot, out / "policies_depot.png")
    visibility_figures.centralized(
        harbour, results.reassigned[LOST], LOST, out / "policies_harbour.png"
    )
    visibility_figures.targets(
        results.sites, [typical for typical, _ in results.found], out / "targets.png"
    )
    visibility_figures.arrivals(results.sites, results.found, out / "arrivals.png")
    at = ATTACKS.index(LONG)
    mixed = mixture_of(results.sets, results.mixtures[1])[1]
    plain, around_base = (caught[at] for caught in results.caught)
    visibility_figures.maps(
        (depot, depot, harbour),
        (plain, mixed, around_base),
        ("depot, two robots", "depot, best mixture", "harbour, three robots"),
        LONG,
        out / "vulnerability.png",
    )
    cell_by_cell = {"h = 0.8": plain, "MAECT": results.sets["MAECT"][1], "best mixture": mixed}
    visibility_figures.sweeps(
        results.by_robots, results.by_share, cell_by_cell, LONG, out / "sweeps.png"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/chapter_4/visibility"))
    parser.add_argument("--runs", type=int, default=5000, help="simulated runs of a target")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    configure_jax()
    began = time.perf_counter()
    results = study(options.runs, options.seed)
    draw(results, options.out)
    report_patrols(results, options.out)
    same_law = report_capture(results, options.out)
    report_game(results, options.out)
    print(f"Data and figures in {options.out}; {time.perf_counter() - began:.0f} s.")
    same_size = all(site.cells.positions == FREE[site.name] for site in results.sites)
    seen = all(policy.uncovered.size == 0 for site in results.sites for policy in site.policies)
    return 0 if same_law and same_size and seen else 1


if __name__ == "__main__":
    raise SystemExit(main())
