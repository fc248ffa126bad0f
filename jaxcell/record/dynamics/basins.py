import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int, UInt8

from ...dynamics import Basins, Continuation
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import log_pictures
from ..canvas.marks import LABEL
from ..canvas.page import log_tab
from ..canvas.palette import CATEGORIES, MARGIN, OBSTACLE, PLAIN, Color, PictureClass, mix, tint
from ..canvas.prose import Spec, described, made_with, numbers
from ..canvas.scale import Scale
from ..canvas.stream import send_blueprint, send_changing
from ..canvas.timeline import along_values
from .box import SIDE, category, log_axes, scaled, view


_OUT: Color = MARGIN
_MAX_NAMED = len(CATEGORIES)
_PICTURES = "basins", "steps"
_SEEN = """Cells of one colour lead to the same attractor, which has a dark shade; grey cells lead
out of the box. A period is in mappings, 0 where an orbit does not come back."""

_EDGES = """ Dots are edge states, the saddles on the boundaries of basins, seen along all other
axes; their labels are the two attractors."""


def log_basins(stream: rr.RecordingStream, basins: Basins, spec: Spec) -> None:
    """Record the attractors of a system and their basins.

    The pictures show a plane along the first two axes. The timeline `slice` moves the plane along
    the third axis, if any. The plane cuts each further axis in the middle.
    """
    names = np.arange(basins.attractors)
    count = basins.box.cells[2] if basins.box.dimensions > 2 else 1
    times = np.arange(count)
    pictures = _pictures(basins, names, times)
    log_pictures(stream, "box/basins", _classes(basins.attractors), pictures, "slice", times)
    scale = Scale.counting(0, int(basins.step.max()), "{} mappings".format, ground="out of the box")
    steps = _slices(basins, np.where(basins.basin < 0, 0, scale.levels(basins.step)), times)
    log_pictures(stream, "box/steps", scale.classes, steps, "slice", times)
    log_axes(stream, basins.box, basins.names, _PICTURES)
    _log_edges(stream, basins)
    views: list[rrb.View] = [
        view("Basins", "basins", "edges/**"),
        view("Mappings to the group or attractor", "steps"),
    ]
    if _deep(basins):
        _log_orbits(stream, basins)
        views.append(rrb.Spatial3DView(origin="space", name="Attractors"))
    columns = "fraction", "sampled", "period", "cells_on", "mean_steps", "mean_steps_error"
    table = described(basins, *columns, first={"": names.tolist()})
    seen = _SEEN + _cut(basins, "slice")
    if basins.edges is not None:
        seen += _EDGES
        edges = "edge_first", "edge_second", "edge_period", "edge_unstable"
        table += "\n\n" + described(basins, *edges, first={"": range(basins.edges.period.size)})
    parts = [_heading(basins, spec), seen, table, numbers(basins), made_with(spec)]
    text = "\n\n".join(parts)
    legend = [*_legend(basins.attractors), *scale.legend(4)]
    tab = log_tab(stream, "", basins.title, views, text, legend)
    send_blueprint(stream, [tab], "slice", speed=10.0)


def log_continuation(stream: rr.RecordingStream, branches: Continuation, spec: Spec) -> None:
    """Record attractors and their basins over the values of the first parameter."""
    name, values = next(iter(branches.params.items()))
    line, times, meaning = along_values(name, values)
    each = zip(branches.members, branches.label, strict=True)
    middle = np.array(branches.members[0].box.cells[2:3] or (0,)) // 2
    pictures = np.concatenate([_pictures(member, name, middle) for member, name in each])
    log_pictures(stream, "box/basins", _classes(branches.attractors), pictures, line, times)
    for number, share in enumerate(branches.fraction.T):
        curve = f"fractions/attractor_{number}"
        log_curve(stream, curve, share, line, times, color=category(number), shape="Linear")
    log_axes(stream, branches.members[0].box, branches.members[0].names, _PICTURES)
    style, labels = {**LABEL, "positions": [[SIDE / 2, -0.6]]}, branches.parameters
    path, kind = "box/parameters", rr.Points2D
    send_changing(stream, path, kind, times, None, line, style=style, labels=labels)
    columns = "parameters", "count", "outside_share"
    table = described(branches, *columns, first={"": range(times.size)})
    seen = f"{_SEEN}{_cut(branches.members[0])}\n\nA time of the slider `{line}` is {meaning}."
    text = "\n\n".join([_heading(branches, spec), seen, table, made_with(spec)])
    first, last = int(times.min()), int(times.max())
    curves = curve_view("fractions", f"Share of the box, along {line}", last, 1.0, first=first)
    views = [view("Basins", "basins", "parameters"), curves]
    legend = _legend(branches.attractors)
    tab = log_tab(stream, "", branches.title, views, text, legend)
    send_blueprint(stream, [tab], line, speed=max(4.0, (last - first) / 10))


def _heading(result: Basins | Continuation, spec: Spec) -> str:
    _, _, name = str(spec.get("system", "")).rpartition(":")
    return f"# {result.title}" + (f" of the system {name}" if name else "")


def _classes(attractors: int) -> list[PictureClass]:
    """Return the classes of a picture: no attractor, and the basin and cells of each attractor."""
    named = [PictureClass("out of the box", _OUT)]
    for k in range(attractors):
        color = category(k)
        named += [
            PictureClass(f"leads to attractor {k}", tint(color, 0.35)),
            PictureClass(f"attractor {k}", mix(color, OBSTACLE, 0.6)),
        ]
    return named[:256]


def _legend(attractors: int) -> list[tuple[str, Color]]:
    named = [(f"attractor {k}", category(k)) for k in range(min(attractors, _MAX_NAMED))]
    more = attractors - len(named)
    other = [(f"{more} more attractors", PLAIN)] if more else []
    return [*named, *other, ("out of the box", _OUT)]


def _slices(
    basins: Basins, classes: np.ndarray, thirds: Int[np.ndarray, "slices"]
) -> UInt8[np.ndarray, "slices rows columns"]:
    """Return the classes in planes along the first two axes, with rows along the second axis.

    `classes` contains the class of each cell. The planes are at the indices `thirds` along the
    third axis, and cut each further axis in the middle.
    """
    box = basins.box
    rest = [n // 2 for n in box.cells[3:]]
    cuts = [np.ravel_multi_index([k, *rest], box.cells[2:]) if _deep(basins) else 0 for k in thirds]
    first, second = (*box.cells[:2], 1)[:2]
    return classes.astype(np.uint8).reshape(first, second, -1)[..., cuts].T


def _cut(basins: Basins, timeline: str = "") -> str:
    """Describe where the planes of [`_slices`][] cut a box; `timeline`, if any, moves them."""
    if not _deep(basins):
        return ""
    cut = [(name, basins.box.ticks(axis)) for axis, name in enumerate(basins.names)][2:]
    at = [f"{name} = {ticks[ticks.size // 2]:.4g}" for name, ticks in cut]
    planes = f"\n\nThe maps go along {basins.names[0]} and {basins.names[1]}"
    if not timeline:
        return f"{planes}, at {', '.join(at)}."
    name, ticks = cut[0]
    through = f"{planes}, and the timeline `{timeline}` through the {ticks.size} cells of {name}"
    rest = f"; they are cut at {', '.join(at[1:])}" if at[1:] else ""
    return f"{through}, from {ticks[0]:.4g} to {ticks[-1]:.4g}{rest}."


def _deep(basins: Basins) -> bool:
    return basins.box.dimensions > 2


def _pictures(
    basins: Basins, names: Int[np.ndarray, "attractors"], thirds: Int[np.ndarray, "slices"]
) -> UInt8[np.ndarray, "slices rows columns"]:
    """Return pictures at indices `thirds` of the third axis; attractor k is drawn as `names[k]`."""
    kinds = np.append(np.minimum(1 + 2 * np.asarray(names), 255), 0).astype(np.uint8)
    kind = kinds[basins.basin]
    for k, cells in zip(names, basins.attractor_cells, strict=True):
        kind[cells] = min(2 + 2 * k, 255)
    return _slices(basins, kind, thirds)


def _log_orbits(stream: rr.RecordingStream, basins: Basins) -> None:
    """Log the attractors as points along the first three axes of the box."""
    each = {f"attractor_{k}": orbit for k, orbit in enumerate(basins.orbit[:_MAX_NAMED])}
    if basins.attractors > _MAX_NAMED:
        each["more_attractors"] = np.concatenate(basins.orbit[_MAX_NAMED:])
    for k, (name, orbit) in enumerate(each.items()):
        cloud = rr.Points3D(scaled(basins.box, orbit)[:, :3], colors=category(k), radii=0.08)
        stream.log(f"space/{name}", cloud, static=True)
    half = np.full(3, SIDE / 2)
    frame = rr.Boxes3D(centers=[half], half_sizes=[half], colors=PLAIN)
    stream.log("space/box", frame, static=True)


def _log_edges(stream: rr.RecordingStream, basins: Basins) -> None:
    """Log the points of each edge state on the first two axes, with a label at one point."""
    box, edges = basins.box, basins.edges
    if edges is None or not edges.period.size:
        return
    pad = [(0, 0), (0, max(0, 2 - box.dimensions))]

    def drawn(points: np.ndarray) -> np.ndarray:
        place = np.pad(scaled(box, box.wrapped(points)), pad)[:, :2]
        return np.where([False, True], SIDE - place, place)

    # A refined edge state is drawn only at its exact point.
    moving = [edges.orbit[k] for k in np.flatnonzero(edges.period == 0)]
    if moving:
        orbit = np.concatenate(moving)
        finite = orbit[np.isfinite(orbit).all(axis=1)]
        dots = rr.Points2D(drawn(finite), colors=OBSTACLE, radii=0.03)
        stream.log("box/edges/orbits", dots, static=True)
    labels = [f"{one} | {other}" for one, other in zip(edges.first, edges.second, strict=True)]
    states = rr.Points2D(drawn(edges.point), colors=OBSTACLE, radii=0.1, labels=labels)
    stream.log("box/edges/states", states, static=True)
