"""Currents as arrows, and drifters that move with them."""

import jax
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..drift import simulate_drifters
from .blueprint import log_text
from .canvas.palette import Color
from .drift_groups import DRIFTER
from .drift_text import currents_text
from .sea_map import LAND, SeaMap, log_legend, tab


_MOST_ARROWS = 700
# Over all records and layers, so that the file stays small.
_MOST_DRAWN = 400_000
_DRIFTERS = 250
_TRAIL = 6
_ARROW: Color = (70, 110, 150)
# Arrows of faster water are not longer.
_LONGEST = 2.5


def log_currents(stream: rr.RecordingStream, sea: SeaMap, seed: int) -> rrb.Container:
    """Logs the current of each layer by time, and drifters that it carries."""
    views = []
    for layer in sea.layers:
        _log_arrows(stream, sea, layer)
        _log_drifters(stream, sea, layer, seed)
        shown = [f"grid/water_{layer}", f"current_{layer}", f"drifters_{layer}/**"]
        views.append(sea.view(f"{sea.depth(layer)}: currents and drifters", shown))
    entries = [("the current", _ARROW), ("a drifter and its way", DRIFTER), ("land", LAND)]
    log_legend(stream, sea, "currents/legend", entries)
    log_text(stream, "currents/text", currents_text(sea))
    return tab("Currents", views, "currents", len(entries))


def arrow_scale(sea: SeaMap) -> float:
    """What makes an arrow of the mean speed as long as a cell, in cells for a cell a second."""
    speed = [np.hypot(*np.moveaxis(np.asarray(flow.rate), 1, 0)) for flow in sea.drift.flows]
    mean = np.concatenate([one[one > 0] for one in speed]).mean()
    return 0.9 / float(mean)


def _log_arrows(stream: rr.RecordingStream, sea: SeaMap, layer: int) -> None:
    """Logs the current at some of the cells, record by record."""
    water, flow, clock = sea.drift.waters[layer], sea.drift.flows[layer], sea.clock
    cells = sea.thinned(layer, _MOST_ARROWS)
    since = np.asarray(flow.time - flow.time[0]) / clock.seconds
    records = np.flatnonzero(since <= clock.last)
    most = max(1, _MOST_DRAWN // (cells.size * len(sea.layers)))
    records = records[:: -(-records.size // most)]
    rate = np.asarray(flow.rate)[records][:, :, water.row[cells], water.column[cells]]
    spacing = max(1.0, np.sqrt(water.cells / cells.size))
    vector = np.moveaxis(rate, 1, 2) * (arrow_scale(sea) * spacing)
    length = np.linalg.norm(vector, axis=2, keepdims=True)
    vector = vector * np.minimum(1, _LONGEST * spacing / np.maximum(length, 1e-12)) * sea.side
    foot = sea.centres(layer, cells) - vector / 2
    path, sizes = f"map/current_{layer}", np.full(records.size, cells.size)
    index = [rr.TimeColumn(clock.unit, sequence=np.rint(since[records]).astype(np.int64))]
    arrows = rr.Arrows2D.columns(vectors=vector.reshape(-1, 2), origins=foot.reshape(-1, 2))
    stream.send_columns(path, index, arrows.partition(sizes))
    style = rr.Arrows2D.from_fields(
        colors=_ARROW, radii=0.08 * spacing * float(sea.side.min()), draw_order=10
    )
    stream.log(path, style, static=True)


def _log_drifters(stream: rr.RecordingStream, sea: SeaMap, layer: int, seed: int) -> None:
    """Logs drifters that the current itself carries, without disturbances."""
    water, clock = sea.drift.waters[layer], sea.clock
    moved = simulate_drifters(
        jax.random.key(seed),
        water,
        sea.drift.flows[layer],
        np.ones(water.cells, bool),
        clock.frame * clock.seconds,
        clock.frames,
        drifters=min(_DRIFTERS, water.cells),
        substeps=4,
    )
    there = moved.cell >= 0
    whole, y = np.asarray(moved.x), np.asarray(moved.y)
    x = water.on_columns(whole)
    xy = sea.xy(x, y)
    # One that ran over a coast lies at it.
    found, _ = water.at(np.rint(y).astype(int), np.rint(x).astype(int))
    dry = there & (found < 0)
    xy[dry] = sea.centres(layer, moved.cell[dry])
    index = [rr.TimeColumn(clock.unit, sequence=clock.frame * np.arange(len(xy)))]
    path = f"map/drifters_{layer}"
    points = rr.Points2D.columns(positions=xy[there])
    stream.send_columns(f"{path}/here", index, points.partition(there.sum(axis=1)))
    style = rr.Points2D.from_fields(colors=DRIFTER, radii=0.55 * sea.mark, draw_order=40)
    stream.log(f"{path}/here", style, static=True)
    # A trail around the Earth begins beyond the edge of the map rather than at its other side.
    turns = sea.xy(whole, y) - sea.xy(x, y)
    trails = [
        (xy + turns - turns[time])[max(0, time - _TRAIL) : time + 1, there[time]].swapaxes(0, 1)
        for time in range(len(xy))
    ]
    strips = rr.LineStrips2D.columns(strips=[strip for trail in trails for strip in trail])
    stream.send_columns(f"{path}/trail", index, strips.partition(there.sum(axis=1)))
    line = rr.LineStrips2D.from_fields(
        colors=DRIFTER, radii=rr.Radius.ui_points(0.8), draw_order=30
    )
    stream.log(f"{path}/trail", line, static=True)
