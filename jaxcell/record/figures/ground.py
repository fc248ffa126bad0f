"""The background of a plot: the room, box, sea or graph of a result."""

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from ...base.quantities import Quantity, Result
from ...currents.sphere import wrapped
from ...mapping.generalized import Chain
from ...optimize.graph import Graph
from ...space import Box, CellSpace, Workspace
from ..canvas.palette import FREE, GOAL, PLAIN, START, robot_color
from .colors import Drawn, color_of


if TYPE_CHECKING:
    from matplotlib.axes import Axes


# A grid whose mean position is nearer to the axis, in radii of the Earth, goes round it.
_ROUND = 0.05


class Ground(NamedTuple):
    """A background of a plot, such as a room, on which the elements of an array are drawn."""

    dims: tuple[str, ...]
    "The drawn dimensions, which are the last dimensions of the quantity."
    draw: Callable[["Axes", Drawn, dict[str, Any]], None]
    "A function that draws a quantity on the background, with options for matplotlib."


def of(result: Any, about: Quantity) -> Ground | None:
    """Find the background for a quantity of a result; return `None` if there is none."""
    cells, box, graph = (getattr(result, name, None) for name in ("cells", "box", "graph"))
    if isinstance(cells, CellSpace) and about.dims[-1] == "position":
        return Ground(("position",), functools.partial(_room, cells))
    if isinstance(cells, CellSpace) and about.kind == "cell" and about.dims[0] == "time":
        return Ground(about.dims, functools.partial(_path, cells))
    if isinstance(box, Box) and about.dims == ("cell",):
        return Ground(("cell",), functools.partial(_plane, box, getattr(result, "labels", ())))
    if about.dims[-2:] == ("y", "x") and hasattr(result, "lon"):
        return Ground(("y", "x"), functools.partial(_sea, result))
    if graph is not None and about.dims[-1] == "vertex":
        return Ground(("vertex",), functools.partial(_network, graph))
    return None


def under(on: Any, array: np.ndarray, name: str) -> tuple[Ground, np.ndarray]:
    """Return the background `on`, and an array `name` over its cells, shaped for this background.

    An array over the cells of a room gets the axes direction and position.
    """
    size = array.shape[-1]
    if isinstance(on, CellSpace) and size == on.positions:
        return Ground(("position",), functools.partial(_room, on)), array
    if isinstance(on, CellSpace) and size == on.size:
        turned = array.reshape(*array.shape[:-1], on.directions, on.positions)
        return Ground(("direction", "position"), functools.partial(_room, on)), turned
    if isinstance(on, Box) and size == on.size:
        return Ground(("cell",), functools.partial(_plane, on, ())), array
    if isinstance(on, Graph) and size == on.vertices:
        return Ground(("vertex",), functools.partial(_network, on)), array
    raise ValueError(
        f"on: expected a CellSpace, a Box or a Graph of {size:,} cells, as many as {name} has, got "
        f"a {type(on).__name__}"
    )


def whole(thing: Any) -> Callable[["Axes", dict[str, Any]], None] | None:
    """Return the function that draws an object which is itself a background, or `None`."""
    if isinstance(thing, CellSpace):
        return functools.partial(_cells, thing)
    if isinstance(thing, Workspace):
        return functools.partial(_walls, thing)
    if isinstance(thing, Graph):
        return functools.partial(_graph, thing)
    if isinstance(thing, Chain):
        return functools.partial(_matrix, thing)
    return None


def _room(cells: CellSpace, ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    """Draw the cells of a room, with its walls."""

    def draw(values: np.ndarray, style: dict[str, Any]) -> Any:
        squares = np.ma.masked_all(cells.free.size)
        squares[cells.square] = values
        return _squares(ax, cells, squares.reshape(cells.free.shape), style | options)

    drawn.show(ax, draw)
    _walls(cells.workspace, ax, {})


def _path(cells: CellSpace, ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    _floor(cells, ax, {})
    paths = drawn.values.reshape(len(drawn.values), -1).T
    for robot, path in enumerate(paths):
        x, y, _ = cells.centre(path[path >= 0])
        color = color_of(robot_color(robot)[1])
        style = {"color": color, "label": f"robot {robot}", **options}
        ax.plot(x, y, **style)
        ax.plot(x[0], y[0], "o", color=color_of(START))
        ax.plot(x[-1], y[-1], "o", color=color_of(GOAL))
    if len(paths) > 1:
        ax.legend()
    _walls(cells.workspace, ax, {})


def _cells(cells: CellSpace, ax: "Axes", options: dict[str, Any]) -> None:
    _floor(cells, ax, options)
    _walls(cells.workspace, ax, {})


def _floor(cells: CellSpace, ax: "Axes", options: dict[str, Any]) -> None:
    """Draw the free squares of a room."""
    from matplotlib.colors import ListedColormap

    free = np.ma.masked_where(~cells.free, np.zeros(cells.free.shape))
    _squares(ax, cells, free, {"cmap": ListedColormap([color_of(FREE)]), **options})


def _squares(ax: "Axes", cells: CellSpace, values: np.ndarray, style: dict[str, Any]) -> Any:
    rows, columns = cells.free.shape
    left, bottom = cells.origin
    box = (left, left + columns * cells.cell, bottom, bottom + rows * cells.cell)
    return ax.imshow(values, origin="lower", extent=box, **{"interpolation": "nearest", **style})


def _walls(room: Workspace | None, ax: "Axes", options: dict[str, Any]) -> None:
    style = {"color": ax.spines["left"].get_edgecolor(), "linewidth": 1.5, **options}
    if room is not None:
        for ring in shapely.get_rings(shapely.get_parts(room.environment)):
            ax.plot(*shapely.get_coordinates(ring).T, **style)
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")


def _plane(
    box: Box, labels: tuple[str, ...], ax: "Axes", drawn: Drawn, options: dict[str, Any]
) -> None:
    """Draw the plane along the first two axes of a box; it cuts each further axis in the middle."""

    def draw(values: np.ndarray, style: dict[str, Any]) -> Any:
        squares = values.reshape(box.cells)
        while squares.ndim > 2:
            squares = squares[..., squares.shape[-1] // 2]
        extent = np.stack([box.lower, box.upper], axis=1)[:2].ravel()
        layout = {"origin": "lower", "aspect": "auto", "interpolation": "nearest"}
        return ax.imshow(squares.T, extent=extent, **(layout | style | options))

    names = labels or [f"x{axis}" for axis in range(box.dimensions)]
    if box.dimensions == 1:
        ax.plot(box.ticks(0), drawn.values, **options)
        ax.set_ylabel(drawn.label)
    else:
        drawn.show(ax, draw)
        ax.set_ylabel(names[1])
    ax.set_xlabel(names[0])


def _sea(result: Result, ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    lon, lat = (np.asarray(getattr(result, name)) for name in ("lon", "lat"))
    lon = beside(lon, lon)
    # On a grid that goes round the Earth, the picture begins where longitudes jump.
    jump = np.abs(np.diff(lon, axis=1)).max(axis=0, initial=0.0, where=np.isfinite(lon[:, 1:]))
    first = int(jump.argmax()) + 1 if jump.max(initial=0.0) > 180 else 0
    if drawn.about.kind == "index":
        drawn = dataclasses.replace(drawn, values=np.maximum(drawn.values, -2))

    def draw(values: np.ndarray, style: dict[str, Any]) -> Any:
        values = np.ma.masked_where(drawn.values == -2, values)
        turned = (np.roll(array, -first, axis=1) for array in (lon, lat, values))
        return ax.pcolormesh(*turned, shading="nearest", **(style | options))

    drawn.show(ax, draw)
    ax.set_facecolor(color_of(PLAIN))
    ax.set_aspect(1 / max(0.1, np.cos(np.radians(np.nanmean(lat)))))
    ax.locator_params(nbins=5)
    ax.set_xlabel("longitude (degrees east)")
    ax.set_ylabel("latitude (degrees north)")


def beside(
    lon: Float[np.ndarray, "*places"], grid: Float[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "*places"]:
    """Turn longitudes by 360 degrees where that brings them nearer to the middle of a grid."""
    mean = np.nanmean(np.exp(1j * np.radians(grid)))
    middle = np.degrees(np.angle(mean)) if abs(mean) > _ROUND else 0.0
    return middle + wrapped(lon - middle)


def _network(graph: Graph, ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    """Draw the edges of a graph, and numbers as colours of its vertices."""
    xy = _places(graph)
    dots = {"s": 120, "zorder": 2}
    drawn.show(ax, lambda c, style: ax.scatter(*xy.T, c=c, **(dots | style | options)))
    _edges(graph, ax, {})


def _places(graph: Graph) -> np.ndarray:
    """Return the positions of vertices; vertices without coordinates form a circle."""
    if graph.xy is not None:
        return graph.xy
    turn = 2 * np.pi * np.arange(graph.vertices) / graph.vertices
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _graph(graph: Graph, ax: "Axes", options: dict[str, Any]) -> None:
    _edges(graph, ax, options)
    ax.plot(*_places(graph).T, "o", color=color_of(FREE), markeredgecolor=color_of(PLAIN))


def _matrix(chain: Chain, ax: "Axes", options: dict[str, Any]) -> None:
    """Draw a dot for each positive probability of a chain."""
    ax.spy(chain.to_scipy(), **{"marker": ".", **options})
    ax.set_xlabel("to cell")
    ax.set_ylabel("from cell")


def _edges(graph: Graph, ax: "Axes", options: dict[str, Any]) -> None:
    from matplotlib.collections import LineCollection

    style = {"colors": [color_of(PLAIN)], **options}
    ax.add_collection(LineCollection(list(_places(graph)[graph.edges]), **style))
    ax.autoscale_view()
    ax.set_aspect("equal")
    if graph.xy is not None:
        ax.set_xlabel("x (m)")
        ax.set_ylabel("y (m)")
