"""Robots that start anywhere, and know neither their place nor a compass."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .map_study import MapStudy
from .study import AtLeastOne, Degrees, Length, Say, numbers, refuse


if TYPE_CHECKING:
    from ..bounce import Anywhere, HomeFromAnywhere
    from ..space import Workspace
    from ..walls import Errors, Trial, WallFilter


_ERRORS = {"run": 1.0, "distance": 1.0, "late": 1.0, "displacement": 1.0}
_ERRORS |= dict.fromkeys(("turn", "heading"), math.pi / 180)
_PLANS = 20


@dataclasses.dataclass(frozen=True, kw_only=True)
class AnywhereStudy(MapStudy):
    """A study of a robot on a map that may start anywhere."""

    seed: int = 0
    """Seed of random starts, errors and draws."""
    anywhere: bool = False
    """Put robots down anywhere, and follow them by sets of places on the walls in place of a filter
    of cells: they drive straight until they bump, and count the steps of each run."""
    heading: Literal["known", "unknown"] = "known"
    """Heading of robots that start anywhere: one of the directions (known), or any (unknown)."""
    errors: tuple[str, ...] = ()
    """Bounds of the errors of robots that start anywhere: of a run as a share of it (run=0.02) and
    in metres (distance=0.05), of a turn and of the first heading in degrees (turn=1 heading=2), how
    late a bump is felt and how far from the wall a run begins in metres (late=0.01
    displacement=0.03)."""
    measured: bool = False
    """Let robots that start anywhere measure their runs, in place of counting steps."""
    robots: AtLeastOne = 1000
    """Number of robots that start anywhere."""
    bumps: AtLeastOne = 30
    """Number of bumps of robots that start anywhere."""
    radius: Length | None = None
    """Distance within which a robot that starts anywhere is known, in metres; by default half
    a cell."""
    slices: AtLeastOne = 360
    """Number of slices of headings, where headings are not known exactly."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.anywhere:
            refuse(self, "without anywhere", *_OWN[1:])
            return
        refuse(self, "for robots that start anywhere", *self.of_cells)
        self.bounds()

    @property
    def of_cells(self) -> tuple[str, ...]:
        """The parameters that have no meaning for robots that start anywhere."""
        return ("collision",)

    def spec(self, result: Any) -> dict[str, Any]:
        absent = {self.spec_name(name) for name in (self.of_cells if self.anywhere else _OWN)}
        spec = super().spec(result)
        return {name: spec[name] for name in spec if name not in absent}

    def bounds(self) -> "Errors":
        """Read the bounds of the errors.

        **Raises:** `ValueError` that says which one is wrong.
        """
        from ..walls import Errors

        bounds = {}
        for text in self.errors:
            name, _, value = text.partition("=")
            if name not in _ERRORS:
                raise ValueError(f"errors {text!r}: expected one of {', '.join(_ERRORS)}, with =")
            expected = "a number after ="
            bounds[name] = numbers("errors", value, 1, expected)[0] * _ERRORS[name]
        return Errors(**bounds)

    def needed(self, extent: Any) -> float | int:
        return 0 if self.anywhere else super().needed(extent)

    def filter(self, cells: Any) -> "WallFilter":
        """Find the filter of the walls of a room."""
        from ..walls import WallFilter

        step = cells.cell if self.step is None else self.step
        return WallFilter.of(
            cells.workspace,
            headings=self._known_headings(cells),
            slices=self.slices,
            errors=self.bounds(),
            step=0.0 if self.measured else step,
        )

    def save_task(self, result: "Anywhere", out: Path) -> None:
        """Write the task of a robot, for `jaxcell robot run`."""
        from ..bounce import HomeFromAnywhere
        from ..robot.tasks.anywhere_task import save_anywhere

        cells, filter = result.cells, result.filter
        about = {
            "cell_m": cells.cell,
            "directions": cells.directions,
            "step_m": cells.cell if self.step is None else self.step,
            "bounces_deg": result.bounces_deg.tolist(),
            "headings": result.headings,
            "slices": self.slices,
            "errors": dataclasses.asdict(filter.errors),
            "counted_m": filter.step,
            "known_m": result.radius,
        }
        if isinstance(result, HomeFromAnywhere):
            about |= {"goal_m": result.homing.goal, "goal_radius_m": result.homing.radius}
        assert cells.workspace is not None
        save_anywhere(out / "anywhere.json", cells.workspace, **about)

    def _known_headings(self, cells: Any) -> int | None:
        return cells.directions if self.heading == "known" else None

    def localized_anywhere(
        self, bounces: tuple[Degrees, ...], start: str | None, say: Say
    ) -> "Anywhere":
        """Localize robots that start anywhere."""
        import numpy as np

        from ..bounce import Anywhere

        cells = self.cells()
        say("finding the chords of the room")
        filter = self.filter(cells)
        angles = np.radians(bounces)
        trial = self._drive(cells, filter, angles.tolist(), start, say)
        radius = cells.cell / 2 if self.radius is None else self.radius
        return Anywhere(cells, filter, self._known_headings(cells), angles, radius, trial)

    def home_from_anywhere(
        self,
        bounces: tuple[Degrees, ...],
        goal: tuple[float, float],
        goal_radius: float,
        start: str | None,
        say: Say,
    ) -> "HomeFromAnywhere":
        """Bring robots that start anywhere to a goal."""
        import numpy as np

        from ..bounce import HomeFromAnywhere
        from ..walls import Homing

        cells = self.cells()
        say("finding the chords of the room")
        filter = self.filter(cells)
        angles = np.radians(bounces)
        homing = Homing(filter, goal, goal_radius, tuple(angles.tolist()))
        say("counting bumps to the goal")
        trial = self._drive(cells, filter, angles.tolist(), start, say, homing)
        radius = cells.cell / 2 if self.radius is None else self.radius
        planned = _planned(cells, angles, trial, goal)
        return HomeFromAnywhere(
            cells, filter, self._known_headings(cells), angles, radius, trial, homing, *planned
        )

    def _drive(
        self,
        cells: Any,
        filter: "WallFilter",
        angles: list[float],
        start: str | None,
        say: Say,
        homing: Any = None,
    ) -> "Trial":
        from ..walls import drive_anywhere

        return drive_anywhere(
            cells.workspace,
            filter,
            angles,
            robots=self.robots,
            bumps=self.bumps,
            headings=self._known_headings(cells),
            goal=homing,
            start=None if start is None else pose_at(cells.workspace, start, "start"),
            seed=self.seed,
            say=say,
        )


def pose_at(workspace: "Workspace", text: str, parameter: str) -> tuple[float, float, float]:
    """Read a pose in the free space of a room.

    **Raises:** `ValueError` that names the parameter, for any other place.
    """
    import shapely

    x, y, heading = numbers(parameter, text, 3, '"x,y,heading" in metres and degrees')
    if not workspace.free_space.covers(shapely.Point(x, y)):
        raise ValueError(f"{parameter} {text!r}: ({x:g} m, {y:g} m) is not in the free space")
    return x, y, math.radians(heading)


# The parameters of robots that start anywhere.
_OWN = [name for name in vars(AnywhereStudy)["__annotations__"] if name != "seed"]


def _planned(
    cells: Any, angles: Any, trial: "Trial", goal: tuple[float, float]
) -> tuple[float | None, float | None]:
    """Compute the median bumps and metres of plans of cells that know their starts.

    They are `None` if the cells do not have the angles.
    """
    import numpy as np

    from ..bounce import plan
    from ..space import nearest_cell

    step = 2 * math.pi / cells.directions
    if np.abs(angles / step - np.round(angles / step)).max() > 1e-9:
        return None, None
    end = int(cells.index(*goal, 0.0)) % cells.positions
    plans = []
    for place, heading in zip(trial.start[:_PLANS], trial.heading[:_PLANS, 0], strict=True):
        start = int(nearest_cell(cells, place[0], place[1], heading))
        ways = [
            plan(cells, bounces=angles, start=start, goal=direction * cells.positions + end)
            for direction in range(0, cells.directions, max(1, cells.directions // 8))
        ]
        least = min((way for way in ways if way.found), key=lambda way: way.bumps, default=None)
        plans.append(
            (math.inf, math.inf) if least is None else (least.bumps, least.steps * cells.cell)
        )
    bumps, metres = np.median(plans, axis=0).tolist()
    return bumps, metres
