"""Sections 4.5.3 to 4.5.6 of Alam 2018: patrols with limited sight, and how vulnerable they are.

    python -m experiments.chapter_4.visibility

It takes half a minute.

The source shows its two maps as pictures without measures, so these are other maps of the same
size: the depot, 15 x 15 with 188 free cells, for two independent robots, and the harbour, 18 x 16
with 253, for three robots around a base station. All see 6 cells far. Numbers of the source beside
ours are *for another map*: they show what is usual, and cannot agree. The exact law of the first
arrival is the reference for simulations and fits.

An adversary attacks a cell that the base station does not see, while each robot is in a random one
of its cells from which the attacked cell is not visible. A robot catches the adversary if it
reaches in time a cell from which the attacked cell is visible.

The script writes a CSV file for every table, and figures: `covers_*.png` (4.7, 4.8, 4.10 to 4.12),
`policies_*.png` (4.2, 4.9, 4.13), `targets.png` (4.14, 4.16), `arrivals.png` (4.15, 4.17),
`vulnerability.png` and `sweeps.png`. The exit status is 1 if a map differs in size from that of the
source, if a cell remains unseen, or if a simulated probability differs from the exact one by more
than four standard errors.
"""

import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxcell.base.runtime import configure_jax
from jaxcell.patrol.map import Vulnerability
from jaxcell.space import visible_cells

from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import emit, say
from . import visibility_figures as figures
from .visibility_site import REACH, Site, in_all_regions, policy_sets
from .visibility_tables import (
    ATTACKS,
    BY_TIME,
    LONG,
    REPEATS,
    SHORT,
    TABLES_4_6,
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
# The lost robot of the figure.
LOST = 1
MOST_ROBOTS = 4


def patrols(depot: Site, harbour: Site, out: Path) -> None:
    """Report the covers and the policies of both maps, and the loss of a robot."""
    sight = timed(lambda: visible_cells(depot.cells, REACH))
    covers = [row for site in (depot, harbour) for row in cover_rows(site)]
    emit("Covers (Table 4.4)", covers, out / "covers.csv", ratio=".2f")
    mean, deviation = (1000 * seconds for seconds in sight)
    say(
        f"""Fewest: the exact minimum, by a mixed-integer program. Times: mean and standard
        deviation of {REPEATS} calls. It is unknown if the times of the source include visibility;
        here visibility takes {mean:.1f} ± {deviation:.1f} ms more for the depot, once for all
        robots."""
    )
    policies = [row for site in (depot, harbour) for row in policy_rows(site)]
    specs = {"commute": ".0f", "at h = 0": ".0f", "gap": ".0e", "s": ".4f", "std": ".4f"}
    emit("Policies (Table 4.5)", policies, out / "policies.csv", ".1f", **specs)
    say(
        """Commute: mean commute time over pairs of vertices, in steps; at h = 0: without an
        emphasis. The first graph of the source has 1046 edges on 188 cells, counted in both
        directions. The source has 188 vertices for each centralized policy too, as many as in all
        regions together; its 989 edges there are an odd number, and more than the 4 x 188 that such
        a graph can have."""
    )
    lost, reassigned = reassignments(harbour)
    emit("A robot of the harbour is lost", lost, out / "lost.csv")
    say(
        f"""Least and mean: the probability of capture over the cells that the base station does not
        see, for attacks of {SHORT} and {LONG} steps. Silence: the number of steps without a report
        that a working robot exceeds with probability at most 0.01. Before the work is reassigned,
        no robot sees some of the cells."""
    )
    titles = [f"Robot {i} (Figure 4.{6 + i})" for i in (1, 2)]
    figures.covers(depot, titles, out / "covers_depot.png")
    titles = [f"Region {k} (Figure 4.{9 + k})" for k in (1, 2, 3)]
    figures.covers(harbour, titles, out / "covers_harbour.png")
    figures.policies(depot, out / "policies_depot.png")
    figures.centralized(harbour, reassigned[LOST], LOST, out / "policies_harbour.png")


def capture(
    sites: Sequence[Site], caught: Sequence[np.ndarray], runs: int, seed: int, out: Path
) -> bool:
    """Report capture at two cells of each map and at all cells.

    Returns `True` if all simulations agree with the exact law.

    **Arguments:**

    - `caught`: probabilities of capture of each map, `[attack times, cells]`.
    """
    pairs = list(zip(sites, caught, strict=True))
    found = [evaluate(site, of, runs, seed) for site, of in pairs]
    rows = [row for site, of in zip(sites, found, strict=True) for row in capture_rows(site, of)]
    emit("Capture at one cell (Tables 4.6, 4.7)", rows, out / "capture.csv", ".4f")
    every = [one for of_site in found for one in of_site]
    for one in every:
        if one.fit is None:
            print(f"There is no fit for cell {one.target}: {one.failure}\n")
    fits = [one for one in every if one.fit is not None]
    fitted = max((np.abs(one.fitted - one.exact).max() for one in fits), default=math.nan)
    at_any = max((largest_gap(one) for one in fits), default=math.nan)
    simulated = max(np.abs(one.simulated - one.exact).max() for one in every)
    errors = max(standard_errors(one) for one in every)
    say(
        f"""The simulated shares differ from the exact law by at most {simulated:.4f}, or
        {errors:.1f} standard errors. The fit, from which the source reads its numbers, differs by
        up to {fitted:.4f}, and at other times by up to {at_any:.4f}. Robots that start beside the
        boundary reach it in a step, and four parameters cannot fit both this and the long tail."""
    )
    harbour = sites[1]
    read = harbour.caught(ATTACKS, in_all_regions(harbour))
    cases = [(site.name, site, of) for site, of in pairs]
    cases.append(("harbour, each robot in all regions", harbour, read))
    rows = [row for name, site, of in cases for row in range_rows(of[:, site.targets], name)]
    emit("Capture at all cells", rows, out / "ranges.csv", ".4f")
    for map_name, (table, source) in TABLES_4_6.items():
        for reading in (name for name, *_ in cases if name.startswith(map_name)):
            low, _, high = ([row[t] for t in BY_TIME] for row in rows if row["of"] == reading)
            held = zip(ATTACKS, low, source, high, strict=True)
            inside = ", ".join(f"t = {t}" for t, a, p, b in held if a <= p <= b)
            print(f"{table} lies in the range of the cells of '{reading}' for {inside or 'no t'}.")
    print()
    figures.targets(sites, [typical for typical, _ in found], out / "targets.png")
    figures.arrivals(sites, found, out / "arrivals.png")
    return bool(errors <= 4)


def standard_errors(one: Vulnerability) -> float:
    """Compute the largest difference of the simulation from the exact law, in standard errors."""
    runs = np.asarray(one.arrivals.time).size
    deviation = np.sqrt(one.exact * (1 - one.exact) / runs)
    return float((np.abs(one.simulated - one.exact) / np.maximum(deviation, 1e-12)).max())


def largest_gap(one: Vulnerability) -> float:
    """Compute the largest difference of the fit from the exact law over all times."""
    exact = np.cumsum(one.law)
    return float(np.abs(np.asarray(one.fit.law.cdf(np.arange(exact.size) + 0.5)) - exact).max())


def game(sites: Sequence[Site], caught: Sequence[np.ndarray], out: Path) -> None:
    """Report mixtures of policies for the depot, and other numbers of robots and emphases."""
    depot, harbour = sites
    sets = {name: depot.caught((SHORT, LONG), of) for name, of in policy_sets(depot).items()}
    mixtures = play(sets)
    rows = game_rows(depot, sets, mixtures)
    emit("Policies for the depot, and the best mixtures", rows, out / "game.csv")
    few = play({name: of for name, of in sets.items() if not name.startswith("toward")})
    for attack, some, every in zip((SHORT, LONG), few, mixtures, strict=True):
        best = max(row[f"least, {attack}"] for row in rows[: len(sets)])
        say(
            f"""Attacks of {attack} steps: the best single policies have probability {best:.4f} at
            their weakest cell, the best mixture of policies with different h {some.value:.4f}, and
            the best mixture of all policies {every.value:.4f}."""
        )
    say(
        """Policies that differ in h are weak in the same corners, so mixing only these gains
        nothing. A gain needs policies that are weak elsewhere, though alone they are worse."""
    )
    robots, shares = by_robots(depot, MOST_ROBOTS), by_share(depot)
    emit("Depot, by the number of robots", robots, out / "robots.csv")
    emit("Depot, by h", shares, out / "shares.csv", share=".2f", commute=".0f")
    most = max(shares, key=lambda row: row[f"least, {LONG}"])
    say(
        f"""An emphasis on the tour lowers the mean probability of capture. The weakest cell gains
        little, and most with h = {most["share"]}. The walk is reversible: it goes back and forth on
        the tour, not around it, and leaves it less often."""
    )
    plain, around_base = (of[ATTACKS.index(LONG)] for of in caught)
    mixed = mixture_of(sets, mixtures[1])[1]
    figures.maps(
        (depot, depot, harbour),
        (plain, mixed, around_base),
        ("depot, two robots", "depot, best mixture", "harbour, three robots"),
        LONG,
        out / "vulnerability.png",
    )
    by_cell = {"h = 0.8": plain, "MAECT": sets["MAECT"][1], "best mixture": mixed}
    figures.sweeps(robots, shares, by_cell, LONG, out / "sweeps.png")


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_4/visibility", seed=0)
    parser.add_argument(
        "--runs", type=at_least(2), default=5000, help="simulated runs for each attacked cell"
    )
    options = read_options(parser)

    configure_jax()
    began = time.perf_counter()
    sites = Site.distributed("depot", 2), Site.centralized("harbour", 3)
    caught = [site.caught(ATTACKS) for site in sites]
    patrols(*sites, options.out)
    same_law = capture(sites, caught, options.runs, options.seed, options.out)
    game(sites, caught, options.out)
    print(f"Data and figures in {options.out}; {time.perf_counter() - began:.0f} s.")
    same_size = all(site.cells.positions == FREE[site.name] for site in sites)
    seen = all(policy.uncovered.size == 0 for site in sites for policy in site.policies)
    return 0 if same_law and same_size and seen else 1


if __name__ == "__main__":
    raise SystemExit(main())
