"""Where to drop drifters, and what one that is dropped somewhere may come to."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from .blueprint import log_classes, log_text
from .canvas.palette import BELIEF, CATEGORIES, CLEAR, FREE, START, Color, PictureClass, mix
from .canvas.plot import Plot, ticks
from .drift_groups import group_classes, home_color
from .drift_text import deployment_text, reach_text
from .sea_map import LAND, SeaMap, log_legend, log_marks, tab


_CELL: Color = (20, 20, 24)
_KEEPING: Color = mix(BELIEF, FREE, 0.6)
_CHANGING: Color = mix(CATEGORIES["yellow"], FREE, 0.45)
_SEEN: Color = mix(BELIEF, FREE, 0.7)
_LEFT_OUT: Color = mix(BELIEF, FREE, 0.35)
_CORNERS = 48


def log_deployment(stream: rr.RecordingStream, sea: SeaMap) -> rrb.Container:
    """Logs where to drop drifters at the surface."""
    found = sea.drift.deployment
    kind, classes = group_classes(sea.drift.behaviours[0])
    # Paler, so that the marks are what one sees.
    faint = [PictureClass(one.label, mix(one.color, FREE, 0.55)) for one in classes[1:]]
    log_classes(stream, "map/grid/deployment", [classes[0], *faint])
    stream.log("map/grid/deployment", sea.picture(0, kind), static=True)
    log_marks(stream, "map/deployment", sea.centres(0, found.cells), sea.mark, _CELL)
    shown = ["grid/water_0", "grid/deployment", "deployment"]
    views: list[rrb.View] = [sea.view(f"To reach all: {found.cells.size:,} drifters", shown)]
    entries = [
        ("drop a drifter here", _CELL),
        ("behind: the groups, pale", mix(home_color(0), FREE, 0.55)),
    ]
    if sea.drift.views is not None:
        views.append(_log_views(stream, sea))
        entries += [
            ("drop one here to see the sea bed", BELIEF),
            ("... or here; the drifter of its group gets there", _LEFT_OUT),
            ("seen from there", _SEEN),
        ]
    if sea.drift.curve is not None:
        views.append(_log_curve(stream, sea))
    entries.append(("land", LAND))
    log_legend(stream, sea, "deployment/legend", entries)
    log_text(stream, "deployment/text", deployment_text(sea))
    return tab("Deployment", views, "deployment", len(entries))


def _log_views(stream: rr.RecordingStream, sea: SeaMap) -> rrb.View:
    """Logs the cells from which the sea bed is seen, with the discs that are seen."""
    views, reach = sea.drift.views, sea.drift.reach
    assert views is not None
    assert reach is not None
    kept = np.isin(views.cover, views.cells)
    log_marks(stream, "map/views/kept", sea.centres(0, views.cells), sea.mark, BELIEF)
    others = sea.centres(0, views.cover[~kept])
    log_marks(stream, "map/views/left_out", others, sea.mark, _LEFT_OUT)
    classes = [PictureClass("land", CLEAR), PictureClass("seen", _SEEN)]
    log_classes(stream, "map/grid/seen", classes)
    every = np.ones(sea.drift.waters[0].cells, np.uint8)
    stream.log("map/grid/seen", sea.picture(0, every), static=True)
    circles = rr.LineStrips2D(
        [_circle(centre, reach / 1000) for centre in sea.centres(0, views.cover)],
        colors=BELIEF,
        radii=rr.Radius.ui_points(0.8),
        draw_order=20,
    )
    stream.log("map/views/discs", circles, static=True)
    name = f"To see all: {views.cells.size:,} drifters, of {views.cover.size:,} places"
    return sea.view(name, ["grid/water_0", "grid/seen", "views/**"])


def _circle(centre: Float[np.ndarray, "axes"], radius: float) -> Float[np.ndarray, "corners axes"]:
    turn = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    return centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _log_curve(stream: rr.RecordingStream, sea: SeaMap) -> rrb.View:
    """Logs how many cells so many drifters may visit."""
    assert sea.drift.curve is not None
    share = 100 * sea.drift.curve.covered / sea.drift.waters[0].cells
    number = np.arange(share.size + 1, dtype=float)
    plot = Plot(stream, "deployment/curve", max(2.0, float(share.size)), 105.0)
    whole = [one for one in ticks(plot.most_x) if one == int(one)]
    plot.axes(whole, [0, 25, 50, 75, 100], "drifters", "cells that they may visit, %")
    plot.line("covered", number, np.concatenate([[0.0], share]), BELIEF, 2.5)
    return plot.view("Coverage by the number of drifters")


def log_reach(stream: rr.RecordingStream, sea: SeaMap) -> rrb.Container:
    """Logs what a drifter that is dropped at the start may come to."""
    drift = sea.drift
    assert drift.reached is not None
    assert drift.start is not None
    keeping, changing = drift.reached
    classes = [
        PictureClass("land", CLEAR),
        PictureClass("out of reach", FREE),
        PictureClass("if it goes up and down on its way", _CHANGING),
        PictureClass("if it stays at the depth to which it dived at first", _KEEPING),
    ]
    place = sea.centres(0, np.array([drift.start]))
    log_marks(stream, "map/start", place, 1.3 * sea.mark, START)
    views = []
    for layer in sea.layers:
        stays = drift.of_layer(keeping, layer)
        kind = np.where(stays, 3, 1 + drift.of_layer(changing, layer)).astype(np.uint8)
        path = f"map/grid/reach_{layer}"
        log_classes(stream, path, classes)
        stream.log(path, sea.picture(layer, kind), static=True)
        name = f"{sea.depth(layer)}: {int(stays.sum()):,} of {stays.size:,} cells"
        views.append(sea.view(name, [f"grid/water_{layer}", f"grid/reach_{layer}", "start"]))
    entries = [("the start", START)]
    entries += [(one.label, one.color) for one in reversed(classes[1:])]
    entries.append(("land", LAND))
    log_legend(stream, sea, "reach/legend", entries)
    log_text(stream, "reach/text", reach_text(sea))
    return tab("Reach", views, "reach", len(entries))
