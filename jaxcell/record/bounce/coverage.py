import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8

from ...bounce import CoveragePolicy
from ..canvas import palette
from ..canvas.map import CellMap, directions_shown
from ..canvas.page import log_tab
from ..canvas.palette import BELIEF, FREE, NOT_FREE, Color, PictureClass
from ..canvas.plot import Plot, ticks
from ..canvas.prose import Spec, counted, described, made_with, numbers
from ..canvas.scale import Scale
from ..canvas.stream import pace, send_blueprint


# Number of angles with maps; these angles have the largest shares of time.
_MAX_ANGLES = 6
_MAX_ROWS = 24
_MAX_ANGLE_LABELS = 12
_NONE, _LITTLE = "no time at all", "less than 1/16 of an even share"
# A colour between those of no time and of the first level; a darker colour would look like a wall.
_PALE: Color = (149, 154, 184)


def log_coverage(stream: rr.RecordingStream, policy: CoveragePolicy, spec: Spec) -> None:
    """Record a mixture of bouncing policies, which covers a room."""
    cells, alpha = policy.cells, np.asarray(policy.alpha)
    shown = np.sort(np.argsort(-alpha, kind="stable")[:_MAX_ANGLES]).tolist()
    heats = []
    for i in shown:
        title = f"{policy.bounce_deg[i]:.6g}°, {100 * alpha[i]:.1f} % of the time"
        heats.append((f"coverage_{i}", title, policy.coverage[i]))
    heats += [("mixture", "The mixture", policy.mixture), ("target", "The target", policy.target)]
    scale = heat_scale(cells.positions * max(float(np.max(heat)) for _, _, heat in heats))
    map = CellMap(stream, cells)
    views: list[rrb.View] = []
    for name, title, heat in heats:
        levels = heat_levels(scale, cells.positions * np.asarray(heat))
        views.append(map.view(title, [map.picture(name, scale.classes, levels)]))
    views.append(_log_shares(stream, policy))
    maps = rrb.Grid(*views, grid_columns=math.ceil(len(views) / 2))
    text, legend = _text(policy, len(shown), spec), _legend(scale)
    tabs = [
        log_tab(stream, "", "Coverage", maps, text, legend),
        *(_log_angle(map, policy, i) for i in shown),
    ]
    send_blueprint(stream, tabs, "direction", pace(cells.directions))


def heat_scale(most: float) -> Scale:
    """Return a logarithmic colour scale for the time in a cell; `most` is the longest time.

    Times are multiples of an even share, which is the time in a cell if all cells have equal times.
    Each level of the scale ends at the square root of 2 times its beginning.
    """
    fours = max(1, math.ceil(math.log(max(most, 1), 4)))
    special: dict[str, Color] = {_LITTLE: _PALE, _NONE: FREE}
    bounds = 2.0 ** (np.arange(-8, 4 * fours + 1) / 2)
    return Scale(bounds, "{} times an even share".format, special)


def heat_levels(scale: Scale, heat: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Convert times, as multiples of an even share, to picture classes of a [`heat_scale`][]."""
    return scale.levels(heat, {_LITTLE: heat < scale.bounds[0], _NONE: heat <= 0})


def _legend(scale: Scale) -> list[tuple[str, Color]]:
    return scale.legend(1 + scale.bounds.size // 4)


def _log_shares(stream: rr.RecordingStream, policy: CoveragePolicy) -> rrb.View:
    """Log a bar for each bouncing angle; its height is the share of time at this angle."""
    percent = 100 * np.asarray(policy.alpha)
    count, high = percent.size, float(percent.max())
    every = -(-count // _MAX_ANGLE_LABELS)
    named = {i + 0.5: f"{policy.bounce_deg[i]:.6g}" for i in range(0, count, every)}
    plot = Plot(stream, "alpha", float(count), high)
    plot.axes(named, ticks(high), "bouncing angle, degrees", "% of the time")
    # Each bar has a gap on both sides.
    plot.bars("share", np.kron(percent, [0, 1, 1, 1, 0]), float(count), BELIEF)
    return plot.view("Share of time by bouncing angle")


def _log_angle(map: CellMap, policy: CoveragePolicy, i: int) -> rrb.Container:
    """Log a tab with the persistent groups and the limiting distribution of bouncing angle `i`."""
    name, shown = f"angle_{i}", directions_shown(policy.cells)
    groups, cells = policy.groups[i], policy.cells
    classes = _group_classes(groups.count)
    order = np.argsort(-np.asarray(policy.limiting[i].weights), kind="stable")
    color = palette.ranked(np.argsort(order))
    group = policy.group[i]
    kind = np.where(group < 0, 1, 2 + color[group]).astype(np.uint8)
    heat = policy.share[i] * cells.size
    scale = heat_scale(float(heat.max()))
    pictures = [
        map.by_direction(f"{name}/groups", classes, kind, shown),
        map.by_direction(f"{name}/limiting", scale.classes, heat_levels(scale, heat), shown),
    ]
    views = rrb.Vertical(
        map.view("Persistent groups, one direction", pictures[:1]),
        map.view("Time spent, one direction", pictures[1:]),
    )
    title, legend = f"{policy.bounce_deg[i]:.6g}°", [*_legend(scale), *classes[1:]]
    which = "" if groups.count == 1 else "one of "
    text = f"""# Bouncing by {title}, imprecisely

Sooner or later the robot is in {which}{counted(groups.count, "*persistent group*")},
{policy.persistent_cells[i]:,} of {cells.size:,} cells in all, and never leaves. Drag `direction` at
the bottom to see all {cells.directions} directions.

- **Persistent groups**: each has a colour, in the order of the probability to end in it.
- **Time spent**: the limiting distribution, in multiples of an even share, 1/{cells.size:,}.
"""
    return log_tab(map.stream, name, title, views, text, legend, shares=(3, 2), rows=(2, 3))


def _group_classes(count: int) -> list[PictureClass]:
    """Return the classes of a picture of `count` groups: not free, transient, and the groups."""
    colors = len(palette.CATEGORIES)
    named = ["on the likeliest persistent group"]
    named += [f"on the persistent group of rank {rank}" for rank in range(2, colors + 1)]
    named += ["on a less likely group"] * colors
    groups = list(map(PictureClass, named, palette.RANKED))
    return [NOT_FREE, PictureClass("transient", FREE), *groups[:count]]


def _text(policy: CoveragePolicy, shown: int, spec: Spec) -> str:
    angles, cells = len(policy.bounce), policy.cells
    if angles == 1:
        divides = "Here there is one angle, so all the time goes to it."
    else:
        divides = (
            f"It divides its time among **{angles}** angles so that together they come as near as "
            "possible to the **target**, in Euclidean distance."
        )
    left_out = f" (those of the {shown} largest shares)" if shown < angles else ""
    columns = "bounce_deg", "alpha", "persistent_groups", "persistent_cells"
    return f"""# Covering a room without knowing the place

A robot runs straight. At a bump it turns by its bouncing angle, but not precisely, and runs on.
{divides}

{described(policy, *columns, most=_MAX_ROWS)}

## How to look

- **The maps** show the time spent in each square in multiples of an even share,
  1/{cells.positions:,}: for each angle alone{left_out}, for the mixture, and for the target.
  Hover over a square to read it.
- **The bars** are the shares of the angles.
- Each angle has a tab with its persistent groups.

{numbers(policy)}

{made_with(spec, cells)}"""
