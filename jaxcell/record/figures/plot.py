import dataclasses
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from ...base.optional_modules import import_module
from ...base.quantities import Kind, Quantity, Result, parts, quantities
from ...base.shown import Pictured
from ...optimize.graph import Graph
from ...space import Box, CellSpace
from ..canvas.palette import robot_color
from . import ground
from .colors import Drawn, color_of


if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Largest number of entries for a chart of bars, and of rows for a chart of lines.
_BARS, _LINES = 40, 8
# Dimensions of time; a map shows the last entry by default.
_PROCESSES = {"bump", "step", "time"}


def plot(
    result: Pictured,
    name: str | None = None,
    *,
    ax: "Axes | None" = None,
    on: CellSpace | Box | Graph | None = None,
    **options: Any,
) -> "Axes":
    """Draw one quantity of a result with matplotlib.

    A quantity over the cells of a room, a box or a sea, or over the vertices of a graph, is drawn
    as a map, and cells over time as a path. Other arrays are drawn as a curve or bars (one
    dimension), or as lines or an image (two dimensions). Other dimensions are fixed at an index.

    **Arguments:**

    - `result`: the result of a study, or another object with a method `plot`. By default a
        cell space, a map or a graph is drawn whole, and a chain as its matrix.
    - `name`: the name of a quantity, as in [`jaxcell.record.dataset`][]; by default
        `result.picture` or, if that is empty, the first quantity on a map.
    - `ax`: the axes to draw in; by default the axes of a new figure.
    - `on`: the cell space, the box or the graph whose cells the last dimension numbers, for objects
        that do not have it, such as groups of a map.
    - `options`: the index along a dimension, such as `direction=3`; by default the last index of
        `bump`, `step` and `time`, otherwise the first. Other options are for matplotlib.

    **Returns:** the axes.

    **Raises:** `ValueError` for a quantity that the result does not have, or that is a single
    number, or for another number of cells `on`; `IndexError` for an index that does not exist;
    `ModuleNotFoundError` without matplotlib, which `jaxcell[plot]` installs.

    The steps to the groups of a robot that bounces in a lab, as a map for one direction:

        >>> from jaxcell import record, study
        >>> groups = study.Groups(map="@lab_a", bounce=(45.0,)).run()
        >>> record.plot(groups, "step", direction=3).get_title()
        'mappings until the cell is on its group, bounce 45, direction 3'
    """
    draw = ground.whole(result)
    if draw and name is None:
        ax = _new_axes() if ax is None else ax
        draw(ax, options)
        return ax
    name = name or picture(result)
    if name is None:
        raise ValueError(f"{type(result).__name__} has no array to draw; print shows its numbers")
    drawable = _drawable(result)
    owner, own_name, about = drawable.get(name, (result, "", None))
    value = getattr(owner, own_name, None)
    if about is None or value is None:
        names = ", ".join(drawable)
        raise ValueError(f"{name}: not an array of the result; expected one of {names}")
    array, dims = np.asarray(value), list(about.dims)
    if np.iscomplexobj(array):
        array, about = np.abs(array), dataclasses.replace(about, meaning=f"modulus of {name}")
    base = ground.of(result, about)
    if on is not None:
        base, array = ground.under(on, array, name)
        dims = [*dims[:-1], *base.dims]
        base = base._replace(dims=base.dims[-1:])
    kept = base.dims if base else tuple(dims[-2:])
    chosen = []
    for dim in [dim for dim in dims if dim not in kept or dim in options]:
        entry = options.pop(dim, -1 if dim in _PROCESSES else 0)
        size = array.shape[dims.index(dim)]
        if not (isinstance(entry, int) and -size <= entry < size):
            raise IndexError(f"{dim}: {entry!r} is out of range; expected 0 to {size - 1}")
        labels, _ = _coordinate(owner, dim, size)
        label = labels[entry]
        text = f"{label:g}" if isinstance(label, float) else str(label)
        chosen += [f"{dim.replace('_', ' ')} {text}"]
        array = array.take(entry, dims.index(dim))
        dims.remove(dim)
    ax = _new_axes() if ax is None else ax
    drawn = Drawn(about, tuple(dims), array)
    if base and tuple(dims) == base.dims:
        base.draw(ax, drawn, options)
    elif len(dims) == 1 or min(array.shape) <= _LINES:
        _draw_curves(ax, owner, drawn, options)
    else:
        layout = {"aspect": "auto", "origin": "lower", "interpolation": "nearest"}
        drawn.show(ax, lambda values, style: ax.imshow(values, **(layout | style | options)))
        ax.set_xlabel(dims[1].replace("_", " "))
        ax.set_ylabel(dims[0].replace("_", " "))
    ax.set_title(", ".join([about.meaning, *chosen]), wrap=True)
    return ax


def _new_axes() -> "Axes":
    axes: Axes = import_module("matplotlib.pyplot").figure(layout="compressed").add_subplot()
    return axes


def picture(result: Pictured) -> str | None:
    """Return the name of the quantity to draw by default; `None` if the result has no array."""
    drawable = _drawable(result)
    maps = (name for name, (_, _, about) in drawable.items() if ground.of(result, about))
    chosen = getattr(result, "picture", "")
    return chosen if chosen in drawable else next(maps, next(iter(drawable), None))


def _drawable(result: Pictured, prefix: str = "") -> dict[str, tuple[Pictured, str, Quantity]]:
    """Find the arrays of a result and of the results in its fields, keyed by their dataset names.

    Each value is a result, the name of an array in this result, and the array's description.
    """
    if not isinstance(result, Result):
        return {name: (result, name, about) for name, about in _arrays(result).items()}
    arrays: dict[str, tuple[Pictured, str, Quantity]] = {
        prefix + name: (result, name, about)
        for name, about in quantities(type(result)).items()
        if about.dims
        and about.kind not in ("coordinate", "text")
        # Optional arrays may be `None`. Derived arrays are not computed here.
        and vars(result).get(name, name) is not None
    }
    for name, part in parts(result).items():
        if isinstance(part, Result):
            arrays |= _drawable(part, f"{prefix}{name}_")
    return arrays


def _arrays(shown: Pictured) -> dict[str, Quantity]:
    """Describe the arrays of an object that is not a result by the annotations of its fields."""
    described = {}
    for field in dataclasses.fields(shown):  # type: ignore[arg-type]
        value = getattr(shown, field.name)
        names = [one for kind in (field.type, *get_args(field.type)) for one in _axes_of(kind)]
        if names and np.ndim(value):
            # An axis `*cells` stands for any number of axes.
            dims = (*names[:1] * np.ndim(value), *names)[-np.ndim(value) :]
            kind: Kind = "index" if field.name == "group" else "number"
            meaning = field.name.replace("_", " ")
            described[field.name] = Quantity(dims, meaning, None, kind, False, {})
    return described


def _axes_of(annotation: Any) -> list[str]:
    """Return the names of the axes in an annotation of an array; empty for other annotations."""
    return [name.lstrip("*#") for name in getattr(annotation, "dim_str", "").split()]


def _draw_curves(ax: "Axes", result: Pictured, drawn: Drawn, options: dict[str, Any]) -> None:
    """Draw an array as a curve or bars, or an array of two dimensions as several lines."""
    rows, dim = np.atleast_2d(drawn.values), drawn.dims[-1]
    dims = drawn.dims
    if len(dims) == 2 and rows.shape[0] > rows.shape[1]:
        rows, dim, dims = rows.T, dims[0], dims[::-1]
    x, label = _coordinate(result, dim, rows.shape[1])
    words = isinstance(x[0], str) if x else False
    process = len(x) > _BARS or dim in _PROCESSES or (not words and np.ptp(x) != len(x) - 1)
    # Numbers of cells and groups have no values between them.
    labels = not isinstance(result, Result) and rows.dtype.kind != "f"
    dots = {"marker": ".", "linestyle": "none"} if labels else {}
    for number, row in enumerate(rows):
        color = options.get("color", color_of(robot_color(number)[1]))
        style = {"color": color, "label": f"{dims[0]} {number}", **options}
        if process or len(rows) > 1:
            ax.plot(x, row, **(dots | style))
        else:
            ax.bar(x, row, **style)
    if len(rows) > 1:
        ax.legend()
    ax.set_xlabel(label)
    ax.set_ylabel(drawn.label)


def _coordinate(result: Pictured, dim: str, size: int) -> tuple[list[Any], str]:
    """Return the labels of a dimension, such as angles in degrees, and their meaning."""
    described = quantities(type(result)).items()
    labels = [(name, a) for name, a in described if a.dims == (dim,) and a.kind == "coordinate"]
    for name, about in sorted(labels, key=lambda label: label[1].units == "rad"):
        if (values := getattr(result, name)) is not None:
            units = "" if about.units in (None, "1", about.meaning) else f" ({about.units})"
            return np.asarray(values).tolist(), f"{about.meaning}{units}"
    return list(range(size)), dim.replace("_", " ")
