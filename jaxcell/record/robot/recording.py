import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...automata import Belief, Filter, Policy
from ...space import CellSpace
from ..canvas.belief import (
    MAX_ARROWS,
    arrows,
    heat,
    heat_scale,
    log_belief_style,
    log_shades,
    robot_length,
    shades,
)
from ..canvas.curves import curve_view, log_curve_style
from ..canvas.map import CellMap, log_classes, on_squares
from ..canvas.marks import points
from ..canvas.page import log_text
from ..canvas.palette import BELIEF, CATEGORIES, KNOWN, OBSTACLE, TRAIL, Color, mix, robot_color
from ..canvas.prose import counted, made_with
from ..canvas.stream import check_name, fixed, new_stream, recording_name
from ..viewer import viewer_sink
from .track import NOWHERE, RecordedRobot, Track, longer_trail


# Interval in seconds at which poses of robots are read.
_LOOK = 0.2
# Speed of a recording in the viewer, in seconds of the run per second.
_SPEED = 8.0
_ESTIMATE: Color = CATEGORIES["pink"]
_TOUCH: Color = CATEGORIES["sky blue"]
# Largest number of cells of a credible set that are shown as arrows.
_FEW = 24
_DONE = ("localized", "arrived", "patrolled")


class RobotRecording:
    """A Rerun recording of robots, written while they drive.

    This is a context manager. If the run is interrupted, even by a loss of power, the file lacks
    only the last moments. The timelines `seconds` and `observation` show the true pose, the
    trail, the position from odometry and the observations of each robot, and the possible cells
    according to its filter.

    To record the events of a run, set `jaxcell.robot.RunLog.on_event` to the method `event`.

    A robot that bumps into a wall:

        >>> from jaxcell import examples, record
        >>> path = examples.folder() / "run.rrd"
        >>> with record.RobotRecording(path, [record.RecordedRobot()]) as recording:
        ...     recording.event("observation", {"seconds": 1.0, "observation": 1})
        >>> path.exists()
        True
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        robots: Sequence[RecordedRobot],
        *,
        cells: CellSpace | None = None,
        filter: Filter | Policy | None = None,
        belief: Belief | None = None,
        filter_of_cells: bool = True,
        viewer: str | None = None,
        spec: Mapping[str, Any] | None = None,
    ) -> None:
        """**Arguments:**

        - `path`: the file to write or replace; its name ends in `.rrd`.
        - `robots`: the robots.
        - `cells`: the cell space of their map, or `None`.
        - `filter`: the localization filter or policy of the robot, or `None`.
        - `belief`: the belief of the robot, or `None`.
        - `filter_of_cells`: `True` if the filter or the belief is for `cells`; then the map shows
            where the robot may be.
        - `viewer`: a viewer that shows the run; see `jaxcell.record.viewer.viewer_sink`.
        - `spec`: the parameters, which the text shows.

        **Raises:** `ValueError` if there are no robots, if the name or the viewer is invalid, or if
        `filter` has more or fewer cells; `OSError` if the folder is missing or no viewer answers.
        """
        path = Path(path)
        check_name(path)
        if not path.parent.is_dir():
            raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
        if not robots:
            raise ValueError("robots: expected one or more, got none")
        # The cell space of the filter or belief.
        known = cells if filter_of_cells else None
        self._of_filter = None if filter is None else known
        if filter is not None and known is not None and filter.uncertainty[0] != known.size:
            raise ValueError(
                f"filter: it has {filter.uncertainty[0]} cells, but the map has {known.size}"
            )
        if belief is not None and known is not None and belief.hidden.configurations > known.size:
            raise ValueError(
                f"belief: it has {belief.hidden.configurations} cells, but the map has {known.size}"
            )
        self._belief = None if known is None else belief
        self._state = None if belief is None else belief.start()
        self._path, self._cells, self._filter = path, cells, filter
        self._map: CellMap | None = None
        self._spec = dict(spec or {})
        self._robots = [Track(about, robot_color(index)[1]) for index, about in enumerate(robots)]
        self._viewer = None if viewer is None else viewer_sink(viewer)
        self._stream = new_stream("robot")
        # Times are from the clock of the robot, not of this computer.
        self._stream.set_log_time_enabled(False)
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="recording", daemon=True)

    def __enter__(self) -> "RobotRecording":
        file = rr.FileSink(self._path)
        self._stream.set_sinks(*([file] if self._viewer is None else [file, self._viewer]))
        self._stream.send_recording_name(recording_name(self._path))
        if self._cells is not None:
            self._map = CellMap(self._stream, self._cells)
        time = rrb.TimePanel(
            timeline="seconds",
            playback_speed=_SPEED,
            play_state="playing" if self._viewer is None else "following",
            state="collapsed",
        )
        self._stream.send_blueprint(fixed(self._layout(), time))
        self._log_styles()
        self._set_time(0.0, 0)
        if self._filter is not None:
            size, color = int(self._filter.uncertainty[0]), int(self._filter.color[0])
            self._log_filter(self._robots[0], 0, size, color)
        self._log_belief()
        for robot in self._robots:
            self._log_estimate(robot, (0.0, 0.0, 0.0))
        self._watcher.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._watcher.join()
        self._follow_all()
        self._stream.disconnect()

    def event(self, name: str, fields: Mapping[str, Any]) -> None:
        """Log an event of the run.

        **Arguments:**

        - `name`: `"observation"`, `"end"`, or another name, which only the text log shows.
        - `fields`: `seconds`, the time of the event; `robot`, the index of the robot, by default 0.
            An observation has `observation`, 0 for a step and 1 for a bump. It may have `estimate`,
            the pose from odometry relative to the start (metres ahead, metres to the left,
            radians), and the `state` of a filter, with its `color` and with its number of possible
            cells, `uncertainty`. An end has `result` and `reason`.
        """
        with self._lock:
            robot = self._robots[fields.get("robot", 0)]
            self._follow(robot)
            if name == "observation":
                robot.observe()
            self._set_time(robot.seconds(fields), robot.observed)
            if name == "observation":
                self._log_observation(robot, fields)
                return
            if name == "end":
                # Repeat the last numbers, so that curves extend to the end.
                for path, value in robot.scalars.items():
                    self._log_scalar(robot, path, value)
            values = [str(fields[key]) for key in fields if key not in ("seconds", "robot")]
            level = "INFO" if fields.get("result") in _DONE else "WARN"
            self._log_line(robot, ": ".join([name, *values]), level)
            localized = fields.get("result") == "localized" and self._of_filter is not None
            if localized and self._map is not None:
                xy = self._map.xy(robot.cells[:MAX_ARROWS])
                half = np.full(xy.shape, self._map.frame)
                self._stream.log("map/candidates", rr.Boxes2D(centers=xy, half_sizes=half))

    def _watch(self) -> None:
        while not self._closing.wait(_LOOK):
            self._follow_all()

    def _follow_all(self) -> None:
        with self._lock:
            for robot in self._robots:
                self._follow(robot)

    def _follow(self, robot: Track) -> None:
        poses, observation = robot.follow()
        if not len(poses):
            return
        name = robot.about.name
        index = [
            rr.TimeColumn("seconds", duration=poses[:, 0]),
            rr.TimeColumn("observation", sequence=observation),
        ]
        heading = np.stack([np.cos(poses[:, 3]), np.sin(poses[:, 3])], axis=1)
        columns = rr.Arrows2D.columns(origins=poses[:, 1:3], vectors=self._length * heading)
        self._stream.send_columns(f"map/robots/{name}", index, columns)
        if robot.about.radius:
            body = rr.Points2D.columns(positions=poses[:, 1:3])
            self._stream.send_columns(f"map/robots/{name}/body", index, body)
        if robot.about.touches:
            places, count = robot.touched(poses[:, 0])
            touches = rr.Points2D.columns(positions=places).partition(count)
            self._stream.send_columns(f"map/robots/{name}/touch", index, touches)
        robot.trail = longer_trail(robot.trail, poses[:, 1:3])
        self._set_time(float(poses[-1, 0]), int(observation[-1]))
        self._stream.log(f"map/trails/{name}", rr.LineStrips2D([robot.trail]))

    def _log_observation(self, robot: Track, fields: Mapping[str, Any]) -> None:
        bumped = int(fields["observation"])
        text = f"observation {robot.observed}: {'bump' if bumped else 'step'}"
        self._log_scalar(robot, f"robot/{robot.about.name}/bumped", bumped)
        if "estimate" in fields:
            self._log_estimate(robot, fields["estimate"])
        if "uncertainty" in fields:
            size = fields["uncertainty"]
            text += f"; it may be in {counted(size, 'cell')}"
            self._log_filter(robot, fields["state"], size, fields["color"])
        if "credible" in fields:
            size, nowhere = fields["credible"], fields["nowhere"]
            text += f"; it is in one of {counted(size, 'cell')} with probability 0.95"
            self._log_scalar(robot, "belief/credible", size)
            self._log_scalar(robot, "belief/nowhere", nowhere)
            if self._belief is not None and self._state is not None:
                self._state = self._belief.observe(self._state, bumped)
                self._log_belief()
        self._log_line(robot, text, "INFO")

    def _log_filter(self, robot: Track, state: int | None, size: int, color: int) -> None:
        """Log a filter's state, `None` if observations refute the map, and its `size` in cells."""
        self._log_scalar(robot, "filter/uncertainty", size)
        self._log_scalar(robot, "filter/color", color)
        if self._filter is None:
            return
        robot.cells = NOWHERE if state is None else self._filter.cells(state)
        if (cells := self._of_filter) is None:
            return
        few = robot.cells if robot.cells.size <= MAX_ARROWS else NOWHERE
        origins, vectors = arrows(cells, few)
        self._stream.log("map/belief", rr.Arrows2D(origins=origins, vectors=vectors))
        picture = on_squares(cells, shades(cells, robot.cells))
        self._stream.log("map/grid/belief", rr.SegmentationImage(picture))

    def _log_belief(self) -> None:
        """Log the belief, if any, as a heat map, and its credible set as arrows if it is small."""
        if self._belief is None or self._state is None or self._cells is None:
            return
        share = self._belief.hidden.by_position(self._state.weight, self._cells.positions)
        picture = on_squares(self._cells, heat(share))
        self._stream.log("map/grid/heat", rr.SegmentationImage(picture))
        known = self._belief.estimate(self._state).cells
        origins, vectors = arrows(self._cells, known if known.size <= _FEW else NOWHERE)
        self._stream.log("map/credible", rr.Arrows2D(origins=origins, vectors=vectors))

    def _log_estimate(self, robot: Track, estimate: Sequence[float]) -> None:
        place = robot.estimated(estimate)[None]
        robot.believed = longer_trail(robot.believed, place)
        path = f"{self._frame(robot)}/estimates/{robot.about.name}"
        self._stream.log(path, rr.Points2D(place))
        self._stream.log(f"{path}/trail", rr.LineStrips2D([robot.believed]))

    def _log_styles(self) -> None:
        """Log the colours and sizes of marks and curves, once per recording."""
        self._stream.log("odometry", rr.Transform3D(scale=[1, -1, 1]), static=True)
        styles: list[tuple[str, Any, Color, float, float]] = []
        if self._of_filter is not None:
            log_belief_style(self._stream, self._of_filter)
            log_shades(self._stream)
            styles.append(("map/candidates", rr.Boxes2D, KNOWN, points(2.5), 30))
        if self._belief is not None:
            log_classes(self._stream, "map/grid/heat", heat_scale().classes)
            styles.append(("map/credible", rr.Arrows2D, KNOWN, points(2.0), 20))
        for robot in self._robots:
            name, color, radius = robot.about.name, robot.color, robot.about.radius
            estimate, line = f"{self._frame(robot)}/estimates/{name}", rr.LineStrips2D
            trail = TRAIL if len(self._robots) == 1 else color
            body, wide = mix(color, (255, 255, 255), 0.6), points(1.5)
            styles += [
                (f"map/robots/{name}", rr.Arrows2D, color, self._length / 7, 18),
                (f"map/trails/{name}", line, trail, wide, 15),
                (estimate, rr.Points2D, _ESTIMATE, points(5.0), 28),
                (f"{estimate}/trail", line, _ESTIMATE, wide, 14),
            ]
            if radius:
                styles.append((f"map/robots/{name}/body", rr.Points2D, body, radius, 17))
            if robot.about.touches is not None:
                touch = f"map/robots/{name}/touch"
                styles.append((touch, rr.Points2D, _TOUCH, points(6.0), 29))
            log_curve_style(self._stream, f"robot/{name}/bumped", color)
        for path, kind, color, radius, order in styles:
            style = kind.from_fields(colors=color, radii=radius, draw_order=order)
            self._stream.log(path, style, static=True)
        curves = {"filter/uncertainty": BELIEF, "filter/color": KNOWN}
        curves |= {"belief/credible": BELIEF, "belief/nowhere": _ESTIMATE}
        for path, color in curves.items():
            log_curve_style(self._stream, path, color)

    def _log_scalar(self, robot: Track, path: str, value: int | float) -> None:
        robot.scalars[path] = value
        self._stream.log(path, rr.Scalars(float(value)))

    def _log_line(self, robot: Track, text: str, level: str) -> None:
        who = f"{robot.about.name}: " if len(self._robots) > 1 else ""
        self._stream.log("log", rr.TextLog(who + text, level=level))

    def _set_time(self, seconds: float, observation: int) -> None:
        """Set the time, on both timelines, of the data that this thread logs next."""
        self._stream.set_time("seconds", duration=float(seconds))
        self._stream.set_time("observation", sequence=int(observation))

    @property
    def _length(self) -> float:
        """The length of the arrow of a robot, in metres."""
        return 0.3 if self._map is None else robot_length(self._map)

    def _frame(self, robot: Track) -> str:
        """Return the parent entity of estimated poses: `map` for a known start, or `odometry`."""
        known = self._cells is not None and robot.about.start is not None
        return "map" if known else "odometry"

    def _layout(self) -> rrb.Container:
        views: list[rrb.View] = []
        if self._map is not None:
            shown = "grid/heat", "credible", "grid/belief", "belief"
            marks = "trails/**", "robots/**", "estimates/**", "candidates"
            views.append(self._map.view("Places on the map", [*shown, *marks]))
        if any(self._frame(robot) == "odometry" for robot in self._robots):
            title = "Places by odometry"
            views.append(rrb.Spatial2DView(origin="odometry", name=title, background=OBSTACLE))
        charts: list[tuple[str, str, float | int | None]] = []
        if self._filter is not None:
            charts.append(("filter/uncertainty", "Cells where it may be", None))
            charts.append(("filter/color", "Colour of the filter", int(self._filter.color.max())))
        if self._belief is not None:
            charts.append(("belief/credible", "Cells of the credible set, 95 %", None))
            charts.append(("belief/nowhere", "Probability of being nowhere", 1.0))
        charts.append(("robot", "Bumps (1) and steps (0)", None))
        curves = [curve_view(path, title, None, most) for path, title, most in charts]
        observed = rrb.TextLogView(origin="log", name="Observations")
        return rrb.Horizontal(
            rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*curves), row_shares=[7, 3]),
            rrb.Vertical(log_text(self._stream, "text", self._text()), observed),
            column_shares=[3, 2],
            name="A run of a robot",
        )

    def _text(self) -> str:
        robots, policy = [robot.about for robot in self._robots], isinstance(self._filter, Policy)
        by = "policy, at each bump and before it turns" if policy else "filter"
        filtered, heated = self._of_filter is not None, self._belief is not None
        marks = {
            "**Arrow and line**: the true pose of the emulated robot, and its trail.": any(
                robot.trace is not None for robot in robots
            ),
            "**Disc**: its body.": any(robot.radius for robot in robots),
            "**Light blue**: the place where a wall touches it.": any(
                robot.touches is not None for robot in robots
            ),
            "**Pink**: its place by the encoders of its wheels.": True,
            f"**Blue**: the cells where it may be, by its {by}; squares if there are more than "
            f"{MAX_ARROWS}.": filtered,
            "**Green**: the cells that are left when it is localized.": filtered,
            "**Colours**: the probability of each position by its belief, from dark (0.001) to "
            "bright.": heated,
            "**Green**: the cells that hold it with probability 0.95, if they are few.": heated,
        }
        listed = "\n".join(f"- {mark}" for mark, drawn in marks.items() if drawn)
        counts = "The timeline `observation` counts its observations."
        parts = ["# A run of a robot", listed, counts, made_with(self._spec, self._cells)]
        return "\n\n".join(filter(None, parts))
