from collections.abc import Sequence

import jax
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...drift import SeaDrift, simulate_drifters
from ..canvas.marks import points
from ..canvas.palette import Color
from ..canvas.stream import send_changing
from .map import DRIFTER, CurrentMap, shortened, thinned


_MAX_ARROWS = 700
# The largest number of arrows over all records and layers, which keeps the file small.
_MAX_DRAWN = 400_000
DRIFTERS = 250
"""The largest number of drifters that are drawn in a layer."""
_TRAIL = 6
_ARROW: Color = (70, 110, 150)
# The largest length of an arrow, in cells.
_MAX_LENGTH = 2.5


def log_currents(maps: Sequence[CurrentMap], seed: int) -> rrb.Container:
    """Log a tab that shows the current as arrows over time, and drifters that move with it."""
    views = []
    for map in maps:
        _log_arrows(map, len(maps))
        _log_drifters(map, seed)
        shown = [f"current_{map.number}", f"drifters_{map.number}/**", "key/**"]
        views.append(map.view(f"{map.title}: currents and drifters", shown))
    legend = [("the current", _ARROW), ("a drifter and its way", DRIFTER)]
    drift, clock = maps[0].drift, maps[0].clock
    notes = "\n".join(f"- {note}" for note in drift.notes)
    text = f"""# The current

Arrows show the records one after the other; faster water has longer arrows. Dots are drifters with
their tracks of the last {clock.frame * _TRAIL} {clock.unit}s. Time 0 is
{_moment(drift.currents.time.values[0])}.

## The file

{currents_of(drift)}

- towards the East: {drift.east_from}
- towards the North: {drift.north_from}
{notes}
"""
    return maps[0].tab("currents", "Currents", views, text, legend)


def currents_of(drift: SeaDrift) -> str:
    """Return a sentence with the source and the times of the currents."""
    times, source = drift.currents.time.values, drift.currents.attrs["source"]
    if times.size == 1:
        return f"The current of `{source}` at {_moment(times[0])}."
    return (
        f"The current of `{source}`, {times.size} records from {_moment(times[0])} to "
        f"{_moment(times[-1])}, after which it begins again."
    )


def _moment(time: np.datetime64) -> str:
    return f"{np.datetime_as_string(time, unit='m').replace('T', ' ')} UTC"


def _log_arrows(map: CurrentMap, layers: int) -> None:
    """Log the current as arrows at some cells; with more `layers`, fewer times are shown."""
    water, flow, clock = map.water, map.flow, map.clock
    cells, _ = thinned(water.row, water.column, _MAX_ARROWS)
    since, count = np.asarray(flow.time) - np.asarray(flow.time)[0], len(flow.recorded)
    if flow.period is not None:
        again = np.arange(0.0, clock.last * clock.seconds, float(flow.period))
        since = (again[:, None] + since[:count]).ravel()
    since = since / clock.seconds
    shown = np.flatnonzero(since <= clock.last)
    most = max(1, _MAX_DRAWN // (cells.size * layers))
    shown = shown[:: -(-shown.size // most)]
    rate = np.asarray(flow.rate)[shown % count][:, :, water.row[cells], water.column[cells]]
    spacing = max(1.0, float(np.sqrt(water.cells / cells.size)))
    map.log_key(spacing)
    vector = np.moveaxis(rate, 1, 2) * (map.arrow * spacing)
    vector = shortened(vector, _MAX_LENGTH * spacing) * map.side
    foot = map.xy(cells) - vector / 2
    times, sizes = np.rint(since[shown]).astype(np.int64), np.full(shown.size, cells.size)
    radius = 0.08 * spacing * float(map.side.min())
    send_changing(
        map.stream,
        f"map/current_{map.number}",
        rr.Arrows2D,
        times,
        sizes,
        clock.timeline,
        style={"colors": _ARROW, "radii": radius, "draw_order": 10},
        vectors=vector.reshape(-1, 2),
        origins=foot.reshape(-1, 2),
    )


def _log_drifters(map: CurrentMap, seed: int) -> None:
    """Log drifters that are simulated in the current itself, without random disturbances."""
    water, clock, stream, line = map.water, map.clock, map.stream, map.clock.timeline
    moved = simulate_drifters(
        jax.random.key(seed),
        water,
        map.flow,
        np.ones(water.cells, bool),
        clock.frame * clock.seconds,
        clock.frames,
        drifters=min(DRIFTERS, water.cells),
        substeps=4,
    )
    present = moved.cell >= 0
    whole, y = np.asarray(moved.x), np.asarray(moved.y)
    x = water.on_columns(whole)
    xy = map.on_grid(x, y)
    # A drifter that ran ashore is drawn in its cell at the coast.
    square, _ = water.at(np.rint(y).astype(int), np.rint(x).astype(int))
    dry = present & (square < 0)
    xy[dry] = map.xy(moved.cell[dry])
    # A trail across the seam begins beyond the edge of the map, not at the opposite edge.
    turns = map.on_grid(whole, y) - map.on_grid(x, y)
    # Trails of equal length are logged much faster, so early trails repeat their first point.
    trails = []
    for time in range(len(xy)):
        past = np.arange(time - _TRAIL, time + 1).clip(0)
        trails.append((xy[past] + turns[past] - turns[time])[:, present[time]].swapaxes(0, 1))
    strips, counts = np.concatenate(trails), present.sum(axis=1)
    path, at = f"map/drifters_{map.number}", (clock.frame * np.arange(len(xy)), counts, line)
    style, place = {"colors": DRIFTER, "radii": 0.55 * map.mark, "draw_order": 40}, xy[present]
    send_changing(stream, f"{path}/here", rr.Points2D, *at, style=style, positions=place)
    style = {"colors": DRIFTER, "radii": points(0.8), "draw_order": 30}
    send_changing(stream, f"{path}/trail", rr.LineStrips2D, *at, style=style, strips=strips)
