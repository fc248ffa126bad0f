"""Recordings of robots that are driven, written while they drive."""

import math
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int32

from ..automata import Filter
from ..space import CellSpace
from .blueprint import extent, fixed, log_map, log_text, map_view, new_stream, recording_name
from .canvas.belief import (
    MAX_ARROWS,
    arrows,
    belief_length,
    log_belief_style,
    log_shades,
    shades,
)
from .canvas.map import on_squares
from .canvas.palette import BELIEF, CATEGORIES, KNOWN, OBSTACLE, TRAIL, Color, robot_color
from .canvas.prose import describe, made_with
from .robot_track import NOWHERE, RecordedRobot, Track, longer_trail
from .viewer import viewer_sink


# Seconds between two looks at the robots.
_LOOK = 0.2
# Seconds of the robot in a second, where a recording is played.
_SPEED = 8.0
_ESTIMATE: Color = CATEGORIES["pink"]
_DONE = ("localized", "arrived", "patrolled")


class RobotRecording:
    """A Rerun recording of robots, written while they drive.

    A context manager. Whatever ends the run, even the loss of power, the file has all but the last
    moments of it. Over the timelines `seconds` and `observation` it has the true pose and the trail
    of each robot, where its odometry has it, what it observed, and for a robot that is localized
    the cells where it may be, by its filter.

    In the block, `event` takes the events of the run, as `jaxcell.robot.RunLog.on_event` tells
    them.

    A robot that made a step and met a wall:

        >>> import pathlib, tempfile
        >>> from jaxcell import record
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     with record.RobotRecording(path, [record.RecordedRobot()]) as recording:
        ...         recording.event("observation", {"seconds": 1.0, "observation": 0})
        ...         recording.event("observation", {"seconds": 2.0, "observation": 1})
        ...     path.stat().st_size > 1000
        True
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        robots: Sequence[RecordedRobot],
        *,
        cells: CellSpace | None = None,
        filter: Filter | None = None,
        filter_of_cells: bool = True,
        viewer: str | None = None,
        spec: Mapping[str, Any] | None = None,
    ) -> None:
        """**Arguments:**

        - `path`: the file to write or replace; its name ends in `.rrd`.
        - `robots`: who drives.
        - `cells`: the map that they drive in, if it is known.
        - `filter`: the localization filter that the robot runs, if it does.
        - `filter_of_cells`: whether it is of that map, so that its cells can be shown on it.
        - `viewer`: where to show the run as it goes; see `jaxcell.record.viewer.viewer_sink`.
        - `spec`: what was asked for, shown in the text.

        **Raises:** `ValueError` if there are no robots, if the name or the viewer is not one, or if
        the filter is not of these cells; `OSError` if there is no such folder, or no viewer.
        """
        path = Path(path)
        if path.suffix != ".rrd":
            raise ValueError(f"{path}: expected the name of a recording, which ends in .rrd")
        if not path.parent.is_dir():
            raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
        if not robots:
            raise ValueError("robots: expected one or more, got none")
        on_map = False
        if filter is not None and cells is not None and filter_of_cells:
            on_map = True
            if filter.uncertainty[0] != cells.size:
                raise ValueError(
                    f"filter: it is of {filter.uncertainty[0]} cells, and the map has {cells.size}"
                )
        self._path, self._cells, self._filter = path, cells, filter
        self._filter_on_map = on_map
        self._spec = dict(spec or {})
        self._robots = [Track(about, robot_color(index)[1]) for index, about in enumerate(robots)]
        self._viewer = None if viewer is None else viewer_sink(viewer)
        self._stream = new_stream("robot")
        # The clock of the robot is the one that counts.
        self._stream.set_log_time_enabled(False)
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="recording", daemon=True)

    def __enter__(self) -> "RobotRecording":
        file = rr.FileSink(self._path)
        self._stream.set_sinks(*([file] if self._viewer is None else [file, self._viewer]))
        self._stream.send_recording_name(recording_name(self._path))
        time = rrb.TimePanel(
            timeline="seconds",
            playback_speed=_SPEED,
            play_state="playing" if self._viewer is None else "following",
            state="collapsed",
        )
        self._stream.send_blueprint(fixed(self._layout(), time))
        self._log_static()
        self._at(0.0, 0)
        if self._filter is not None:
            self._log_belief(self._filter.cells(0))
            self._log_scalar(
                self._robots[0], "filter/uncertainty", int(self._filter.uncertainty[0])
            )
            self._log_scalar(self._robots[0], "filter/color", int(self._filter.color[0]))
        for robot in self._robots:
            self._log_estimate(robot, (0.0, 0.0, 0.0))
        self._watcher.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._closing.set()
        self._watcher.join()
        self._follow()
        self._stream.disconnect()

    def event(self, name: str, fields: Mapping[str, Any]) -> None:
        """Takes an event of the run.

        **Arguments:**

        - `name`: `"observation"`, `"end"`, or another, which only the text log tells.
        - `fields`: `seconds`, the time by the clock; `robot`, the index of the robot, 0 unless
            given. An observation has `observation`, 0 for a step and 1 for a bump; it may have
            `estimate`, how far ahead and left of its start the odometry has the robot, in metres,
            and by how much turned, in radians; and `state`, `color` and `uncertainty` of a filter.
            An end has `result` and `reason`.
        """
        with self._lock:
            robot = self._robots[fields.get("robot", 0)]
            self._follow_one(robot)
            if name == "observation":
                robot.observe()
            self._at(robot.seconds(fields), robot.observed)
            if name == "observation":
                self._log_observation(robot, fields)
                return
            if name == "end":
                # So that what came last can be seen, up to the end.
                for path, value in robot.scalars.items():
                    self._log_scalar(robot, path, value)
            told = {key: fields[key] for key in fields if key not in ("seconds", "robot")}
            text = ": ".join([name, *map(str, told.values())])
            fine = told.get("result") in _DONE
            self._say(robot, text, "INFO" if fine else "WARN")
            if told.get("result") == "localized":
                self._log_known(robot.cells)

    def _watch(self) -> None:
        while not self._closing.wait(_LOOK):
            self._follow()

    def _follow(self) -> None:
        with self._lock:
            for robot in self._robots:
                self._follow_one(robot)

    def _follow_one(self, robot: Track) -> None:
        """Logs where a robot has been since the last time."""
        poses, observation = robot.follow()
        if not len(poses):
            return
        name = robot.about.name
        when = [
            rr.TimeColumn("seconds", duration=poses[:, 0]),
            rr.TimeColumn("observation", sequence=observation),
        ]
        heading = np.stack([np.cos(poses[:, 3]), np.sin(poses[:, 3])], axis=1)
        columns = rr.Arrows2D.columns(origins=poses[:, 1:3], vectors=self._length * heading)
        self._stream.send_columns(f"map/robots/{name}", when, columns)
        robot.trail = longer_trail(robot.trail, poses[:, 1:3])
        self._at(float(poses[-1, 0]), int(observation[-1]))
        self._stream.log(f"map/trails/{name}", rr.LineStrips2D([robot.trail]))

    def _log_observation(self, robot: Track, fields: Mapping[str, Any]) -> None:
        bumped = int(fields["observation"])
        text = f"observation {robot.observed}: {'bump' if bumped else 'step'}"
        self._log_scalar(robot, f"robot/{robot.about.name}/bumped", bumped)
        if "estimate" in fields:
            self._log_estimate(robot, fields["estimate"])
        if "uncertainty" in fields:
            size = fields["uncertainty"]
            text += f"; it may be in {size:,} {'cell' if size == 1 else 'cells'}"
            self._log_scalar(robot, "filter/uncertainty", size)
            self._log_scalar(robot, "filter/color", fields["color"])
            if self._filter is not None:
                refuted = fields["state"] is None
                robot.cells = NOWHERE if refuted else self._filter.cells(fields["state"])
                self._log_belief(robot.cells)
        self._say(robot, text, "INFO")

    def _log_estimate(self, robot: Track, estimate: Sequence[float]) -> None:
        x, y, theta = robot.about.start or (0.0, 0.0, 0.0)
        ahead, left, _ = estimate
        place = np.array(
            [
                x + ahead * math.cos(theta) - left * math.sin(theta),
                y + ahead * math.sin(theta) + left * math.cos(theta),
            ]
        )
        robot.believed = longer_trail(robot.believed, place[None])
        path = f"{self._frame(robot)}/estimates/{robot.about.name}"
        self._stream.log(path, rr.Points2D(place[None]))
        self._stream.log(f"{path}/trail", rr.LineStrips2D([robot.believed]))

    def _log_belief(self, where: Int32[np.ndarray, "belief"]) -> None:
        if self._cells is None or not self._filter_on_map:
            return
        few = where if where.size <= MAX_ARROWS else NOWHERE
        origins, vectors = arrows(self._cells, few, belief_length(self._cells))
        self._stream.log("map/belief", rr.Arrows2D(origins=origins, vectors=vectors))
        picture = on_squares(self._cells, shades(self._cells, where))
        self._stream.log("map/grid/belief", rr.SegmentationImage(picture))

    def _log_known(self, where: Int32[np.ndarray, "belief"]) -> None:
        """Marks the cells that are left in the end."""
        if self._cells is None or not self._filter_on_map:
            return
        x, y, _ = self._cells.centre(where[:MAX_ARROWS])
        half = max(0.5 * self._cells.cell, 0.014 * extent(self._cells))
        boxes = rr.Boxes2D(centers=np.stack([x, y], axis=1), half_sizes=np.full((x.size, 2), half))
        self._stream.log("map/candidates", boxes)

    def _log_static(self) -> None:
        stream, cells = self._stream, self._cells
        if cells is not None:
            log_map(stream, cells)
        if cells is not None and self._filter_on_map:
            log_belief_style(stream, cells)
            log_shades(stream)
            line = rr.Boxes2D.from_fields(
                colors=KNOWN, radii=rr.Radius.ui_points(2.5), draw_order=30
            )
            stream.log("map/candidates", line, static=True)
        stream.log("odometry", rr.Transform3D(scale=[1, -1, 1]), static=True)
        for robot in self._robots:
            name = robot.about.name
            style = rr.Arrows2D.from_fields(
                colors=robot.color, radii=self._length / 7, draw_order=18
            )
            stream.log(f"map/robots/{name}", style, static=True)
            self._log_line_style(
                f"map/trails/{name}", TRAIL if len(self._robots) == 1 else robot.color, 15.0
            )
            path = f"{self._frame(robot)}/estimates/{name}"
            point = rr.Points2D.from_fields(
                colors=_ESTIMATE, radii=rr.Radius.ui_points(5), draw_order=28
            )
            stream.log(path, point, static=True)
            self._log_line_style(f"{path}/trail", _ESTIMATE, 14.0)
            self._log_series_style(f"robot/{name}/bumped", robot.color)
        self._log_series_style("filter/uncertainty", BELIEF)
        self._log_series_style("filter/color", KNOWN)
        log_text(stream, "text", self._text())

    def _log_line_style(self, path: str, color: Color, order: float) -> None:
        line = rr.LineStrips2D.from_fields(
            colors=color, radii=rr.Radius.ui_points(1.5), draw_order=order
        )
        self._stream.log(path, line, static=True)

    def _log_series_style(self, path: str, color: Color) -> None:
        # What follows from an observation is drawn from that observation on.
        line = rr.SeriesLines(colors=color, widths=2, interpolation_mode="StepAfter")
        self._stream.log(path, line, static=True)

    def _log_scalar(self, robot: Track, path: str, value: int) -> None:
        robot.scalars[path] = value
        self._stream.log(path, rr.Scalars(float(value)))

    def _say(self, robot: Track, text: str, level: str) -> None:
        who = f"{robot.about.name}: " if len(self._robots) > 1 else ""
        self._stream.log("log", rr.TextLog(who + text, level=level))

    def _at(self, seconds: float, observation: int) -> None:
        """Sets the times of what this thread logs next."""
        self._stream.set_time("seconds", duration=float(seconds))
        self._stream.set_time("observation", sequence=int(observation))

    @property
    def _length(self) -> float:
        """Of the arrow of a robot, in metres."""
        cells = self._cells
        return 0.3 if cells is None else max(0.7 * cells.cell, 0.035 * extent(cells))

    def _frame(self, robot: Track) -> str:
        known = self._cells is not None and robot.about.start is not None
        return "map" if known else "odometry"

    def _layout(self) -> rrb.Container:
        frames = {self._frame(robot) for robot in self._robots}
        views: list[rrb.View] = []
        if self._cells is not None:
            shown = ["grid/belief", "belief", "trails/**", "robots/**", "estimates/**"]
            views.append(map_view(self._cells, "Where it is", [*shown, "candidates"]))
        if "odometry" in frames:
            views.append(
                rrb.Spatial2DView(
                    origin="odometry", name="Where its wheels say it is", background=OBSTACLE
                )
            )
        bumps = [f"+ /robot/{robot.about.name}/bumped" for robot in self._robots]
        plots = [("Bumps (1) and steps (0)", bumps)]
        if self._filter is not None:
            plots = [
                ("Cells where it may be", ["+ /filter/uncertainty"]),
                ("Colour of the filter", ["+ /filter/color"]),
                *plots,
            ]
        boundary = rrb.TimeRangeBoundary
        # From the start to the end, not what is near the time that is shown.
        whole = rrb.TimeRange(start=boundary.absolute(seq=0), end=boundary.infinite())
        series = [
            rrb.TimeSeriesView(
                origin="/",
                name=name,
                contents=paths,
                axis_x=rrb.TimeAxis(view_range=whole),
                plot_legend=rrb.PlotLegend(visible=False),
            )
            for name, paths in plots
        ]
        return rrb.Horizontal(
            rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*series), row_shares=[7, 3]),
            rrb.Vertical(
                rrb.TextDocumentView(origin="text", name="What you see"),
                rrb.TextLogView(origin="log", name="What it observed"),
            ),
            column_shares=[3, 2],
            name="A run of a robot",
        )

    def _text(self) -> str:
        lines = ["# A run of a robot", ""]
        if self._cells is not None:
            lines += [describe(self._cells), ""]
        if any(robot.about.trace is not None for robot in self._robots):
            lines += ["- **Arrow and line**: where the emulated robot truly is, and was."]
        lines += [
            "- **Pink**: where the encoders of its wheels say that it is, after each observation."
        ]
        if self._filter_on_map:
            lines += [
                "- **Blue**: the cells where it may be, by its filter; squares while they are more "
                f"than {MAX_ARROWS}.",
                "- **Green**: those that are left when it is localized.",
            ]
        lines += ["", "The timeline `observation` counts what it observed.", ""]
        return "\n".join([*lines, made_with(self._spec)])
