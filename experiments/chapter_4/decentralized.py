"""Table 4.1 and Figures 4.4 and 4.5 of Alam 2018: patrollers that do not talk, and three that do.

    python -m experiments.chapter_4.decentralized

How long until the first of several robots is at a vertex. On the complete graph of 64 vertices,
robots walk at random by the weights with the minimum average expected commute time (MAECT),
placed at equal distances ("uniform") or at random in different vertices. On the cycle of 64, they
move in step by one of the models of Agmon et al. (2008): BMP, DCP and DNCP, each with the
probability p that makes the weakest segment strongest against a penetration that takes t cycles.

The vertex is drawn evenly from all 64, and one where a robot stands counts as 0 steps. The means
are exact; a simulation stands beside them, and the means of the source's 30 experiments, with how
many standard errors of a mean over 30 runs they are away.

Writes `arrivals.csv`, `arrivals.png` (Figure 4.4) and `weights.png` (Figure 4.5). Exit status 1 if
a mean of MAECT in the source is more than two standard errors away.
"""

import csv
import dataclasses
import itertools
import math
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import scipy.optimize
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from jaxcell.base.runtime import configure_jax
from jaxcell.mapping import Chain
from jaxcell.markov import Distinct, mean_first_arrival, simulate_arrival
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
from ..shared.options import experiment_parser, read_options
from .edge_weights import draw_weights


VERTICES = 64
# The cycles that a penetration takes, by the number of robots.
PENETRATION = {2: 24, 4: 12, 8: 6, 16: 3}
METHODS = ("MAECT, uniform", "MAECT, random", "BMP", "DCP", "DNCP")
# Table 4.1, by the number of robots; it has no BMP.
TABLE_4_1 = {
    2: {"MAECT, uniform": 30.35, "MAECT, random": 30.58, "DCP": 17.29, "DNCP": 20.85},
    4: {"MAECT, uniform": 14.22, "MAECT, random": 14.70, "DCP": 9.26, "DNCP": 11.74},
    8: {"MAECT, uniform": 7.11, "MAECT, random": 7.30, "DCP": 5.90, "DNCP": 6.90},
    16: {"MAECT, uniform": 3.21, "MAECT, random": 3.40, "DCP": 3.10, "DNCP": 3.16},
}
EXPERIMENTS = 30
# Figure 4.4.
SHOWN = 4
PICTURES = {
    "line": "a) a line of 20 vertices",
    "tree": "b) a tree of 30 vertices",
    "complete": "c) the complete graph of 8 vertices",
    "random": "d) a random graph of 50 vertices, 200 edges",
}


@dataclasses.dataclass(frozen=True)
class Row:
    """The first arrival of one number of robots by one method."""

    robots: int
    method: str
    p: float | None
    "The probability of heads, in a perimeter."
    exact: float
    simulated: np.ndarray
    "The time of each run."

    @property
    def source(self) -> float | None:
        return TABLE_4_1[self.robots].get(self.method)

    @property
    def deviation(self) -> float:
        return float(self.simulated.std(ddof=1))

    @property
    def away(self) -> float | None:
        """The distance of the source from the exact mean, in standard errors of the mean."""
        if self.source is None:
            return None
        return (self.source - self.exact) / (self.deviation / math.sqrt(EXPERIMENTS))


def perimeter(robots: int, movement: Movement) -> tuple[Perimeter, float]:
    """The robots on the cycle, and the p that is best against a penetration."""
    ring = Perimeter(VERTICES, robots, movement)
    return ring, maximin(detection_polynomials(ring, PENETRATION[robots])).p


def on_perimeter(ring: Perimeter, p: float) -> float:
    """The expected time until a robot is in a segment, drawn evenly."""
    return float(mean_hitting_times(ring, p)[1:].sum()) / ring.distance


def p_of_mean(ring: Perimeter, mean: float) -> float:
    """The probability of heads with which the expected time is a given one."""
    return float(scipy.optimize.brentq(lambda p: on_perimeter(ring, p) - mean, 0.01, 1))


def walkers(chain: Chain, robots: int, runs: int, key: jax.Array) -> Iterator[Row]:
    walk = [chain] * robots
    apart = VERTICES // robots
    # A shift of the vertices changes nothing, so that the target can be among the first.
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
    ring, p = perimeter(robots, movement)
    chain = ring.chain(p)
    segments = np.arange(ring.distance)
    times = simulate_arrival(key, [chain], [segments], ring.occupied, runs).time
    return Row(robots, movement.name, p, on_perimeter(ring, p), np.asarray(times))


def study(runs: int, seed: int) -> list[Row]:
    graph = Graph(list(itertools.combinations(range(VERTICES), 2)))
    chain = random_walk(graph, minimum_commute(graph).weights)
    movements = (Movement.BMP, Movement.DCP, Movement.DNCP)
    rows = []
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("robots", total=len(PENETRATION) * len(METHODS))
        for robots in PENETRATION:
            key = jax.random.fold_in(jax.random.key(seed), robots)
            for row in walkers(chain, robots, runs, key):
                rows.append(row)
                progress.advance(task)
            for number, movement in enumerate(movements):
                draw = jax.random.fold_in(key, VERTICES + 1 + number)
                rows.append(guards(robots, movement, runs, draw))
                progress.advance(task)
    return rows


# Tables and figures.


def report(rows: list[Row]) -> bool:
    """Says whether the means of MAECT in the source are those of 30 runs."""
    table = Table(title="Mean time of the first arrival: Table 4.1", box=SIMPLE_HEAD)
    table.add_column("robots", no_wrap=True)
    table.add_column("method", no_wrap=True)
    for heading in ("p", "exact", "simulated", "Alam\n2018", "errors\naway"):
        table.add_column(heading, justify="right", no_wrap=True)
    for robots, group in itertools.groupby(rows, key=lambda row: row.robots):
        told = [f"{robots}", f"d = {VERTICES // robots}", f"t = {PENETRATION[robots]}"]
        for row, first in itertools.zip_longest(group, told, fillvalue=""):
            error = row.deviation / math.sqrt(row.simulated.size)
            table.add_row(
                first,
                row.method,
                "" if row.p is None else f"{row.p:.4f}",
                f"{row.exact:.2f}",
                f"{row.simulated.mean():.2f} ± {error:.2f}",
                "" if row.source is None else f"{row.source:.2f}",
                "" if row.away is None else f"{row.away:+.2f}",
            )
        table.add_section()
    Console().print(table)
    walks = [row for row in rows if row.method.startswith("MAECT")]
    formula = max(
        abs(row.exact - (1 - row.robots / 64) / (1 - (62 / 63) ** row.robots)) for row in walks
    )
    most = max(abs(row.away) for row in walks if row.away is not None)
    ratio = max(abs(row.source / row.exact - 1) for row in walks if row.source is not None)
    print(
        "MAECT: the weights are even, and where the robots start makes no difference. With m of "
        "them the mean is\n(1 - m/64) / (1 - (62/63)^m), which the exact column has to "
        f"{formula:.0e}. The source is within {most:.2f} standard errors\nof 30 runs, and within "
        f"{ratio:.0%}: closer than means of 30 runs come eight times in a row, so each of its 30\n"
        "experiments must have been a mean itself. Standard errors are then smaller than said here."
    )
    return most <= 2


def report_readings(rows: list[Row]) -> None:
    """Tabulate other readings of the columns of DCP and DNCP."""
    table = Table(title="Other readings of DCP and DNCP", box=SIMPLE_HEAD)
    table.add_column("robots", justify="right", no_wrap=True)
    table.add_column("method", no_wrap=True)
    told = ("Alam\n2018", "mean", "with\nreturn", "in\ntime", "cut\noff", "p = 1", "p of\n2018")
    for heading in told:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        if row.source is None or row.p is None:
            continue
        ring, p = perimeter(row.robots, Movement[row.method])
        t = PENETRATION[row.robots]
        law = np.asarray(hitting_law(ring, p, t))[1:]
        cycle = np.arange(1, t + 1)
        fitted = p_of_mean(ring, row.source)
        table.add_row(
            f"{row.robots}",
            row.method,
            f"{row.source:.2f}",
            f"{row.exact:.2f}",
            f"{float(mean_hitting_times(ring, p).mean()):.2f}",
            f"{(law @ cycle).sum() / law.sum():.2f}",
            f"{(law @ cycle + t * (1 - law.sum(axis=1))).mean():.2f}",
            f"{on_perimeter(ring, 1.0):.2f}",
            f"{fitted:.3f}",
        )
    Console().print(table)
    print(
        "With return: in the segment of a robot, one has to come back. In time: the mean over "
        "penetrations that are\ndetected. Cut off: those that are not count as t. p = 1: robots "
        "that never turn. p of 2018: with this p the\nmean is that of the source.\n"
        "No column is that of the source. Even as means of 30 single runs, its DCP would be more "
        "than two standard errors\naway with 2 and with 4 robots. It has DCP before DNCP, although "
        "a turn costs DCP a cycle and DNCP none; and for\nfew robots both are near those of robots "
        "that hardly ever turn, whose next cycles an adversary can foresee.\n"
        "As in Figure 4.4, MAECT is far faster than BMP with 4 robots. The source finds it slower "
        "than DCP and DNCP, the\nless so the more robots there are. Here it is the other way "
        "round: faster than both with 2 robots, between them\nwith 4, and slower than DNCP with 8 "
        "and than both with 16, which gain from being spread evenly on a cycle."
    )


def save(rows: list[Row], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        names = ["robots", "distance", "penetration", "method", "p", "exact", "simulated"]
        writer = csv.DictWriter(file, [*names, "deviation", "runs", "Alam 2018"])
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {
                    "robots": row.robots,
                    "distance": VERTICES // row.robots,
                    "penetration": PENETRATION[row.robots],
                    "method": row.method,
                    "p": row.p,
                    "exact": row.exact,
                    "simulated": row.simulated.mean(),
                    "deviation": row.deviation,
                    "runs": row.simulated.size,
                    "Alam 2018": row.source,
                }
            )


def draw_arrivals(rows: list[Row], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colors = dict(
        zip(METHODS, ("#0072b2", "#56b4e9", "#999999", "#d55e00", "#009e73"), strict=True)
    )
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
    told = [(at + 0.12, row.source) for at, row in zip(place, shown, strict=True) if row.source]
    left.plot(*zip(*told, strict=True), "x", color="crimson", ms=8, mew=2, label="Alam 2018, mean")
    left.set_xticks(place, [row.method.replace(", ", "\n") for row in shown])
    left.set_ylabel("time of the first arrival (steps)")
    left.set_title(f"{SHOWN} robots: quartiles, and 5 % to 95 % (Figure 4.4)", fontsize=10)
    left.legend(frameon=False)
    for method in METHODS:
        of_method = [row for row in rows if row.method == method]
        robots = [row.robots for row in of_method]
        if method != "MAECT, uniform":
            label = method.replace(", random", "")
            right.plot(
                robots,
                [row.exact for row in of_method],
                "-D",
                ms=4,
                color=colors[method],
                label=label,
            )
        if method != "BMP":
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
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_graphs(path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

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
    figure.suptitle("Weights with the minimum commute time, by width and colour (Figure 4.5)")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_4/decentralized", seed=0)
    parser.add_argument("--runs", type=int, default=20_000, help="runs of a method")
    options = read_options(parser)

    configure_jax()
    began = time.perf_counter()
    rows = study(options.runs, options.seed)
    save(rows, options.out / "arrivals.csv")
    draw_arrivals(rows, options.out / "arrivals.png")
    draw_graphs(options.out / "weights.png")
    agree = report(rows)
    report_readings(rows)
    print(f"Data and figures in {options.out}; {time.perf_counter() - began:.0f} s.")
    return 0 if agree else 1


if __name__ == "__main__":
    raise SystemExit(main())
