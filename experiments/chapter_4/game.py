"""Tables 4.2 and 4.3 of Alam 2018: ten strategies on a small graph, and their best mixture.

    python -m experiments.chapter_4.game

The strategies are walks toward each of the eight vertices (Alg. 4.1), and the walks with the least
average expected commute time, over all vertices and with an emphasis on three of them. The payoffs
of a strategy depend only on the order of the vertices by mean hitting time (Alg. 4.2), so Table 4.2
consists of ten orders.

Alg. 4.1 counts the steps of the shortest paths to the vertex, each in its own direction as printed,
and one path from each vertex. The hitting time is then the number of edges to the vertex, and all
eight rows have the order of the source, up to vertices at the same distance.

The script writes `orders.csv`, and `strategies.png` (Figure 4.6). The exit status is 1 if a row,
the payoffs, or the value of the game disagrees with the source.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from jaxcell.base.runtime import configure_jax
from jaxcell.optimize import payoffs, stackelberg
from jaxcell.patrol import Graph, load_graph, strategy_game, toward
from jaxcell.patrol.walks import StrategyGame, measure

from ..shared.data import GRAPHS
from ..shared.figures import plt, save
from ..shared.options import experiment_parser, read_options
from ..shared.report import say, show, write_csv
from .edge_weights import draw_weights


GRAPH = GRAPHS / "eight.json"
PATHS = 1
EMPHASIS = (1, 4, 7)
# The source does not have the share; the order is the same from 0.6 to 0.95.
SHARE = 0.8

# The vertices by decreasing payoff of the patroller, in the rows of Table 4.2.
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
# Table 4.3, the vertex that the adversary attacks, and the value of the game.
MIXTURE = (0, 0, 0, 0, 0, 0, 0.9012, 0, 0.0988, 0)
ATTACKED = 7
VALUE = 8.0
METHODS = {"dobss": "DOBSS", "multiple-lp": "multiple LP"}

# The relative difference of hitting times below which they count as equal.
ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class Row:
    """A strategy with our order of the vertices, numbered from 1, and the order of the source."""

    strategy: str
    preferred: tuple[int, ...]
    weights: np.ndarray
    order: np.ndarray
    source: np.ndarray
    apart: float
    """The largest relative difference of hitting times whose order differs from the source; `inf`
    if the order is unique and differs."""

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
    """Compute the largest relative difference of two times that are in the wrong order."""
    sorted_as = times[order - 1]
    later_least = np.minimum.accumulate(sorted_as[::-1])[::-1]
    return float(((sorted_as - later_least) / sorted_as.clip(min=ROUNDING)).max())


def compare(graph: Graph, game: StrategyGame) -> list[Row]:
    """Compare all orders with the source."""
    rows = []
    for number, (name, source) in enumerate(TABLE_4_2.items()):
        source, order = np.array(source), game.closest[number] + 1
        if number < graph.vertices:
            times = measure(toward(graph, number, PATHS)).hitting_time[:, number]
            apart = out_of_order(times, source)
        else:
            apart = 0.0 if np.array_equal(order, source) else math.inf
        preferred = game.preferred[number]
        rows.append(Row(name, preferred, game.weight[number], order, source, apart))
    return rows


def report_orders(rows: list[Row]) -> None:
    """Print the orders of all strategies beside the source."""
    table = []
    for row in rows:
        ours, source = (" ".join(map(str, order)) for order in (row.order, row.source))
        entry = {"strategy": row.strategy, "Alam 2018": source, "jaxcell": ours}
        table.append(entry | {"": row.verdict})
    show("Vertices by mean hitting time: Table 4.2", table)
    print(
        f"Toward a vertex, {sum(row.agrees for row in rows[:8])} of 8 rows agree.\n"
        "Over all vertices, 3 and 8 are equally far by symmetry."
    )


# The game.


def face(leader: np.ndarray, follower: np.ndarray) -> tuple[float, float]:
    """Compute the range of shares of strategy 7, mixed with 9, for which vertex 7 is attacked.

    Both strategies have their largest payoff at vertex 7, so all these mixtures have the value of
    the mixture of Table 4.3.
    """
    target = ATTACKED - 1
    assert leader[6, target] == leader[8, target] == leader.max()
    slope = follower[6] - follower[6, target] - (follower[8] - follower[8, target])
    room = follower[8, target] - follower[8]
    at_most = min((r / s for r, s in zip(room, slope, strict=True) if s > 0), default=1.0)
    at_least = max((r / s for r, s in zip(room, slope, strict=True) if s < 0), default=0.0)
    return max(0.0, at_least), min(1.0, at_most)


def report_game(game: StrategyGame) -> bool:
    """Compare the game with the source; returns `True` if its payoffs and its value agree."""
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
    ours = (game.patroller_payoff, game.adversary_payoff)
    found = [
        (f"{name}, {METHODS[method]}", stackelberg(*sides, method=method))
        for name, sides in (("Table 4.2", (leader, follower)), ("our orders", ours))
        for method in METHODS
    ]
    rows = [mixture_row("Alam 2018", value, target, mixture)]
    for name, one in found:
        rows.append(mixture_row(name, one.value, int(one.answer[0]), np.asarray(one.weights)))
    show("The best mixture of the strategies: Table 4.3", rows, ".4f", value=".6f")
    low, high = face(leader, follower)
    rival = int(np.argsort(replies)[-2])
    say(
        f"""The source has no value, so the table shows the value of its mixture. No payoff exceeds
        8, so each mixture with value 8 is optimal. With the payoffs of Table 4.2 these are mixtures
        of strategies 7 and 9 with a share of {low:.4f} to {high:.4f} of 7. The mixture of the
        source is the end of this range: the adversary gains as much at vertex {rival + 1} as at 7
        ({replies[rival]:.5f} and {replies[target]:.5f}). So values can be compared, but mixtures
        cannot."""
    )
    same_value = replies.argmax() == target and all(
        math.isclose(one, VALUE, abs_tol=1e-6)
        for one in (value, *(one.value for name, one in found if name.startswith("Table")))
    )
    say(
        f"""With the orders of Table 4.2 the value is {VALUE:g} by all methods:
        {"yes" if same_value else "NO"}. Our orders differ for vertices at the same distance, so the
        payoffs of attacks on them differ too."""
    )
    return same_payoffs and same_value


def mixture_row(name: str, value: float, target: int, mixture: np.ndarray) -> dict[str, Any]:
    others = float(np.delete(mixture, [6, 8]).sum())
    shares = {"of 7": float(mixture[6]), "of 9": float(mixture[8]), "others": others}
    return {"payoffs and method": name, "value": float(value), "attacked": target + 1, **shares}


def write_orders(rows: list[Row], path: Path) -> None:
    """Write each order of the source, with our order below it."""
    columns = ["strategy", "from", *(f"closest {k}" for k in range(1, 9)), "verdict"]
    table = []
    for row in rows:
        source, ours = ["Alam 2018", *row.source, ""], ["jaxcell", *row.order, row.verdict]
        table += [dict(zip(columns, [row.strategy, *of], strict=True)) for of in (source, ours)]
    write_csv(table, path)


def draw(graph: Graph, rows: list[Row], path: Path) -> None:
    """Draw the weights of all strategies."""
    figure, panels = plt.subplots(2, 5, figsize=(13, 6.2), layout="constrained")
    # The source shows the walk with an emphasis before the walk for all vertices.
    shown = (*rows[:8], rows[9], rows[8])
    for axes, row, letter in zip(panels.flat, shown, "abcdefghij", strict=True):
        weights = row.weights / row.weights.sum()
        marked = row.preferred if len(row.preferred) < graph.vertices else ()
        draw_weights(axes, graph, weights, marked)
        axes.set_title(f"{letter}) {row.strategy}, up to {weights.max():.3f}", fontsize=10)
    figure.suptitle("Ten strategies: width and colour of an edge by its weight (Figure 4.6)")
    save(figure, path)


def main() -> int:
    options = read_options(experiment_parser(__doc__, "runs/chapter_4/game"))
    configure_jax()
    graph, _ = load_graph(GRAPH)
    game = strategy_game(graph, EMPHASIS, SHARE, paths=PATHS)
    rows = compare(graph, game)
    write_orders(rows, options.out / "orders.csv")
    draw(graph, rows, options.out / "strategies.png")
    report_orders(rows)
    same_game = report_game(game)
    print(f"Data and figure in {options.out}")
    return 0 if same_game and all(row.agrees for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
