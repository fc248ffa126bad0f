"""The background of a plot: the room, box, sea or graph of a result."""

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from ...base.quantities import Quantity, Result
from ...space import Box, CellSpace
from ..canvas.palette import FREE, GOAL, PLAIN, START, robot_color
from .colors import Drawn, color_of


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...optimize import Graph


class Ground(NamedTuple):
    """A background of a plot, such as a room, on which the elements of an array are drawn."""

    dims: tuple[str, ...]
    "The drawn dimensions, which are the last dimensions of the quantity."
    draw: Callable[["Axes", Drawn, dict[str, Any]], None]
    "A function that draws a quantity on the background, with options for matplotlib."


def of(result: Result, about: Quantity) -> Ground | None:
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


def _room(cells: CellSpace, ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    """Draw the cells of a room, with its walls."""

    def draw(values: np.ndarray, style: dict[str, Any]) -> Any:
        squares = np.ma.masked_all(cells.free.size)
        squares[cells.square] = values
        return _squares(ax, cells, squares.reshape(cells.free.shape), style | options)

    drawn.show(ax, draw)
    _walls(ax, cells)


def _path(cells: CellSpace, ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    from matplotlib.colors import ListedColormap

    free = np.ma.masked_where(~cells.free, np.zeros(cells.free.shape))
    _squares(ax, cells, free, {"cmap": ListedColormap([color_of(FREE)])})
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
    _walls(ax, cells)


def _squares(ax: "Axes", cells: CellSpace, values: np.ndarray, style: dict[str, Any]) -> Any:
    rows, columns = cells.free.shape
    left, bottom = cells.origin
    box = (left, left + columns * cells.cell, bottom, bottom + rows * cells.cell)
    return ax.imshow(values, origin="lower", extent=box, **{"interpolation": "nearest", **style})


def _walls(ax: "Axes", cells: CellSpace) -> None:
    ink = ax.spines["left"].get_edgecolor()
    if cells.workspace is not None:
        for ring in shapely.get_rings(shapely.get_parts(cells.workspace.environment)):
            ax.plot(*shapely.get_coordinates(ring).T, color=ink, linewidth=1.5)
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
    if drawn.about.kind == "index":
        drawn = dataclasses.replace(drawn, values=np.maximum(drawn.values, -2))

    def draw(values: np.ndarray, style: dict[str, Any]) -> Any:
        values = np.ma.masked_where(drawn.values == -2, values)
        return ax.pcolormesh(lon, lat, values, shading="nearest", **(style | options))

    drawn.show(ax, draw)
    ax.set_facecolor(color_of(PLAIN))
    ax.set_aspect(1 / max(0.1, np.cos(np.radians(np.nanmean(lat)))))
    ax.locator_params(nbins=5)
    ax.set_xlabel("longitude (degrees east)")
    ax.set_ylabel("latitude (degrees north)")


def _network(graph: "Graph", ax: "Axes", drawn: Drawn, options: dict[str, Any]) -> None:
    """Draw the vertices and edges of a graph. Vertices without coordinates form a circle."""
    from matplotlib.collections import LineCollection

    turn = 2 * np.pi * np.arange(graph.vertices) / graph.vertices
    xy = graph.xy
    if xy is None:
        xy = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ax.add_collection(LineCollection(list(xy[graph.edges]), colors=[color_of(PLAIN)]))
    dots = {"s": 120, "zorder": 2}
    drawn.show(ax, lambda c, style: ax.scatter(*xy.T, c=c, **(dots | style | options)))
    ax.set_aspect("equal")
    if graph.xy is not None:
        ax.set_xlabel("x (m)")
        ax.set_ylabel("y (m)")
