from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..base.quantities import Quantity, Result, values
from .canvas.curves import curve
from .canvas.map import CellMap
from .canvas.page import log_legend, log_tab
from .canvas.prose import Spec, made_with, numbers
from .canvas.scale import Scale
from .canvas.stream import send_blueprint
from .data.summary import cells_of


_ON_A_MAP = ("position",), ("direction", "position")


def log_result(stream: rr.RecordingStream, result: Result, spec: Spec) -> None:
    """Record any result, with maps and curves of its quantities."""
    cells, quantities = cells_of(result), values(result)
    maps = {name: one for name, one in quantities.items() if one[0].dims in _ON_A_MAP}
    curves = {name: one for name, one in quantities.items() if one[0].dims == ("step",)}
    timeline = "step" if curves else "direction"
    views: list[Any] = []
    if cells is not None:
        map = CellMap(stream, cells)
        views += [_log_map(map, name, *one, timeline) for name, one in maps.items()]
    for name, (about, value) in curves.items():
        views.append(curve(stream, f"curves/{name}", _titled(about), np.asarray(value)))
    text = "\n\n".join([f"# {result.title}", numbers(result), made_with(spec, cells)])
    tab = log_tab(stream, "", result.title, views, text, [])
    send_blueprint(stream, [tab], timeline, 4.0)


def _log_map(map: CellMap, name: str, about: Quantity, value: Any, timeline: str) -> rrb.Container:
    numbers = np.asarray(value, float)
    scale = Scale.over(numbers, f"{{}} {about.label}".rstrip().format)
    over_time = (timeline, np.arange(len(numbers))) if numbers.ndim == 2 else ()
    picture = map.picture(name, scale.classes, scale.levels(numbers), *over_time)
    key = log_legend(map.stream, f"{name}/legend", scale.legend())
    return rrb.Vertical(map.view(_titled(about), [picture]), key, row_shares=[4, 1])


def _titled(about: Quantity) -> str:
    units = f" ({about.label})" if about.label else ""
    return about.meaning[:1].upper() + about.meaning[1:] + units
