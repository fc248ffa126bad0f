import functools
import itertools
from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from ...mapping.sequence import as_sequence
from ..canvas.palette import FREE
from ..canvas.scale import LEVELS, Scale
from .map import SeaMap


# The ends of the scale, in multiples of the number of drifters at release.
_LEAST, _MOST = 1 / 16, 16.0
_HARDLY = "hardly any"
# The largest number of squares over all times and layers, which keeps the file small.
_MAX_SQUARES = 20_000_000


def log_distribution(
    maps: Sequence[SeaMap], more: Sequence[rrb.View] = (), about: str = ""
) -> rrb.Container:
    """Log a tab that shows the distribution of drifters over the cells after each step.

    The tab also shows the views in `more`, which have the colours of [`density`][], and the text
    `about`, which explains them.
    """
    drift, clock = maps[0].drift, maps[0].clock
    steps = int(clock.last * clock.seconds / drift.step)
    squares = maps[0].water.number.size * len(maps)
    every = max(1, -(-steps * squares // _MAX_SQUARES))
    scale = density()
    views: list[rrb.View] = []
    for map in maps:
        chain = as_sequence(drift.layers[map.number].behaviour.chain)
        share = np.full(map.water.cells, 1 / map.water.cells)
        shares = itertools.islice(chain.pushed(share, steps), 0, None, every)
        kept = np.stack([levels(share) for share in shares])
        times = np.rint(np.arange(len(kept)) * every * drift.step / clock.seconds).astype(np.int64)
        picture = map.picture(f"distribution_{map.number}", scale.classes, kept, times=times)
        views.append(map.view(map.title, [picture]))
    text = f"""# Where drifters come to be

Drifters are released uniformly in all cells and move by the map of cells, step by step: press play.
The colours show the number of drifters in each cell, in multiples of the number at release.

{about}
"""
    views += more
    return maps[0].tab("distribution", "Distribution", views, text, scale.legend())


@functools.cache
def density() -> Scale:
    """Return the scale of the number of drifters in a cell, relative to the number at release."""
    bounds = np.geomspace(_LEAST, _MOST, LEVELS + 1)
    return Scale(bounds, "{} x".format, {_HARDLY: FREE}, ground="land", open=True)


def levels(share: np.ndarray) -> np.ndarray:
    """Convert each cell's share of all drifters to the index of its colour on [`density`][]."""
    times = share * share.shape[-1]
    return density().levels(times, {_HARDLY: times < _LEAST})
