import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import shapely
from jaxtyping import Float

from ...bounce import Anywhere, HomeFromAnywhere
from ..canvas import palette
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap, log_pictures
from ..canvas.marks import log_lines, points
from ..canvas.page import Legend, log_tab
from ..canvas.prose import Spec, made_with, numbers
from ..canvas.stream import pace, send_blueprint, send_changing


_TIMELINE = "bump"
# Number of runs in the trail of the robot.
_RUNS = 5
# Pixels along the larger side of the map, for the picture of the hull.
_PIXELS = 400
_HULL = palette.mix(palette.FREE, palette.BELIEF, 0.3)
_LEGEND: Legend = (
    ("first robot, and its extent", palette.ROBOT),
    ("walls where it may be", palette.BELIEF),
    ("hull of these places", _HULL),
    ("extent: median of all", palette.PLAIN),
    ("extent: nine tenths have less", palette.TARGET),
)


def log_anywhere(stream: rr.RecordingStream, result: Anywhere, spec: Spec) -> None:
    """Record robots that start anywhere on a map. The map shows only the first robot."""
    map, last, legend = CellMap(stream, result.cells), result.bump.size, _LEGEND
    if isinstance(result, HomeFromAnywhere):
        last, home = int(min(result.bumps_until_home[0], last)), result.homing
        rim = shapely.Point(home.goal).buffer(home.radius, quad_segs=16).exterior
        log_lines(stream, "map/goal", [shapely.get_coordinates(rim)], palette.GOAL, 3.0, 25.0)
        legend = (*_LEGEND, ("goal, and robots that are there", palette.GOAL))
    possible = [stretches(result, bump) for bump in range(1, last + 1)]
    _log_stretches(map, possible)
    _log_hulls(map, possible)
    _log_robot(map, result, last)
    marks = "hull", "stretches", "trail", "robot", "goal"
    seen = map.view("Where the robot is, and where it may be", marks)
    views = rrb.Vertical(seen, rrb.Horizontal(*_log_curves(stream, result)), row_shares=[7, 3])
    tab = log_tab(stream, "", "Start anywhere", views, _text(result, spec), legend)
    send_blueprint(stream, [tab], _TIMELINE, pace(last))


def stretches(result: Anywhere, bump: int) -> Float[np.ndarray, "stretches 2 2"]:
    """Return the end points of the segments of walls where the first robot may be after a bump."""
    possible, boundary = result.trial.sets[bump - 1], result.filter.boundary
    one = possible._replace(slice=np.zeros_like(possible.slice)).joined()
    return np.stack([boundary.point(one.wall, arc) for arc in (one.begin, one.end)], axis=1)


def _log_stretches(map: CellMap, possible: list[Float[np.ndarray, "_ 2 2"]]) -> None:
    """Log `possible`, the wall segments where the first robot may be after each bump."""
    strips = np.concatenate([np.empty((0, 2, 2)), *possible])
    # A very short stretch is drawn as a dash, so that it is visible.
    dash = 0.004 * map.extent * np.array([[-1.0, 0.0], [1.0, 0.0]])
    point = np.ptp(strips, axis=1).max(axis=1) < 0.004 * map.extent
    strips += point[:, None, None] * dash
    lengths = [0, *(len(one) for one in possible)]
    style = {"colors": palette.BELIEF, "radii": points(4.0), "draw_order": 22.0}
    path, kind, times = "map/stretches", rr.LineStrips2D, np.arange(len(lengths))
    send_changing(map.stream, path, kind, times, lengths, _TIMELINE, style=style, strips=strips)


def _log_hulls(map: CellMap, possible: list[Float[np.ndarray, "_ 2 2"]]) -> None:
    """Log the free space in the convex hull of the wall segments `possible` after each bump."""
    free, path = map.cells.room.free_space, "map/hull"
    (left, bottom, right, top), side = map.bounds, map.extent / _PIXELS
    x, y = np.meshgrid(np.arange(left, right, side), np.arange(bottom, top, side))
    hulls = [shapely.MultiPoint(one.reshape(-1, 2)).convex_hull for one in possible]
    # Before the first bump the robot may be anywhere.
    areas = [free, *(hull & free for hull in hulls)]
    shapely.prepare(areas)
    inside = [shapely.contains_xy(area, x + side / 2, y + side / 2) for area in areas]
    pictures = np.stack(inside).astype(np.uint8)
    onto = rr.Transform3D(translation=[left, bottom, 0], scale=[side, side, 1])
    map.stream.log(path, onto, static=True)
    classes = [palette.PictureClass("", palette.CLEAR), palette.PictureClass("hull", _HULL)]
    log_pictures(map.stream, path, classes, pictures, _TIMELINE, np.arange(len(areas)))


def _log_robot(map: CellMap, result: Anywhere, last: int) -> None:
    """Log the first robot up to bump `last`: its trail, and an arrow that ends at the wall."""
    place = np.concatenate([result.trial.start[:1], result.trial.place[0, :last]])
    theta = np.append(result.theta[0, 0], result.theta[0, :last])
    vectors = map.arrow * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    origins = place - np.where(np.arange(last + 1)[:, None] > 0, vectors, 0.0)
    stream, times, line = map.stream, np.arange(last + 1), rr.LineStrips2D
    style = {"colors": palette.ROBOT, "radii": map.arrow / 8, "draw_order": 30.0}
    arrows = {"origins": origins, "vectors": vectors}
    send_changing(stream, "map/robot", rr.Arrows2D, times, None, _TIMELINE, style=style, **arrows)
    # A line needs two points, so the first one has its point twice.
    trail = [place[[0, 0]], *(place[max(0, time - _RUNS) : time + 1] for time in times[1:])]
    style = {"colors": palette.TRAIL, "radii": points(1.5), "draw_order": 20.0}
    send_changing(stream, "map/trail", line, times, None, _TIMELINE, style=style, strips=trail)


def _log_curves(stream: rr.RecordingStream, result: Anywhere) -> list[rrb.View]:
    for name, values, color in (
        ("nine_tenths", result.extent_of_nine_tenths, palette.TARGET),
        ("median", result.median_extent, palette.PLAIN),
        ("first", result.extent[0], palette.ROBOT),
    ):
        path, at = f"extent/{name}", result.bump
        log_curve(stream, path, values, _TIMELINE, at, color=color, shape="Linear")
    until, title = result.bumps_until_localized, "Share of robots that are localized"
    if isinstance(result, HomeFromAnywhere):
        until, title = result.bumps_until_home, "Share of robots at the goal"
    share = until[:, None] <= result.bump
    log_curve(stream, "share", share.mean(axis=0), _TIMELINE, result.bump, color=palette.KNOWN)
    last = result.bump.size
    most = float(np.max(result.extent, where=np.isfinite(result.extent), initial=0.0))
    extent = curve_view("extent", "Extent of what is possible, m", last, most)
    return [extent, curve_view("share", title, last, 1.0)]


def _text(result: Anywhere, spec: Spec) -> str:
    title, task = "Where is the robot?", "Where is it?"
    if isinstance(result, HomeFromAnywhere):
        title, task = "Home from anywhere", "It finds out where it is, and comes to the goal."
    return f"""# {title}

A robot is put down anywhere. It drives straight until it bumps, turns, and goes on; of each run
it knows the length only. {task}

Drag `bump`, or press play. Blue walls are all the places where the robot can be, whatever
its errors within their bounds.

## Numbers

{numbers(result)}

{made_with(spec, result.cells)}"""
