"""The way to a goal in three dimensions: what cells are worth, what to do there, and drifters."""

import dataclasses
import math

import jax
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int, UInt8

from ..drift import Voyage, simulate_voyages
from .blueprint import legend_view, log_text
from .canvas.palette import CATEGORIES, FREE, GOAL, OBSTACLE, PLAIN, ROBOT, TEXT, Color, ramp
from .drift_currents import arrow_scale
from .drift_groups import DRIFTER
from .drift_text import voyage_text
from .sea_map import LAND, SeaMap, log_legend


# Squares and arrows of a layer.
_MOST_SQUARES, _MOST_ARROWS = 20_000, 1500
_DRIFTERS = 60
_MOST_STEPS = 240
_SHADES = 5
_UP, _DOWN = CATEGORIES["sky blue"], CATEGORIES["blue"]
# How high the eye is above the plane, in degrees.
_ABOVE = 28
_SIDE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


@dataclasses.dataclass(frozen=True)
class _Space:
    """Where the cells of all layers are in space; depths are stretched."""

    sea: SeaMap

    @property
    def gap(self) -> float:
        """From layer to layer, in kilometres of the map."""
        layers = len(self.sea.drift.waters)
        return float(self.sea.size[1]) * min(0.75, 2.5 / max(1, layers - 1))

    def points(self, layer: int, cells: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 3"]:
        flat = self.sea.centres(layer, cells)
        return np.concatenate([flat, np.full((len(flat), 1), -layer * self.gap)], axis=1)

    def of_sea(self, cells: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 3"]:
        """The same by numbers among the cells of all layers."""
        layer, row, column = (one[cells] for one in self.sea.drift.squares)
        flat = self.sea.xy(column.astype(float), row.astype(float))
        return np.concatenate([flat, -layer[:, None] * self.gap], axis=1)

    def view(self, name: str, contents: list[str]) -> rrb.Spatial3DView:
        width, height = self.sea.size.tolist()
        deep = self.gap * (len(self.sea.drift.waters) - 1)
        middle = np.array([width / 2, height / 2, -deep / 2])
        away = 1.2 * max(width, height + deep)
        eye = middle + away * np.array(
            [0.0, -math.cos(math.radians(_ABOVE)), math.sin(math.radians(_ABOVE))]
        )
        return rrb.Spatial3DView(
            origin="/space",
            name=name,
            contents=[f"+ /space/{one}" for one in contents],
            background=OBSTACLE,
            line_grid=False,
            eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=[0, 0, 1]),
        )


def log_voyage(stream: rr.RecordingStream, sea: SeaMap, seed: int) -> rrb.Container:
    """Logs the value function, the policy, and drifters that follow it."""
    voyage = sea.drift.voyage
    assert voyage is not None
    space = _Space(sea)
    stream.log("space", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_land(stream, space)
    least, most = _log_value(stream, space, voyage)
    _log_policy(stream, space, voyage)
    goal = space.of_sea(np.flatnonzero(voyage.goal))
    ball = rr.Points3D(goal, colors=GOAL, radii=1.8 * sea.mark)
    stream.log("space/goal", ball, static=True)
    steps = _log_tracks(stream, space, voyage, seed)
    levels = np.linspace(1, 0, _SHADES)
    entries: list[tuple[str, Color]] = [
        (f"a value of {least + level * (most - least):.0f}", (red, green, blue))
        for level, (red, green, blue) in zip(levels.tolist(), ramp(levels).tolist(), strict=True)
    ]
    entries += [
        ("go down", _DOWN),
        ("go up", _UP),
        ("drift, this way", ROBOT),
        ("the goal", GOAL),
        ("a drifter that follows the policy", DRIFTER),
        ("land", LAND),
    ]
    log_legend(stream, sea, "voyage/legend", entries)
    log_text(stream, "voyage/text", voyage_text(sea, steps))
    common = ["land/**", "depths", "goal"]
    views = [
        space.view("What each cell is worth", [*common, "value/**"]),
        space.view("What to do there", [*common, "water/**", "policy/**", "drifters"]),
    ]
    beside = rrb.Vertical(
        rrb.TextDocumentView(origin="voyage/text", name="What you see"),
        legend_view("voyage/legend", len(entries)),
        row_shares=[5, 4],
    )
    return rrb.Horizontal(*views, beside, column_shares=[7, 7, 6], name="Voyage")


def _log_land(stream: rr.RecordingStream, space: _Space) -> None:
    """Logs the land of each layer, and its depth."""
    sea = space.sea
    for layer, water in enumerate(sea.drift.waters):
        row, column = np.nonzero(water.number < 0)
        stride = max(1, math.ceil(math.sqrt(row.size / _MOST_SQUARES)))
        some = (row % stride == stride // 2) & (column % stride == stride // 2)
        at = np.stack([column[some], row[some]], axis=1).astype(float)
        # A little lower, so that it does not flicker through the water.
        z = -(layer + 0.01) * space.gap
        if some.any():
            color = np.tile(np.array(LAND[:3], np.uint8), (some.sum(), 1))
            _log_squares(stream, f"space/land/{layer}", sea, at, z, stride, color)
    depths = np.array([[0, sea.size[1] / 2, -k * space.gap] for k in range(len(sea.drift.waters))])
    depths[:, 0] = -0.06 * sea.extent
    labels = [f"{depth:g} m" for depth in sea.drift.depths]
    text = rr.Points3D(depths, labels=labels, colors=TEXT, radii=0.001, show_labels=True)
    stream.log("space/depths", text, static=True)


def _log_squares(
    stream: rr.RecordingStream,
    path: str,
    sea: SeaMap,
    at: Float[np.ndarray, "squares 2"],
    z: float,
    stride: int,
    color: UInt8[np.ndarray, "squares 3"],
) -> None:
    """Logs squares around places of the grid at one height."""
    corners = (at[:, None] + stride * _SIDE + 0.5) * sea.side
    height = np.full((*corners.shape[:2], 1), z)
    first = 4 * np.arange(len(at))[:, None, None]
    mesh = rr.Mesh3D(
        vertex_positions=np.concatenate([corners, height], axis=2).reshape(-1, 3),
        triangle_indices=(first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        vertex_colors=np.repeat(color, 4, axis=0),
    )
    stream.log(path, mesh, static=True)


def _log_value(stream: rr.RecordingStream, space: _Space, voyage: Voyage) -> tuple[float, float]:
    """Logs the water and the value function as squares; gives the ends of the scale."""
    sea = space.sea
    assert voyage.value is not None
    value = np.asarray(voyage.value)
    outside = ~np.asarray(voyage.goal)
    least, most = float(value[outside].min()), float(value[outside].max())
    level = (value - least) / max(most - least, 1e-12)
    # What is in the goal gains nothing more; it is where the value would be largest.
    level[~outside] = 1.0
    for layer, water in enumerate(sea.drift.waters):
        cells = sea.thinned(layer, _MOST_SQUARES)
        stride = max(1, math.ceil(math.sqrt(water.cells / _MOST_SQUARES)))
        at = np.stack([water.column[cells], water.row[cells]], axis=1).astype(float)
        color = ramp(sea.drift.of_layer(level, layer)[cells])
        pale = np.tile(np.array(FREE[:3], np.uint8), (cells.size, 1))
        _log_squares(stream, f"space/water/{layer}", sea, at, -layer * space.gap, stride, pale)
        _log_squares(stream, f"space/value/{layer}", sea, at, -layer * space.gap, stride, color)
    return least, most


def _log_policy(stream: rr.RecordingStream, space: _Space, voyage: Voyage) -> None:
    """Logs what to do in some of the cells as arrows, on squares of water."""
    sea = space.sea
    scale = arrow_scale(sea)
    origins, vectors, colors = [], [], []
    for layer, (water, flow) in enumerate(zip(sea.drift.waters, sea.drift.flows, strict=True)):
        cells = sea.thinned(layer, _MOST_ARROWS)
        spacing = max(1.0, math.sqrt(water.cells / cells.size))
        action = sea.drift.of_layer(np.asarray(voyage.action), layer)[cells]
        mean = np.asarray(flow.mean().rate)[0][:, water.row[cells], water.column[cells]].T
        along = mean * (scale * spacing) * sea.side
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along *= np.minimum(1, 1.5 * spacing * sea.side.max() / np.maximum(length, 1e-12))
        up = -0.09 * space.gap * action[:, None].astype(float)
        vector = np.concatenate([np.where(action[:, None] == 0, along, 0), up], axis=1)
        foot = space.points(layer, cells)
        foot[:, :2] -= vector[:, :2] / 2
        # Above the water, so that it does not cut them in half.
        foot[:, 2] += np.where(action == 0, 0.02, 0.02 + 0.09 * (action > 0)) * space.gap
        arrives = sea.drift.of_layer(np.asarray(voyage.probability), layer)[cells] > 0
        goal = sea.drift.of_layer(voyage.goal, layer)[cells]
        shown = ~goal
        color = np.array([_UP[:3], ROBOT[:3], _DOWN[:3]])[action + 1]
        color = np.where(arrives[:, None], color, PLAIN[:3])
        origins.append(foot[shown])
        vectors.append(vector[shown])
        colors.append(color[shown])
    arrows = rr.Arrows3D(
        origins=np.concatenate(origins),
        vectors=np.concatenate(vectors),
        colors=np.concatenate(colors).astype(np.uint8),
        radii=0.09 * spacing * float(sea.side.min()),
    )
    stream.log("space/policy/arrows", arrows, static=True)


def _log_tracks(stream: rr.RecordingStream, space: _Space, voyage: Voyage, seed: int) -> int:
    """Logs drifters that follow the policy, along the chain; gives the number of steps."""
    sea, clock = space.sea, space.sea.clock
    start = sea.drift.start
    begin = np.ones(sea.drift.sea.cells, bool) if start is None else start
    steps = min(_MOST_STEPS, max(1, int(clock.last * clock.seconds / sea.drift.duration)))
    tracks = simulate_voyages(jax.random.key(seed), voyage, begin, _DRIFTERS, steps)
    cell = np.asarray(tracks.cell)
    there = cell >= 0
    points = np.full((*cell.shape, 3), np.nan)
    points[there] = space.of_sea(cell[there])
    # Several in one cell would be one point.
    off = np.random.default_rng(seed).uniform(-0.3, 0.3, (cell.shape[1], 2)) * sea.side
    points[..., :2] += off
    points[..., 2] += 0.04 * space.gap
    times = np.rint(np.arange(steps + 1) * (sea.drift.duration / clock.seconds)).astype(np.int64)
    index = [rr.TimeColumn(clock.unit, sequence=times)]
    columns = rr.Points3D.columns(positions=points[there])
    stream.send_columns("space/drifters", index, columns.partition(there.sum(axis=1)))
    style = rr.Points3D.from_fields(colors=DRIFTER, radii=0.8 * sea.mark)
    stream.log("space/drifters", style, static=True)
    return steps
