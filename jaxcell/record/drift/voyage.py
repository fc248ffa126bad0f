import math
from collections.abc import Sequence

import jax
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int, UInt8

from ...drift import SeaDrift, SeaVoyage, Voyage, simulate_voyages
from ..canvas.page import log_tab
from ..canvas.palette import CATEGORIES, FREE, GOAL, OBSTACLE, PLAIN, ROBOT, TEXT
from ..canvas.prose import described
from ..canvas.scale import Scale
from ..canvas.stream import send_changing
from .frame import place_name
from .map import DRIFTER, LAND, CurrentMap, shortened, thinned


# The largest numbers of squares and arrows of a layer.
_MAX_SQUARES, _MAX_ARROWS = 20_000, 1500
_DRIFTERS = 60
_MAX_STEPS = 240
_UP, _DOWN = CATEGORIES["sky blue"], CATEGORIES["blue"]
# The elevation of the eye, in degrees.
_ABOVE = 28
_SIDE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


class _Space:
    """The positions of all cells in three dimensions; the distance of layers is not to scale."""

    def __init__(self, surface: CurrentMap) -> None:
        self.surface = surface
        same, layers = (surface.stream, surface.drift, surface.clock), len(surface.drift.layers)
        self.layers = [CurrentMap(*same, number) for number in range(layers)]
        self.gap = float(surface.size[1]) * min(0.75, 2.5 / max(1, layers - 1))
        "The distance between layers, in kilometres of the map."

    def xyz(self, cells: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 3"]:
        """Return the centres of cells in space; cells are numbered layer by layer."""
        layer, row, column = (one[cells] for one in self.surface.drift.sea.squares)
        flat = self.surface.on_grid(column.astype(float), row.astype(float))
        return np.concatenate([flat, -layer[:, None] * self.gap], axis=1)

    def view(self, title: str, contents: Sequence[str]) -> rrb.Spatial3DView:
        width, height = self.surface.size.tolist()
        deep = self.gap * (len(self.layers) - 1)
        middle = np.array([width / 2, height / 2, -deep / 2])
        away = 1.2 * max(width, height + deep)
        up = math.radians(_ABOVE)
        eye = middle + away * np.array([0.0, -math.cos(up), math.sin(up)])
        return rrb.Spatial3DView(
            origin="/space",
            name=title,
            contents=[f"+ /space/{one}" for one in contents],
            background=OBSTACLE,
            line_grid=False,
            eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=[0, 0, 1]),
        )


def log_voyage(surface: CurrentMap, seed: int) -> rrb.Container:
    """Log a tab that shows the value function, the policy and drifters in three dimensions."""
    stream, drift, space = surface.stream, surface.drift, _Space(surface)
    assert drift.voyage is not None
    policy = drift.voyage.policy
    stream.log("space", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_land(space)
    scale = _log_value(space, policy)
    _log_policy(space, policy)
    goal = rr.Points3D(
        space.xyz(np.flatnonzero(policy.goal)), colors=GOAL, radii=1.8 * surface.mark
    )
    stream.log("space/goal", goal, static=True)
    steps = _log_tracks(space, policy, seed)
    legend = [
        *scale.legend(),
        ("go down", _DOWN),
        ("go up", _UP),
        ("drift, this way", ROBOT),
        ("the goal", GOAL),
        ("a drifter that follows the policy", DRIFTER),
        ("land", LAND),
    ]
    common = ["land/**", "depths", "goal"]
    views = rrb.Horizontal(
        space.view("What each cell is worth", [*common, "value/**"]),
        space.view("What to do there", [*common, "water/**", "policy/**", "drifters"]),
    )
    text = _text(drift, drift.voyage, steps)
    return log_tab(stream, "voyage", "Voyage", views, text, legend, shares=(5, 3), rows=(5, 4))


def _log_land(space: _Space) -> None:
    """Log the land of each layer, and a label with its depth."""
    stream = space.surface.stream
    for layer, water in enumerate(space.surface.drift.waters):
        row, column = np.nonzero(water.land)
        some, stride = thinned(row, column, _MAX_SQUARES)
        at = np.stack([column[some], row[some]], axis=1).astype(float)
        if some.size:
            # Land is a little lower, so that it does not flicker through the water.
            z = -(layer + 0.01) * space.gap
            _log_squares(space, f"space/land/{layer}", at, z, stride, np.array(LAND[:3], np.uint8))
    depths = space.surface.drift.depths
    places = [
        [-0.06 * space.surface.extent, space.surface.size[1] / 2, -layer * space.gap]
        for layer in range(len(depths))
    ]
    labels = [f"{depth:g} m" for depth in depths]
    text = rr.Points3D(places, labels=labels, colors=TEXT, radii=0.001, show_labels=True)
    stream.log("space/depths", text, static=True)


def _log_squares(
    space: _Space,
    path: str,
    at: Float[np.ndarray, "squares 2"],
    z: float,
    stride: int,
    color: UInt8[np.ndarray, "*#squares 3"],
) -> None:
    """Log squares with centres `at` on the grid and sides of `stride` cells, at the height `z`."""
    corners = (at[:, None] + stride * _SIDE + 0.5) * space.surface.side
    height = np.full((*corners.shape[:2], 1), z)
    first = 4 * np.arange(len(at))[:, None, None]
    mesh = rr.Mesh3D(
        vertex_positions=np.concatenate([corners, height], axis=2).reshape(-1, 3),
        triangle_indices=(first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        vertex_colors=np.broadcast_to(color, (len(at), 3)).repeat(4, axis=0),
    )
    space.surface.stream.log(path, mesh, static=True)


def _log_value(space: _Space, policy: Voyage) -> Scale:
    """Log the water, once pale and once coloured by the value function; return the colour scale."""
    drift, value = space.surface.drift, np.asarray(policy.value).copy()
    outside = ~np.asarray(policy.goal)
    # The value in the goal is 0; the goal is shown with the largest value of other cells.
    value[~outside] = value[outside].max()
    scale = Scale.over(value, "a value of {}".format, levels=255)
    colors = np.array(scale.colors, np.uint8)
    level = scale.levels(value).astype(int) - 1
    for map in space.layers:
        water, z = map.water, -map.number * space.gap
        cells, stride = thinned(water.row, water.column, _MAX_SQUARES)
        at = np.stack([water.column[cells], water.row[cells]], axis=1).astype(float)
        pale = np.array(FREE[:3], np.uint8)
        _log_squares(space, f"space/water/{map.number}", at, z, stride, pale)
        shown = colors[drift.of_layer(level, map.number)[cells]]
        _log_squares(space, f"space/value/{map.number}", at, z, stride, shown)
    return scale


def _log_policy(space: _Space, policy: Voyage) -> None:
    """Log the actions of the policy in some of the cells, as arrows."""
    drift, side = space.surface.drift, space.surface.side
    drawn = []
    for map in space.layers:
        water = map.water
        cells, _ = thinned(water.row, water.column, _MAX_ARROWS)
        spacing = max(1.0, math.sqrt(water.cells / cells.size))
        action, goal, chance = (
            drift.of_layer(one, map.number)[cells]
            for one in (policy.action, policy.goal, policy.probability)
        )
        drifts = (action == 0)[:, None]
        mean = np.asarray(map.flow.mean().rate)[0][:, water.row[cells], water.column[cells]].T
        along = mean * (map.arrow * spacing) * side
        along = shortened(along, 1.5 * spacing * float(side.max()))
        up = -0.09 * space.gap * action[:, None].astype(float)
        vector = np.concatenate([np.where(drifts, along, 0), up], axis=1)
        # Arrows are above the water, which would cut them in half.
        height = (0.02 + 0.09 * (action > 0) - map.number) * space.gap
        foot = np.column_stack([map.xy(cells), height])
        foot[:, :2] -= vector[:, :2] / 2
        color = np.array([_UP[:3], ROBOT[:3], _DOWN[:3]])[action + 1]
        color = np.where((chance > 0)[:, None], color, PLAIN[:3])
        drawn.append((foot[~goal], vector[~goal], color[~goal]))
    origins, vectors, colors = (np.concatenate(one) for one in zip(*drawn, strict=True))
    color, radius = colors.astype(np.uint8), 0.09 * spacing * float(side.min())
    arrows = rr.Arrows3D(origins=origins, vectors=vectors, colors=color, radii=radius)
    space.surface.stream.log("space/policy/arrows", arrows, static=True)


def _log_tracks(space: _Space, policy: Voyage, seed: int) -> int:
    """Log simulated drifters that follow the policy, and return the number of steps."""
    drift, clock, stream = space.surface.drift, space.surface.clock, space.surface.stream
    begin = np.ones(drift.cells, bool) if drift.start is None else drift.start
    steps = min(_MAX_STEPS, max(1, int(clock.last * clock.seconds / drift.step)))
    tracks = simulate_voyages(jax.random.key(seed), policy, begin, _DRIFTERS, steps)
    cell = np.asarray(tracks.cell)
    present = cell >= 0
    places = np.full((*cell.shape, 3), np.nan)
    places[present] = space.xyz(cell[present])
    # Offsets separate drifters in one cell.
    off = np.random.default_rng(seed).uniform(-0.3, 0.3, (cell.shape[1], 2))
    places[..., :2] += off * space.surface.side
    places[..., 2] += 0.04 * space.gap
    times = np.rint(np.arange(steps + 1) * (drift.step / clock.seconds)).astype(np.int64)
    counts, style = present.sum(axis=1), {"colors": DRIFTER, "radii": 0.8 * space.surface.mark}
    path, at = "space/drifters", places[present]
    send_changing(
        stream, path, rr.Points3D, times, counts, clock.timeline, style=style, positions=at
    )
    return steps


def _text(drift: SeaDrift, voyage: SeaVoyage, steps: int) -> str:
    lon, lat, depth = voyage.goal
    columns = ["mean_probability", "cells_that_arrive_for_sure"]
    released = "everywhere alike"
    if drift.start is not None:
        released = f"at {place_name(*drift.place(drift.start)[:2])}"
        columns += ["start_probability", "start_hours_if_it_arrives"]
    both = {"discounted": voyage, "surest": drift.surest}
    policies = {name: policy for name, policy in both.items() if policy is not None}
    return f"""# A way to a goal

A drifter goes up, down, or drifts, in steps of {voyage.hours:.3g} hours, to the **green** goal at
{place_name(lon, lat)}, {depth:g} m deep.

- **Left**: the *value* of each cell, yellow if the arrival is soon and likely.
- **Right**: the action in each cell; from grey cells no drifter arrives.
- **Black dots** follow this policy for {steps:,} steps, released {released}.

{described([*policies.values()], *columns, first={"policy": [*policies]})}
"""
