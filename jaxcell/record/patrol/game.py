import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol.walks import StrategyGame
from ..canvas.matrix import log_matrix
from ..canvas.page import log_tab
from ..canvas.palette import CLEAR, Color
from ..canvas.prose import numbers, table


# Space for the names of strategies beside a heat map, in squares.
_STRATEGY_MARGIN = 4.4
_MAX_CLOSEST = 8


def log_game(stream: rr.RecordingStream, game: StrategyGame) -> rrb.Container:
    """Log the payoffs of a game as heat maps, and the mixture of strategies."""
    views: list[rrb.View] = []
    legend: list[tuple[str, Color]] = []
    payoffs = {"patroller": game.patroller_payoff, "adversary": game.adversary_payoff}
    for who, payoff in payoffs.items():
        path, title = f"game/{who}", f"What the {who} is paid"
        named = payoff, game.strategy, game.names
        view, colors = log_matrix(stream, path, title, *named, "", _STRATEGY_MARGIN)
        views.append(view)
        # A row between the two colour bars keeps them separate.
        legend += [(title, CLEAR), *colors]
    rows = [
        (game.strategy[i], f"{game.share[i]:.4f}", ", ".join(game.order[i][:_MAX_CLOSEST]))
        for i in np.argsort(-game.share, kind="stable").tolist()
    ]
    text = f"""# The game

The patroller draws one of {len(game.share)} strategies with the shares below, which the adversary
knows; it attacks the vertex that pays it most. No other shares pay the patroller more.

{numbers(game)}

A strategy catches at the `k`-th closest vertex with probability `1 / 2^(k-1)`.

{table(("strategy", "share", "the closest vertices"), rows)}
"""
    beside = rrb.Horizontal(*views)
    return log_tab(stream, "game", "The game", beside, text, legend, rows=(1, 1))
