import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Int

from ...drift import SeaDrift
from ..canvas.marks import log_dots, log_lines
from ..canvas.palette import BELIEF, CLEAR, Color, PictureClass, tint
from ..canvas.plot import Plot, ticks
from ..canvas.prose import described
from .groups import group_classes, home_color
from .map import CurrentMap


_CELL: Color = (20, 20, 24)
_SEEN: Color = tint(BELIEF, 0.7)
_LEFT_OUT: Color = tint(BELIEF, 0.35)
# The shade of the groups behind the marks.
_PALE = 0.55
_CORNERS = 48
_MAX_ROWS = 24


def log_deployment(map: CurrentMap) -> rrb.Container:
    """Log a tab that shows the cells of the surface in which to drop drifters."""
    drift = map.drift
    chosen = drift.deployment
    kind, classes = group_classes(drift.layers[0], drift.group_ranks[0])
    faint = [PictureClass(c.label, tint(c.color, _PALE)) for c in classes[1:]]
    picture = map.picture("deployment", [classes[0], *faint], kind)
    log_dots(map.stream, "map/deployment", map.xy(chosen.cells), map.mark, _CELL)
    title = f"To ever reach all: {chosen.cells.size:,} drifters"
    views: list[rrb.View] = [map.view(title, [picture, "deployment"])]
    legend = [
        ("drop a drifter here", _CELL),
        ("behind: the groups, pale", tint(home_color(0), _PALE)),
    ]
    if drift.views is not None:
        views.append(_log_views(map))
        legend += [
            ("drop one here to see the sea bed", BELIEF),
            ("... or here; the drifter of its group gets there", _LEFT_OUT),
            ("seen from there", _SEEN),
        ]
    if drift.curve is not None:
        views.append(_log_curve(map, drift.curve.covered))
    return map.tab("deployment", "Deployment", views, _text(drift), legend)


def _log_views(map: CurrentMap) -> rrb.View:
    """Log the cells from which cameras see the sea bed, and the disc that each camera sees."""
    views, reach = map.drift.views, map.drift.reach
    assert views is not None
    assert reach is not None
    others = np.setdiff1d(views.cover, views.cells)
    log_dots(map.stream, "map/views/kept", map.xy(views.cells), map.mark, BELIEF)
    log_dots(map.stream, "map/views/left_out", map.xy(others), map.mark, _LEFT_OUT)
    classes = [PictureClass("land", CLEAR), PictureClass("seen", _SEEN)]
    picture = map.picture("seen", classes, np.ones(map.water.cells, np.uint8))
    turn = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    disc = reach / 1000 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    discs = [centre + disc for centre in map.xy(views.cover)]
    log_lines(map.stream, "map/views/discs", discs, BELIEF, 0.8)
    title = f"To see all: {views.cells.size:,} drifters, of {views.cover.size:,} places"
    return map.view(title, [picture, "views/**"])


def _log_curve(map: CurrentMap, covered: Int[np.ndarray, "numbers"]) -> rrb.View:
    """Log the share of the cells that 0, 1, ... drifters may visit; `covered` begins with one."""
    share = 100 * np.append(0, covered) / map.water.cells
    plot = Plot(map.stream, "deployment/curve", max(2.0, float(covered.size)), 105.0)
    whole = [tick for tick in ticks(plot.most_x) if tick == int(tick)]
    plot.axes(whole, [0, 25, 50, 75, 100], "drifters", "cells that they can ever reach, %")
    plot.line("covered", np.arange(share.size, dtype=float), share, BELIEF, 2.5)
    return plot.view("Coverage by the number of drifters")


def _text(drift: SeaDrift) -> str:
    chosen = drift.deployment
    persistent = int((chosen.group >= 0).sum())
    views = ""
    no_fewer = ", and no fewer" if drift.phases is None else ""
    if drift.views is not None:
        views = (
            f"\n**To see the sea bed** {drift.reach:g} m far takes {drift.views.cover.size:,} "
            f"places, and **{drift.views.cells.size:,}** drifters, one in each group.\n"
        )
    columns = [f"deployment_{name}" for name in ("cell", "lon", "lat", "gained")]
    rank = [*drift.group_ranks[0].tolist(), "transient"]
    numbered = {
        "number": range(1, chosen.cells.size + 1),
        "group": [rank[group] for group in chosen.group.tolist()],
    }
    return f"""# Where to drop drifters

Dropped at the black circles, **{chosen.cells.size:,}** drifters can ever reach every cell, each
within its group; {persistent:,} are in persistent groups. If any drifter may reach a cell,
**{drift.minimum.size:,}** will do{no_fewer}. A cell is reached if a drifter visits it with any
positive probability, after any time.
{views}
{described(drift, *columns, first=numbered, most=_MAX_ROWS)}
"""
