import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int, UInt8

from ..bounce import CoveragePolicy
from ..mapping import PersistentGroups
from ..space import CellSpace
from .blueprint import (
    legend_view,
    log_classes,
    log_legend_style,
    log_legends,
    log_map,
    log_pictures,
    log_text,
    map_view,
    recording,
    send_blueprint,
)
from .coverage_dataset import check_policy
from .coverage_text import coverage_text, directions_text
from .palette import BELIEF, CATEGORIES, CLEAR, FREE, LegendEntry, PictureClass, mix, ramp
from .pictures import on_squares


# So many angles have maps, those with the largest shares of time.
_MOST_ANGLES = 6
# Levels double every second class, from this power of two.
_LOWEST = -4


def log_coverage(
    path: str | os.PathLike[str],
    cells: CellSpace,
    policy: CoveragePolicy,
    *,
    bounces: Float[np.ndarray, "angles"],
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of a mixture of bouncing policies.

    Heat maps of the coverage by each angle, by the mixture, and of the target, side by side, with
    the shares of time as bars; and for each angle, over the timeline `direction`, its persistent
    groups and its limiting distribution.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `cells`: the cell space.
    - `policy`: the mixture.
    - `bounces`: the bouncing angles, in radians.
    - `spec`: what was asked for, shown in the text.

    **Raises:** `ValueError` if the policy is not of these cells or angles.

    A corridor of three cells, and robots that turn by a quarter or half a turn:

        >>> import math
        >>> import pathlib
        >>> import tempfile
        >>> import numpy as np
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> bounces = [math.pi / 2, math.pi]
        >>> policy = bounce.coverage_policy(cells, bounces, error=0.0, reliability=1.0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_coverage(path, cells, policy, bounces=np.array(bounces))
        ...     path.stat().st_size > 1000
        True
    """
    check_policy(cells, policy, bounces)
    degrees = np.rad2deg(bounces)
    alpha = np.asarray(policy.alpha)
    shown = np.sort(np.argsort(-alpha, kind="stable")[:_MOST_ANGLES])
    once = np.zeros(1, np.int64)
    coverage, mixture, target = (
        np.asarray(x) * cells.positions for x in (policy.coverage, policy.mixture, policy.target)
    )
    most = max(float(x.max()) for x in (coverage[shown], mixture, target))
    with recording(path, "coverage") as stream:
        log_map(stream, cells)
        heats = {f"coverage_{i}": coverage[i] for i in shown.tolist()}
        heats |= {"mixture": mixture, "target": target}
        for name, heat in heats.items():
            _log_heat(stream, cells, f"map/grid/{name}", once, heat[None], most)
        log_legend_style(stream, "legend")
        legend = _heat_legend(most)
        log_legends(stream, "legend", "direction", once, [legend])
        width = float(np.diff(np.sort(degrees)).min(initial=30.0))
        bars = rr.BarChart(
            alpha, abscissa=degrees, widths=np.full(alpha.size, 0.8 * width), color=BELIEF
        )
        stream.log("alpha", bars, static=True)
        log_text(stream, "text", coverage_text(cells, policy, degrees, shown.size, spec or {}))
        tabs = [_summary_layout(cells, degrees[shown], alpha[shown], shown, len(legend))]
        for i in shown.tolist():
            tabs.append(_log_angle(stream, cells, policy, i, float(degrees[i])))
        speed = max(2.0, cells.directions / 30)
        send_blueprint(stream, rrb.Tabs(*tabs, active_tab=0), "direction", speed)


def heat_classes(most: float) -> list[PictureClass]:
    """The classes in pictures of time spent, by multiples of an even share.

    0 is for what is not free, 1 for no time at all, 2 for less than a sixteenth; from there on
    two classes make a doubling, as far as `most`.
    """
    highest = max(1, math.ceil(math.log2(max(most, 1))))
    edges = 2.0 ** (np.arange(2 * _LOWEST, 2 * highest + 1) / 2)
    classes = [
        PictureClass("not free", CLEAR),
        PictureClass("no time at all", FREE),
        PictureClass(f"less than {_shares(edges[0])}", (44, 44, 90)),
    ]
    colors = ramp(np.linspace(0, 1, edges.size - 1)).tolist()
    for low, high, (red, green, blue) in zip(edges, edges[1:], colors, strict=False):
        classes.append(PictureClass(f"{low:.3g} to {high:.3g} even shares", (red, green, blue)))
    return classes


def heat_class(heat: Float[np.ndarray, "*shape"], count: int) -> UInt8[np.ndarray, "*shape"]:
    """The class of each multiple of an even share, among so many."""
    positive = np.where(heat > 0, heat, 1.0)
    level = 3 + np.floor(2 * (np.log2(positive) - _LOWEST))
    return np.where(heat > 0, np.clip(level, 2, count - 1), 1).astype(np.uint8)


def _log_heat(
    stream: rr.RecordingStream,
    cells: CellSpace,
    path: str,
    times: Int[np.ndarray, "pictures"],
    heat: Float[np.ndarray, "pictures positions"],
    most: float,
) -> None:
    classes = heat_classes(most)
    log_classes(stream, path, classes)
    pictures = on_squares(cells, heat_class(heat, len(classes)))
    log_pictures(stream, path, "direction", times, pictures)


def _heat_legend(most: float) -> list[LegendEntry]:
    """What the colours mean: every second class, those that begin at a power of two."""
    classes = heat_classes(most)[1:]
    begins = classes[2::2]
    labels = [f"from {_shares(2.0 ** (_LOWEST + k))}" for k in range(len(begins))]
    entries = [(one.label, one.color) for one in classes[:2]]
    entries += [(label, one.color) for label, one in zip(labels, begins, strict=True)]
    return [LegendEntry(row, *entry) for row, entry in enumerate(entries)]


def _shares(power_of_two: float) -> str:
    if power_of_two > 1:
        return f"{power_of_two:g} even shares"
    return "1 even share" if power_of_two == 1 else f"1/{1 / power_of_two:g} of an even share"


def _group_classes(count: int) -> list[PictureClass]:
    """What is not free, transient cells, and the groups; those past the colours are pale."""
    colors = list(CATEGORIES.values())
    classes = [PictureClass("not free", CLEAR), PictureClass("transient", FREE)]
    for place in range(min(count, 2 * len(colors))):
        color = colors[place % len(colors)]
        if place >= len(colors):
            classes.append(PictureClass("on a less likely group", mix(color, (255, 255, 255), 0.6)))
        elif place:
            classes.append(PictureClass(f"on the persistent group of rank {place + 1}", color))
        else:
            classes.append(PictureClass("on the likeliest persistent group", color))
    return classes


def _group_pictures(
    groups: PersistentGroups, weights: Float[np.ndarray, "groups"]
) -> UInt8[np.ndarray, "cells"]:
    """The class of each cell; groups have ranks by their weights."""
    colors = len(CATEGORIES)
    rank = np.empty(groups.count, np.int64)
    rank[np.argsort(-weights, kind="stable")] = np.arange(groups.count)
    place = np.where(rank < colors, rank, colors + rank % colors)
    group = np.asarray(groups.group)
    return np.where(group < 0, 1, 2 + place[group]).astype(np.uint8)


def _log_angle(
    stream: rr.RecordingStream, cells: CellSpace, policy: CoveragePolicy, i: int, degrees: float
) -> rrb.Container:
    """Logs the persistent groups and the limiting distribution of one angle, by direction."""
    name = f"angle_{i}"
    groups, limiting = policy.groups[i], policy.limiting[i]
    every = np.arange(cells.directions)
    kind = _group_pictures(groups, np.asarray(limiting.weights))
    classes = _group_classes(groups.count)
    log_classes(stream, f"map/grid/{name}/groups", classes)
    pictures = on_squares(cells, kind.reshape(cells.directions, -1))
    log_pictures(stream, f"map/grid/{name}/groups", "direction", every, pictures)

    heat = np.asarray(limiting.value).reshape(cells.directions, -1) * cells.size
    most = float(heat.max())
    _log_heat(stream, cells, f"map/grid/{name}/limiting", every, heat, most)
    legend = _heat_legend(most)
    offset = len(legend) + 1
    legend += [
        LegendEntry(offset + row, one.label, one.color) for row, one in enumerate(classes[1:])
    ]
    log_legend_style(stream, f"{name}/legend")
    log_legends(stream, f"{name}/legend", "direction", np.zeros(1, np.int64), [legend])
    log_text(stream, f"{name}/text", directions_text(cells, policy, i, degrees))
    return rrb.Horizontal(
        rrb.Vertical(
            map_view(cells, "Persistent groups, one direction", [f"grid/{name}/groups"]),
            map_view(cells, "Time spent, one direction", [f"grid/{name}/limiting"]),
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin=f"{name}/text", name="What you see"),
            legend_view(f"{name}/legend", legend[-1].row + 1),
            row_shares=[2, 3],
        ),
        column_shares=[3, 2],
        name=f"{degrees:.6g}°",
    )


def _summary_layout(
    cells: CellSpace,
    degrees: Float[np.ndarray, "shown"],
    alpha: Float[np.ndarray, "shown"],
    shown: Int[np.ndarray, "shown"],
    rows: int,
) -> rrb.Container:
    views: list[rrb.View] = [
        map_view(cells, f"{angle:.6g}°, {100 * share:.1f} % of the time", [f"grid/coverage_{i}"])
        for angle, share, i in zip(degrees, alpha, shown.tolist(), strict=True)
    ]
    views.append(map_view(cells, "The mixture", ["grid/mixture"]))
    views.append(map_view(cells, "The target", ["grid/target"]))
    views.append(
        rrb.BarChartView(
            origin="alpha",
            name="Share of time by bouncing angle (degrees)",
            plot_legend=rrb.PlotLegend(visible=False),
        )
    )
    return rrb.Horizontal(
        rrb.Grid(*views, grid_columns=math.ceil(len(views) / 2)),
        rrb.Vertical(
            rrb.TextDocumentView(origin="text", name="What you see"),
            legend_view("legend", rows),
            row_shares=[3, 2],
        ),
        column_shares=[7, 3],
        name="Coverage",
    )
