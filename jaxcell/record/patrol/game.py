import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol import StrategyGame
from ..canvas.matrix import log_matrix, matrix_view
from ..canvas.page import log_tab
from ..canvas.palette import Color
from ..canvas.prose import table


# Squares for the names of strategies beside a heat map.
_STRATEGY_MARGIN = 4.4
_MAX_ROWS = 60
_MAX_CLOSEST = 8


def log_game(stream: rr.RecordingStream, game: StrategyGame) -> rrb.Container:
    """Log the payoffs as heat maps, and the mixture."""
    views: list[rrb.View] = []
    legend: list[tuple[str, Color]] = []
    payoffs = {"patroller": game.patroller_payoff, "adversary": game.adversary_payoff}
    for who, payoff in payoffs.items():
        path, names, unit = f"game/{who}", game.names, f"for the {who}"
        legend += log_matrix(stream, path, payoff, game.strategy, names, unit, _STRATEGY_MARGIN)
        views.append(matrix_view(path, f"What the {who} is paid", payoff.shape, _STRATEGY_MARGIN))
    return log_tab(
        stream, "game", "The game", rrb.Horizontal(*views), _text(game), legend, rows=(1, 1)
    )


def name_cell(name: str) -> str:
    """A name in a table, whose columns a bar would end."""
    return name.replace("|", "&#124;")


def _text(game: StrategyGame) -> str:
    """What the tab of a game shows."""
    shown = np.sort(np.argsort(-game.share, kind="stable")[:_MAX_ROWS]).tolist()
    rows = [
        (
            name_cell(game.strategy[i]),
            f"{game.share[i]:.4f}",
            name_cell(", ".join(game.order[i][:_MAX_CLOSEST])),
        )
        for i in shown
    ]
    if len(game.share) > _MAX_ROWS:
        rows.append((f"{len(game.share) - _MAX_ROWS:,} more", "", ""))
    return f"""# The game

The patroller draws one of {len(game.share)} strategies each time, with the shares below, which the
adversary knows; it does not know which is drawn. It attacks the vertex that pays it most.

- It attacks **{name_cell(game.attacked)}** and is paid {game.adversary_value:.4f}.
- The patroller is paid **{game.value:.4f}**, and with no other shares more.

The two heat maps are the payoffs: a row for each strategy, a column for each vertex. With a
strategy, the adversary is caught at the `k`-th closest vertex with probability `1 / 2^(k-1)`.

{table(("strategy", "share", "the closest vertices"), rows)}
"""
