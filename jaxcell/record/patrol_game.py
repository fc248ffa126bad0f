from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..patrol.walks.game import StrategyGame
from .canvas.matrix import log_matrix, matrix_view
from .canvas.page import log_tab
from .canvas.palette import Color
from .patrol_text import cell


# Squares for the names of strategies beside a heat map.
_STRATEGY_MARGIN = 4.4
_MOST_ROWS = 60


def log_game(stream: rr.RecordingStream, game: StrategyGame, names: Sequence[str]) -> rrb.Container:
    """Logs the payoffs as heat maps, and the mixture."""
    rows, shape = game.labels(names), game.patroller.shape
    views: list[rrb.View] = []
    legend: list[tuple[str, Color]] = []
    for who, payoff in (("patroller", game.patroller), ("adversary", game.adversary)):
        entries = log_matrix(
            stream, f"game/{who}", payoff, rows, names, f"for the {who}", _STRATEGY_MARGIN
        )
        legend += entries
        title = f"What the {who} is paid"
        views.append(matrix_view(f"game/{who}", title, shape, _STRATEGY_MARGIN))
    return log_tab(
        stream, "game", "The game", rrb.Horizontal(*views), _text(game, names), legend, rows=(1, 1)
    )


def _text(game: StrategyGame, names: Sequence[str]) -> str:
    """What the tab of a game shows."""
    commitment = game.commitment
    weights = np.asarray(commitment.weights)
    called = game.labels(names)
    rows = ["| strategy | share | the closest vertices |", "| --- | --- | --- |"]
    shown = np.sort(np.argsort(-weights, kind="stable")[:_MOST_ROWS])
    for strategy in shown.tolist():
        closest = ", ".join(names[vertex] for vertex in game.order[strategy, :8].tolist())
        rows.append(f"| {cell(called[strategy])} | {weights[strategy]:.4f} | {cell(closest)} |")
    if len(weights) > _MOST_ROWS:
        rows.append(f"| {len(weights) - _MOST_ROWS:,} more | | |")
    table = "\n".join(rows)
    attacked = names[int(commitment.answer[0])]
    return f"""# The game

The patroller draws one of {len(called)} strategies each time, with the shares below, which the
adversary knows; it does not know which is drawn. It attacks the vertex that pays it most.

- It attacks **{cell(attacked)}** and is paid {float(commitment.follower_value[0]):.4f}.
- The patroller is paid **{commitment.value:.4f}**, and with no other shares more.

The two heat maps are the payoffs: a row for each strategy, a column for each vertex. With a
strategy, the adversary is caught at the `k`-th closest vertex with probability `1 / 2^(k-1)`.

{table}
"""
