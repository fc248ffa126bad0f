import numpy as np

from ..bounce import Slipped
from .comparison import Comparison


_COIN, _LOST = 0.5, 1e-4


def compare_slip(result: Slipped) -> list[Comparison]:
    """Compare the belief of a run with a belief that keeps joint probabilities."""
    hidden, cells = result.hidden, result.cells
    weight = np.append(hidden.start, 0.0)
    for event in result.events.tolist():
        matrix = (hidden.moves, *hidden.bumps)[event].tocoo()
        after = np.zeros_like(weight)
        np.add.at(after, matrix.coords[1], matrix.data * weight[matrix.coords[0]] * (1 - _LOST))
        after[-1] = _COIN * (weight[-1] + _LOST * weight[:-1].sum())
        weight = after
    weight /= weight.sum()
    position = np.bincount(
        hidden.configuration % cells.positions, weight[:-1], minlength=cells.positions
    )
    again = np.append(position, weight[-1])
    told = np.append(result.belief[-1], result.nowhere[-1])
    rows = np.asarray((hidden.moves + hidden.bumps[0]).sum(axis=1)).ravel()
    return [
        Comparison.close("the belief at the end, normalised only there", told, again, 1e-9),
        Comparison.close("what is probable from each fine cell", rows, np.ones_like(rows), 1e-6),
    ]
