"""Tables 4.2 and 4.3 of Alam 2018: ten strategies on a small graph, and the best mixture of them.

    python -m experiments.chapter_4.game

The strategies are a walk toward each of the eight vertices (Alg. 4.1), and the walks with the
minimum average expected commute time, over all vertices and with an emphasis on three of them.
What a strategy pays depends on the order of the vertices by mean hitting time alone (Alg. 4.2), so
Table 4.2 tells ten orders, which stand beside ours.

Alg. 4.1 counts the steps of the shortest paths to the vertex, each in its own direction as printed,
and one path from each vertex. The hitting time is then the number of edges to go, and all eight
rows have the order of the source; that of vertices with equally many is left open.

Writes `orders.csv`, and `strategies.png` (Figure 4.6). Exit status 1 if a row, the payoffs, or the
value of the game disagrees with the source.
"""

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from jaxcell.base.runtime import configure_jax
from jaxcell.optimize import payoffs, stackelberg
from jaxcell.patrol import Graph, load_graph, strategy_game, toward
from jaxcell.patrol.walks import StrategyGame, measure

from ..shared.data import GRAPHS
from ..shared.options import experiment_parser, read_options
from .edge_weights import draw_weights


GRAPH = GRAPHS / "eight.json"
PATHS = 1
EMPHASIS = (1, 4, 7)
# The source does not tell it; from 0.6 to 0.95 the order is the same.
SHARE = 0.8

# The vertices by falling payoff of the patroller, in the rows of Table 4.2.
TABLE_4_2 = {
    "toward 1": (1, 5, 2, 7, 6, 8, 3, 4),
    "toward 2": (2, 8, 3, 4, 7, 1, 5, 6),
    "toward 3": (3, 4, 2, 7, 8, 1, 5, 6),
    "toward 4": (4, 3, 8, 2, 1, 7, 5, 6),
    "toward 5": (5, 6, 7, 1, 2, 8, 3, 4),
    "toward 6": (6, 5, 7, 3, 1, 8, 2, 4),
    "toward 7": (7, 8, 2, 3, 6, 5, 4, 1),
    "toward 8": (8, 4, 2, 7, 3, 1, 6, 5),
    "all vertices": (7, 2, 5, 3, 8, 1, 4, 6),
    "2, 5 and 8": (8, 2, 5, 1, 7, 4, 6, 3),
}
# Payoffs of every row for the patroller and the adversary at its first vertex, its second, ...
PATROLLER = (8.0, 3.5625, 1.5938, 0.7344, 0.3672, 0.2148, 0.1543, 0.1318)
ADVERSARY = (1.0, 1.0625, 0.8438, 0.6094, 0.4297, 0.3086, 0.2324, 0.1865)
# Table 4.3, and what the adversary then attacks.
MIXTURE = (0, 0, 0, 0, 0, 0, 0.9012, 0, 0.0988, 0)
ATTACKED = 7
VALUE = 8.0
METHODS = {"dobss": "DOBSS", "multiple-lp": "multiple LP"}

# Hitting times that differ by less, relatively, are equal.
ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class Row:
    """A strategy and its order of the vertices, numbered from 1, beside that of the source."""

    strategy: str
    preferred: tuple[int, ...]
    weights: np.ndarray
    order: np.ndarray
    source: np.ndarray
    apart: float
    """By how much, relatively, the times of vertices that change places differ, at most; `inf`
    where the strategy leaves no choice, and no vertex ought to."""

    @property
    def agrees(self) -> bool:
        return self.apart <= ROUNDING

    @property
    def verdict(self) -> str:
        if np.array_equal(self.order, self.source):
            return "agrees"
        if self.agrees:
            return "agrees up to ties"
        return f"differs by {self.apart:.1%}" if math.isfinite(self.apart) else "DIFFERS"


def out_of_order(times: np.ndarray, order: np.ndarray) -> float:
    """The largest relative difference of two times that are in the wrong order."""
    sorted_as = times[order - 1]
    later_least = np.minimum.accumulate(sorted_as[::-1])[::-1]
    return float(((sorted_as - later_least) / sorted_as.clip(min=ROUNDING)).max())


def apart_toward(graph: Graph, target: int, source: np.ndarray) -> float:
    """Count the times of the walk toward a vertex that are out of the order of the source."""
    times = measure(toward(graph, target, PATHS)).hitting_time[:, target]
    return out_of_order(times, source)


def compare(graph: Graph, game: StrategyGame) -> list[Row]:
    rows = []
    for number, (name, source) in enumerate(TABLE_4_2.items()):
        source, order = np.array(source), game.closest[number] + 1
        if number < graph.vertices:
            apart = apart_toward(graph, number, source)
        else:
            apart = 0.0 if np.array_equal(order, source) else math.inf
        preferred = game.preferred[number]
        rows.append(Row(name, preferred, game.weight[number], order, source, apart))
    return rows


def report_orders(rows: list[Row]) -> None:
    table = Table(title="Vertices by mean hitting time: Table 4.2", box=SIMPLE_HEAD)
    for heading in ("strategy", "Alam 2018", "jaxcell", ""):
        table.add_column(heading, no_wrap=True)
    for row in rows:
        both = [" ".join(str(v) for v in order) for order in (row.source, row.order)]
        table.add_row(row.strategy, *both, row.verdict)
    Console().print(table)
    towards = rows[:8]
    print(
        f"Toward a vertex, {sum(row.agrees for row in towards)} of 8 rows agree.\n"
        "Over all vertices, 3 and 8 are equally far by symmetry."
    )


# The game.


def face(leader: np.ndarray, follower: np.ndarray) -> tuple[float, float]:
    """The shares of strategy 7, in a mixture with 9, under which an attack on 7 is answer enough.

    Both are paid most at vertex 7, so all these mixtures have the value of the one of Table 4.3.
    """
    target = ATTACKED - 1
    assert leader[6, target] == leader[8, target] == leader.max()
    slope = follower[6] - follower[6, target] - (follower[8] - follower[8, target])
    room = follower[8, target] - follower[8]
    at_most = min((r / s for r, s in zip(room, slope, strict=True) if s > 0), default=1.0)
    at_least = max((r / s for r, s in zip(room, slope, strict=True) if s < 0), default=0.0)
    return max(0.0, at_least), min(1.0, at_most)


def report_game(game: StrategyGame) -> bool:
    """Compares the game, and says whether its payoffs and its value agree."""
    source = np.array(list(TABLE_4_2.values())) - 1
    leader, follower = (np.asarray(side) for side in payoffs(source))
    row = np.arange(len(source))[:, None]
    same_payoffs = all(
        np.allclose(side[row, source], expected, rtol=0, atol=5.1e-5)
        for side, expected in ((leader, PATROLLER), (follower, ADVERSARY))
    )
    print(f"\nThe orders of Table 4.2 have its payoffs: {'yes' if same_payoffs else 'NO'}.\n")
    mixture, target = np.array(MIXTURE), ATTACKED - 1
    value, replies = float(mixture @ leader[:, target]), mixture @ follower
    found = [
        (f"{name}, {METHODS[method]}", stackelberg(*sides, method=method))
        for name, sides in (
            ("Table 4.2", (leader, follower)),
            ("our orders", (game.patroller_payoff, game.adversary_payoff)),
        )
        for method in METHODS
    ]
    table = Table(title="The best mixture of the strategies: Table 4.3", box=SIMPLE_HEAD)
    table.add_column("payoffs and method", no_wrap=True)
    for heading in ("value", "attacked", "of 7", "of 9", "others"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_row("Alam 2018", f"{value:.6f}", f"{ATTACKED}", *shares(mixture))
    for name, one in found:
        attacked = f"{int(one.answer[0]) + 1}"
        table.add_row(name, f"{one.value:.6f}", attacked, *shares(np.asarray(one.weights)))
    Console().print(table)
    low, high = face(leader, follower)
    rival = int(np.argsort(replies)[-2])
    print(
        "The source tells no value; it is that of its mixture. Nothing pays more than 8, so "
        "whatever reaches 8 is optimal.\nWith the payoffs of Table 4.2 that is so for strategies "
        f"7 and 9 with a share of {low:.4f} to {high:.4f} of 7. The\nsource's is the end at which "
        f"the adversary gets as much at vertex {rival + 1} as at 7 ({replies[rival]:.5f} and "
        f"{replies[target]:.5f}). So values can\nbe compared, mixtures cannot."
    )
    same_value = replies.argmax() == target and all(
        math.isclose(one, VALUE, abs_tol=1e-6)
        for one in (value, *(one.value for name, one in found if name.startswith("Table")))
    )
    print(
        f"With the orders of Table 4.2 the value is {VALUE:g} by all: "
        f"{'yes' if same_value else 'NO'}. Vertices that are equally far\nare in another order in "
        "ours, and what an attack on them pays differs with it."
    )
    return same_payoffs and same_value


def shares(mixture: np.ndarray) -> list[str]:
    others = np.delete(mixture, [6, 8]).sum()
    return [f"{share:.4f}" for share in (mixture[6], mixture[8], others)]


def save(rows: list[Row], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["strategy", "from", *(f"closest {k}" for k in range(1, 9)), "verdict"])
        for row in rows:
            writer.writerow([row.strategy, "Alam 2018", *row.source, ""])
            writer.writerow([row.strategy, "jaxcell", *row.order, row.verdict])


def draw(graph: Graph, rows: list[Row], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 5, figsize=(13, 6.2), layout="constrained")
    # The source shows the one with an emphasis before the one for all vertices.
    shown = (*rows[:8], rows[9], rows[8])
    for axes, row, letter in zip(panels.flat, shown, "abcdefghij", strict=True):
        weights = row.weights / row.weights.sum()
        marked = row.preferred if len(row.preferred) < graph.vertices else ()
        draw_weights(axes, graph, weights, marked)
        axes.set_title(f"{letter}) {row.strategy}, up to {weights.max():.3f}", fontsize=10)
    figure.suptitle("Ten strategies: width and colour of an edge by its weight (Figure 4.6)")
    figure.savefig(path, dpi=150)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_4/game")
    options = read_options(parser)

    configure_jax()
    graph, _ = load_graph(GRAPH)
    game = strategy_game(graph, EMPHASIS, SHARE, paths=PATHS)
    rows = compare(graph, game)
    save(rows, options.out / "orders.csv")
    draw(graph, rows, options.out / "strategies.png")
    report_orders(rows)
    same_game = report_game(game)
    print(f"Data and figure in {options.out}")
    return 0 if same_game and all(row.agrees for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
