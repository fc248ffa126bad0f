import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Array, Float, Int

from ..mapping import PeriodicGroups
from ..space import CellSpace
from .blueprint import (
    legend_view,
    log_classes,
    log_legend_style,
    log_legends,
    log_map,
    log_pictures,
    log_text,
    map_view,
    recording,
    send_blueprint,
)
from .canvas.palette import GROUP_CLASSES, TEXT
from .pictures import CYCLE_CLASSES, HEADING_ROW, LEGEND_ROWS, GroupPictures, group_pictures
from .tables import group_table, host_groups
from .texts import groups_text


def log_groups(
    path: str | os.PathLike[str],
    cells: CellSpace,
    groups: PeriodicGroups,
    *,
    bounce: Float[np.ndarray, "*batch"] | Array | float,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of the periodic groups of bounce maps.

    For each bouncing angle, over the timeline `direction`: the group that every cell leads to, the
    mappings it takes, and where these groups run; and a text that says what one sees. Several
    angles have a tab each.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `cells`: the cell space.
    - `groups`: the groups of one bounce map, or of a batch.
    - `bounce`: the bouncing angle of each, in radians.
    - `spec`: what was asked for, shown in the text.

    **Raises:** `ValueError` if the groups are not of these cells, or not one for each angle.

    A corridor of three cells, and a robot that turns left at every bump:

        >>> import math
        >>> import pathlib
        >>> import tempfile
        >>> from jaxcell import bounce, mapping, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> image = bounce.bounce_map(cells, math.pi / 2).image
        >>> groups = mapping.periodic_groups(image)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_groups(path, cells, groups, bounce=math.pi / 2)
        ...     path.stat().st_size > 1000
        True
    """
    angles, host = host_groups(cells, groups, bounce)
    headings = np.arange(cells.directions)
    tabs = []
    with recording(path, "groups") as stream:
        log_map(stream, cells)
        for angle, one in zip(angles.tolist(), host, strict=True):
            name = f"bounce_{math.degrees(angle):.6g}"
            table = group_table(cells, one)
            pictures = group_pictures(cells, one, table)
            log_group_style(stream, name, pictures)
            log_group_pictures(stream, name, pictures, "direction", headings, headings)
            log_text(stream, f"{name}/text", groups_text(cells, angle, table, spec or {}))
            tabs.append(groups_layout(cells, name, f"bounce {math.degrees(angle):.6g}°"))
        layout = rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0]
        send_blueprint(stream, layout, "direction", speed=max(2.0, cells.directions / 30))


def log_group_style(stream: rr.RecordingStream, name: str, pictures: GroupPictures) -> None:
    """Logs what does not change with time of the pictures of groups and their legends."""
    log_classes(stream, f"map/grid/{name}/groups", GROUP_CLASSES)
    log_classes(stream, f"map/grid/{name}/cycles", CYCLE_CLASSES)
    log_classes(stream, f"map/grid/{name}/steps", pictures.step_classes)
    log_legend_style(stream, f"{name}/legend")
    arrow = rr.Arrows2D.from_fields(colors=TEXT, radii=0.09, draw_order=50)
    stream.log(f"{name}/legend/heading", arrow, static=True)


def log_group_pictures(
    stream: rr.RecordingStream,
    name: str,
    pictures: GroupPictures,
    timeline: str,
    times: Int[np.ndarray, "times"],
    headings: Int[np.ndarray, "times"],
) -> None:
    """Logs the pictures of the groups for the direction at each time, and their legends."""
    for kind in ("groups", "cycles", "steps"):
        shown = getattr(pictures, kind)[headings]
        log_pictures(stream, f"map/grid/{name}/{kind}", timeline, times, shown)
    legends = [pictures.legends[heading] for heading in headings.tolist()]
    log_legends(stream, f"{name}/legend", timeline, times, legends)
    angle = 2 * np.pi * headings / len(pictures.groups)
    # A legend has y down.
    vector = 0.45 * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    middle = np.array([0.25, HEADING_ROW])
    arrows = rr.Arrows2D.columns(origins=middle - vector, vectors=2 * vector)
    index = [rr.TimeColumn(timeline, sequence=times)]
    stream.send_columns(f"{name}/legend/heading", index, arrows)


def groups_layout(cells: CellSpace, name: str, title: str) -> rrb.Container:
    """What shows the pictures and the text of one bouncing angle."""
    path = f"grid/{name}"
    return rrb.Horizontal(
        rrb.Grid(
            map_view(cells, "The group that each cell leads to", [f"{path}/groups"]),
            map_view(cells, "The mappings that it takes", [f"{path}/steps"]),
            map_view(cells, "Where these groups run", [f"{path}/cycles"]),
            legend_view(f"{name}/legend", LEGEND_ROWS),
            grid_columns=2,
        ),
        rrb.TextDocumentView(origin=f"{name}/text", name="What you see"),
        column_shares=[7, 3],
        name=title,
    )
