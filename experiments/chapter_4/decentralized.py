"""Table 4.1 and Figures 4.4 and 4.5 of Alam 2018: independent and synchronized patrollers.

    python -m experiments.chapter_4.decentralized

The script computes the time until the first of several robots arrives at a vertex. On the complete
graph of 64 vertices, robots walk at random by the weights with the least average expected commute
time (MAECT). They start at equal distances ("uniform"), or at random different vertices. On the
cycle of 64 vertices, they move in step by one of the models of Agmon et al. (2008): BMP, DCP and
DNCP. The probability p of each model maximizes the least detection of a penetration over the
segments, if a penetration takes t cycles.

The vertex is drawn uniformly from all 64, and a vertex with a robot counts as 0 steps. The table
has the exact means, simulated means, the means of 30 experiments in the source, and the distance of
the source from the exact means in standard errors of a mean over 30 runs.

The source's columns of DCP and DNCP fit a reading in which the simulated robots do not keep their
heading ("no heading"): with the p of the model, all robots move one segment clockwise with
probability p, and otherwise one back (DNCP) or not at all (DCP). The mean is over the segments
without a robot.

The script writes `arrivals.csv`, `arrivals.png` (Figure 4.4) and `weights.png` (Figure 4.5). The
exit status is 1 if a mean of MAECT in the source is more than two standard errors away, or if a
chi-squared test at 5 % rejects the reading of DCP and DNCP.
"""

import dataclasses
import itertools
import math
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import scipy.optimize
import scipy.stats

from jaxcell.base.runtime import configure_jax
from jaxcell.mapping import Chain
from jaxcell.markov import Distinct, hitting_times, mean_first_arrival, simulate_arrival
from jaxcell.optimize import minimum_commute
from jaxcell.patrol import Graph, load_graph, random_walk
from jaxcell.patrol.perimeter import (
    Movement,
    Perimeter,
    detection_polynomials,
    hitting_law,
    maximin,
    mean_hitting_times,
)

from ..shared.data import GRAPHS
from ..shared.figures import plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import emit, say, show, tracked
from .edge_weights import draw_weights


VERTICES = 64
# The number t of cycles of a penetration, by the number of robots.
PENETRATION = {2: 24, 4: 12, 8: 6, 16: 3}
NO_HEADING = ", no heading"
METHODS = (
    "MAECT, uniform",
    "MAECT, random",
    "BMP",
    "DCP",
    "DNCP",
    f"DCP{NO_HEADING}",
    f"DNCP{NO_HEADING}",
)
# Table 4.1, by the number of robots; it has no BMP.
TABLE_4_1 = {
    2: {"MAECT, uniform": 30.35, "MAECT, random": 30.58, "DCP": 17.29, "DNCP": 20.85},
    4: {"MAECT, uniform": 14.22, "MAECT, random": 14.70, "DCP": 9.26, "DNCP": 11.74},
    8: {"MAECT, uniform": 7.11, "MAECT, random": 7.30, "DCP": 5.90, "DNCP": 6.90},
    16: {"MAECT, uniform": 3.21, "MAECT, random": 3.40, "DCP": 3.10, "DNCP": 3.16},
}
EXPERIMENTS = 30
_COLORS = ("#0072b2", "#56b4e9", "#999999", "#d55e00", "#009e73", "#e69f00", "#66c2a5")
# The number of robots of Figure 4.4.
SHOWN = 4
PICTURES = {
    "line": "a) a line of 20 vertices",
    "tree": "b) a tree of 30 vertices",
    "complete": "c) the complete graph of 8 vertices",
    "random": "d) a random graph of 50 vertices, 200 edges",
}


@dataclasses.dataclass(frozen=True)
class Row:
    """The time of the first arrival, by number of robots and method."""

    robots: int
    method: str
    p: float | None
    "Parameter of the models on the cycle; `None` for MAECT."
    exact: float
    simulated: np.ndarray
    "The simulated time of each run."

    @property
    def source(self) -> float | None:
        return TABLE_4_1[self.robots].get(self.method.removesuffix(NO_HEADING))

    @property
    def deviation(self) -> float:
        return float(self.simulated.std(ddof=1))

    @property
    def away(self) -> float | None:
        """Distance of the source from the exact mean, in standard errors over 30 runs."""
        if self.source is None:
            return None
        return (self.source - self.exact) / (self.deviation / math.sqrt(EXPERIMENTS))


def perimeter(robots: int, movement: Movement) -> tuple[Perimeter, float]:
    """Make robots on the cycle, and compute their best p against a penetration."""
    ring = Perimeter(VERTICES, robots, movement)
    return ring, maximin(detection_polynomials(ring, PENETRATION[robots])).p


def on_perimeter(ring: Perimeter, p: float) -> float:
    """Compute the expected time until a robot is in a random segment."""
    return float(mean_hitting_times(ring, p)[1:].sum()) / ring.distance


def p_of_mean(ring: Perimeter, mean: float) -> float:
    """Compute the p with which the expected time is `mean`."""
    return float(scipy.optimize.brentq(lambda p: on_perimeter(ring, p) - mean, 0.01, 1))


def walkers(chain: Chain, robots: int, runs: int, key: jax.Array) -> Iterator[Row]:
    """Yield the rows of MAECT with uniform and with random starts."""
    walk = [chain] * robots
    apart = VERTICES // robots
    # By symmetry, targets between the first two robots suffice.
    even = np.arange(0, VERTICES, apart)
    means, times = [], []
    for target in range(apart):
        means.append(mean_first_arrival(walk, list(even), target).value)
        part = simulate_arrival(
            jax.random.fold_in(key, target), walk, list(even), target, runs // apart
        )
        times.append(np.asarray(part.time))
    yield Row(robots, "MAECT, uniform", None, float(np.mean(means)), np.concatenate(times))
    anywhere = Distinct(np.arange(VERTICES))
    exact = mean_first_arrival(walk, anywhere, 0).value
    times = simulate_arrival(jax.random.fold_in(key, VERTICES), walk, anywhere, 0, runs).time
    yield Row(robots, "MAECT, random", None, exact, np.asarray(times))


def guards(robots: int, movement: Movement, runs: int, key: jax.Array) -> Row:
    """Compute the row of a model on the cycle."""
    ring, p = perimeter(robots, movement)
    chain = ring.chain(p)
    segments = np.arange(ring.distance)
    times = simulate_arrival(key, [chain], [segments], ring.occupied, runs).time
    return Row(robots, movement.name, p, on_perimeter(ring, p), np.asarray(times))


def without_heading(robots: int, movement: Movement, runs: int, key: jax.Array) -> Row:
    """Compute the row of robots that do not keep their heading, with the p of the model."""
    ring, p = perimeter(robots, movement)
    segment = np.arange(ring.distance, dtype=np.int32)
    back = (segment + 1) % ring.distance if movement is Movement.DNCP else segment
    coin = np.broadcast_to([[p], [1 - p]], (2, ring.distance))
    chain = Chain(np.stack([(segment - 1) % ring.distance, back]), coin)
    there = segment == 0
    exact = float(np.asarray(hitting_times(chain, there).value)[1:].mean())
    times = simulate_arrival(key, [chain], [segment[1:]], there, runs).time
    return Row(robots, f"{movement.name}{NO_HEADING}", p, exact, np.asarray(times))


def study(runs: int, seed: int) -> list[Row]:
    """Compute the rows of all numbers of robots and methods."""
    graph = Graph(list(itertools.combinations(range(VERTICES), 2)))
    chain = random_walk(graph, minimum_commute(graph).weights)
    movements = (Movement.BMP, Movement.DCP, Movement.DNCP)
    rows = []
    for robots in tracked(PENETRATION, "numbers of robots"):
        key = jax.random.fold_in(jax.random.key(seed), robots)
        rows += walkers(chain, robots, runs, key)
        for number, movement in enumerate(movements):
            draw = jax.random.fold_in(key, VERTICES + 1 + number)
            rows.append(guards(robots, movement, runs, draw))
            if movement is not Movement.BMP:
                rows.append(without_heading(robots, movement, runs, jax.random.fold_in(draw, 1)))
    return rows


# Tables and figures.


def report(rows: list[Row], path: Path) -> bool:
    """Print and write Table 4.1; returns `True` if the source agrees with means of 30 runs."""
    table = [
        {
            "robots": row.robots,
            "distance": VERTICES // row.robots,
            "penetration": PENETRATION[row.robots],
            "method": row.method,
            "p": row.p,
            "exact": row.exact,
            "simulated": float(row.simulated.mean()),
            "error": row.deviation / math.sqrt(row.simulated.size),
            "deviation": row.deviation,
            "runs": row.simulated.size,
            "Alam 2018": row.source,
            "errors away": row.away,
        }
        for row in rows
    ]
    specs = {"p": ".4f", "errors away": "+.2f"}
    emit("Mean time of the first arrival: Table 4.1", table, path, ".2f", **specs)
    walks = [row for row in rows if row.method.startswith("MAECT")]
    formula = max(
        abs(row.exact - (1 - row.robots / 64) / (1 - (62 / 63) ** row.robots)) for row in walks
    )
    most = max(abs(row.away) for row in walks if row.away is not None)
    ratio = max(abs(row.source / row.exact - 1) for row in walks if row.source is not None)
    say(
        f"""MAECT: all weights are equal, and the starts of the robots make no difference. With m
        robots the mean is (1 - m/64) / (1 - (62/63)^m), which differs from the exact column by at
        most {formula:.0e}. The source is within {most:.2f} standard errors of 30 runs, and within
        {ratio:.0%}. Eight means of 30 runs would hardly all be so close, so each of the 30
        experiments was probably a mean itself, with smaller standard errors than here."""
    )
    apart = [row.away for row in rows if row.method.endswith(NO_HEADING) and row.away is not None]
    chi_squared = sum(away**2 for away in apart)
    rejected = float(scipy.stats.chi2.isf(0.05, len(apart)))
    say(
        f"""DCP and DNCP: if the simulated robots do not keep their heading, chi-squared is
        {chi_squared:.1f} for {len(apart)} means of 30 runs; a test at 5 % rejects above
        {rejected:.1f}. This reading fits, which does not prove that the source simulated it."""
    )
    return most <= 2 and chi_squared <= rejected


def report_readings(rows: list[Row]) -> None:
    """Print readings of the columns of DCP and DNCP in which robots keep their heading."""
    table = []
    for row in rows:
        if row.source is None or row.p is None or row.method.endswith(NO_HEADING):
            continue
        ring, p = perimeter(row.robots, Movement[row.method])
        t = PENETRATION[row.robots]
        law = np.asarray(hitting_law(ring, p, t))[1:]
        cycle = np.arange(1, t + 1)
        table.append(
            {
                "robots": row.robots,
                "method": row.method,
                "Alam, 2018": row.source,
                "mean": row.exact,
                "with, return": float(mean_hitting_times(ring, p).mean()),
                "in, time": float((law @ cycle).sum() / law.sum()),
                "cut, off": float((law @ cycle + t * (1 - law.sum(axis=1))).mean()),
                "p = 1": on_perimeter(ring, 1.0),
                "p of, 2018": p_of_mean(ring, row.source),
            }
        )
    show("Other readings of DCP and DNCP, with headings", table, ".2f", **{"p of, 2018": ".3f"})
    say(
        """With return: if the segment has a robot, the time until a robot returns. In time: the
        mean over detected penetrations. Cut off: undetected penetrations count as t. p = 1: robots
        that never turn. p of 2018: the p with which the mean is that of the source.""",
        """No column agrees with the source. With headings DCP would be more than two standard
        errors away with 2 and with 4 robots. In the source DCP is faster than DNCP, although with
        headings a turn costs DCP a cycle and DNCP none.""",
        """As in Figure 4.4, MAECT is far faster than BMP with 4 robots. In the source MAECT is
        slower than DCP and DNCP, and less so with more robots. With headings it is the opposite:
        MAECT is faster than both with 2 robots, between them with 4, slower than DNCP with 8, and
        slower than both with 16, which gain from equal distances on a cycle.""",
    )


def draw_arrivals(rows: list[Row], path: Path) -> None:
    """Draw the simulated times of four robots, and the means by the number of robots."""
    colors = dict(zip(METHODS, _COLORS, strict=True))
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    shown = [row for row in rows if row.robots == SHOWN]
    boxes = left.boxplot(
        [row.simulated for row in shown],
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        widths=0.55,
        medianprops={"color": "black", "linewidth": 1.4},
    )
    for box, row in zip(boxes["boxes"], shown, strict=True):
        box.set(facecolor=colors[row.method], alpha=0.55)
    place = np.arange(1, len(shown) + 1)
    exact = [row.exact for row in shown]
    left.plot(place - 0.12, exact, "D", color="black", ms=5, label="exact mean")
    known = [(at + 0.12, row.source) for at, row in zip(place, shown, strict=True) if row.source]
    left.plot(*zip(*known, strict=True), "x", color="crimson", ms=8, mew=2, label="Alam 2018, mean")
    left.set_xticks(place, [row.method.replace(", ", "\n") for row in shown])
    left.set_ylabel("time of the first arrival (steps)")
    left.set_title(f"{SHOWN} robots: quartiles, and 5 % to 95 % (Figure 4.4)", fontsize=10)
    left.legend(frameon=False)
    for method in METHODS:
        of_method = [row for row in rows if row.method == method]
        robots = [row.robots for row in of_method]
        if method != "MAECT, uniform":
            exact = [row.exact for row in of_method]
            label = method.replace(", random", "")
            right.plot(robots, exact, "-D", ms=4, color=colors[method], label=label)
        if of_method[0].source is not None and not method.endswith(NO_HEADING):
            sources = [row.source for row in of_method]
            right.plot(1.06 * np.array(robots), sources, "x", ms=8, mew=2, color=colors[method])
    right.plot([], [], "x", ms=8, mew=2, color="0.3", label="Alam 2018")
    right.set_xscale("log", base=2)
    right.set_yscale("log")
    right.set_xticks(list(PENETRATION), [f"{m}" for m in PENETRATION])
    right.set_yticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])
    right.set_xlabel("robots")
    right.set_ylabel("mean time of the first arrival (steps)")
    right.set_title("Exact means, and those of Table 4.1", fontsize=10)
    right.legend(frameon=False)
    save(figure, path)


def draw_graphs(path: Path) -> None:
    """Draw the weights of graphs of the kinds of Figure 4.5."""
    figure = plt.figure(figsize=(12, 7.6), layout="constrained")
    panels = figure.subplot_mosaic(
        [["line", "line"], ["tree", "random"], ["complete", "random"]],
        height_ratios=[0.25, 1.15, 1],
        width_ratios=[1, 1.45],
    )
    for name, title in PICTURES.items():
        graph, _ = load_graph(GRAPHS / f"{name}.json")
        weights = minimum_commute(graph).weights
        draw_weights(panels[name], graph, weights, widest=5, diameter=7)
        panels[name].set_title(f"{title}, weights up to {weights.max():.3f}", fontsize=10)
    figure.suptitle("Weights with the least commute time, by width and colour (Figure 4.5)")
    save(figure, path)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_4/decentralized", seed=0)
    parser.add_argument("--runs", type=at_least(64), default=20_000, help="simulated runs")
    options = read_options(parser)

    configure_jax()
    began = time.perf_counter()
    rows = study(options.runs, options.seed)
    draw_arrivals(rows, options.out / "arrivals.png")
    draw_graphs(options.out / "weights.png")
    agree = report(rows, options.out / "arrivals.csv")
    report_readings(rows)
    print(f"Data and figures in {options.out}; {time.perf_counter() - began:.0f} s.")
    return 0 if agree else 1


if __name__ == "__main__":
    raise SystemExit(main())
