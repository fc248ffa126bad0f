"""Where drifters strand, and from where."""

import numpy as np
import rerun.blueprint as rrb

from ...drift import Stranded
from ..canvas.palette import BELIEF, CLEAR, FREE
from ..canvas.plot import Plot, ticks
from ..canvas.prose import numbers
from ..canvas.scale import Scale
from .map import SeaMap


_NO_BEACH = "no beach"


def log_beaching(map: SeaMap, found: Stranded) -> rrb.Container:
    """Log where drifters are ashore, from where they get there, and how many by the hour."""
    row, column = map.water.row, map.water.column
    here = 100 * map.water.cells * found.on_beach[row, column]
    chance = 100 * found.chance[row, column]
    at = Scale.over(
        here, "{} % of one cell".format, least=0.0, ground="land", special={_NO_BEACH: FREE}
    )
    never = np.isnan(here)
    kind = at.levels(np.where(never, 0, here), {_NO_BEACH: never})
    picture = map.picture("beached", at.classes, kind)
    of = Scale.over(chance, "{} % are ashore".format, least=0.0, ground="land")
    share = 100 * found.share_by_step
    hours = np.arange(share.size) * float(found.hours)
    plot = Plot(map.stream, "beaching/curve", float(hours[-1]), 1.05 * max(1.0, share.max()))
    plot.axes(ticks(plot.most_x), ticks(plot.most_y), "hours", "drifters on a beach, %")
    plot.line("share", hours, share, BELIEF, 2.5)
    views = [
        map.view(f"Ashore after {found.after_hours:.3g} h", [picture]),
        map.numbers("strands", "From where they get there", of, chance),
        plot.view("How many are ashore"),
    ]
    legend = [*at.legend(), ("by where they were released", CLEAR), *of.legend()]
    return map.tab("beaching", "Beaches", views, _text(found), legend)


def _text(found: Stranded) -> str:
    return f"""# Ashore

Drifters are released in all cells alike, strand at a coast, and come afloat again. After
**{found.after_hours:.3g} hours** **{found.share:.1%}** are on a beach. The maps show on which, in
percent of the drifters that one cell had at first, and what share of those of each cell.

{numbers(found)}
"""
