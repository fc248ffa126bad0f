import numpy as np
import rerun.blueprint as rrb

from ...drift import Stranded
from ..canvas.palette import BELIEF, CLEAR, FREE
from ..canvas.plot import Plot, ticks
from ..canvas.prose import numbers
from ..canvas.scale import Scale
from .map import SeaMap


_NO_BEACH = "no beach"


def log_beaching(map: SeaMap, stranded: Stranded) -> rrb.Container:
    """Log a tab with the drifters on each beach, and the share from each cell that is ashore."""
    row, column = map.water.row, map.water.column
    beached = 100 * map.water.cells * stranded.on_beach[row, column]
    chance = 100 * stranded.chance[row, column]
    at = Scale.over(
        beached, "{} % of one cell".format, least=0.0, ground="land", special={_NO_BEACH: FREE}
    )
    of = Scale.over(chance, "{} % are ashore".format, least=0.0, ground="land")
    share = 100 * stranded.share_by_step
    hours = np.arange(share.size) * float(stranded.hours)
    plot = Plot(map.stream, "beaching/curve", float(hours[-1]), 1.05 * max(1.0, share.max()))
    plot.axes(ticks(plot.most_x), ticks(plot.most_y), "hours", "drifters on a beach, %")
    plot.line("share", hours, share, BELIEF, 2.5)
    title = f"Ashore after {stranded.after_hours:.3g} h"
    views = [
        map.numbers("beached", title, at, beached, {_NO_BEACH: np.isnan(beached)}),
        map.numbers("strands", "From which cells drifters strand", of, chance),
        plot.view("How many are ashore"),
    ]
    legend = [*at.legend(), ("by where they were released", CLEAR), *of.legend()]
    text = f"""# Ashore

Drifters are released uniformly in all cells, strand at a coast, and may float again. After
**{stranded.after_hours:.3g} hours** **{stranded.share:.1%}** are on a beach. The maps show the
drifters on each beach, in percent of the drifters released per cell, and the share of stranded
drifters by the cell of release.

{numbers(stranded)}
"""
    return map.tab("beaching", "Beaches", views, text, legend)
