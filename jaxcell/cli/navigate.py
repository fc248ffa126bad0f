import dataclasses
import math
from itertools import groupby
from typing import TYPE_CHECKING, Any

from .options import MapOptions, OutputOptions, cell_at, starting
from .terminal import configuration, count_cells, status, table


if TYPE_CHECKING:
    from ..bounce import Plan
    from ..space import CellSpace


_MOST_LISTED = 30


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigate(MapOptions, OutputOptions):
    """Plan the way of a bouncing robot that chooses an angle at each bump."""

    bounces: tuple[float, ...]
    """Bouncing angles to choose from, in degrees, counter-clockwise."""
    start: str
    """Where the robot is: "x,y,heading" in m and degrees, or a cell."""
    goal: str
    """Where it is to be, as for the start."""
    keep: float = 1.0
    """What a step costs, and a bump with the same angle as the bump before."""
    change: float = 100.0
    """What a bump with another angle costs."""

    def run(self) -> int:
        from .. import estimates

        cells = self.cells(lambda e: estimates.plans(e, **self.motion), "a plan")
        with starting():
            import numpy as np

            from ..bounce import plan
        start, goal = cell_at(cells, self.start, "--start"), cell_at(cells, self.goal, "--goal")
        weights: dict[str, Any] = {"keep": _whole(self.keep), "change": _whole(self.change)}
        with status(f"planning among {cells.size:,} cells"):
            bounces = np.radians(self.bounces)
            found = plan(cells, bounces, start, goal, **weights, **self.motion)
        spec = {**self.spec(cells), "bounces_deg": list(self.bounces), **weights}
        summary = {**spec, **describe(found)}
        if self.out is not None:
            from .. import record

            with status(f"writing {self.out}"):
                self.out.mkdir(parents=True, exist_ok=True)
                dataset = record.navigation_dataset(cells, found, spec=spec)
                record.save_dataset(dataset, self.out / "navigation.nc")
                record.log_navigation(self.out / "navigation.rrd", cells, found, spec=spec)
        differs = self.finish(
            summary,
            lambda: show(cells, summary),
            lambda verify: verify.compare_plan(cells, found, bounces, **weights, **self.motion),
        )
        return differs if found.found else 1


def _whole(number: float) -> int | float:
    """A whole number where it is one: plans of whole costs cost whole numbers."""
    return int(number) if math.isfinite(number) and number == int(number) else number


def describe(found: "Plan") -> dict[str, Any]:
    """The numbers that a person or a script wants of a plan."""
    return {
        "start": found.start,
        "goal": found.goal,
        "found": found.found,
        "cost": found.cost,
        "steps": int((found.actions == 0).sum()),
        "bumps": found.bumps.size,
        "angles_used": found.angles_used,
        "changes": found.changes,
        "actions_deg": [_degrees(action) for action in found.actions.tolist()],
        "visited": found.cells.tolist(),
        "cells_that_reach_the_goal": int(found.reaching.sum()),
    }


def _degrees(angle: float) -> int | float:
    return _whole(round(math.degrees(angle), 9))


def show(cells: "CellSpace", summary: dict[str, Any]) -> None:
    """Prints a plan for people."""
    bounces = ", ".join(f"{angle:g}°" for angle in summary["bounces_deg"])
    reaching = summary["cells_that_reach_the_goal"]
    rows: list[tuple[str, object]] = [
        ("cells", count_cells(cells)),
        ("from", configuration(cells, summary["start"])),
        ("to", configuration(cells, summary["goal"])),
        ("cost", summary["cost"] if summary["found"] else "there is no path"),
    ]
    if summary["found"]:
        rows += [
            ("steps", summary["steps"]),
            ("bumps", summary["bumps"]),
            ("angles used", summary["angles_used"]),
            ("changes of the angle", summary["changes"]),
        ]
    rows.append(("cells that can reach the goal", f"{reaching:,} ({reaching / cells.size:.1%})"))
    table(
        f"{summary['name'] or summary['map']}: bounces {bounces}, keep {summary['keep']:g}, "
        f"change {summary['change']:g}",
        ("quantity", "value"),
        rows,
    )
    if not summary["actions_deg"]:
        return
    listed, at = [], 0
    for action, same in groupby(summary["actions_deg"]):
        count = len(list(same))
        here = configuration(cells, summary["visited"][at])
        if action == 0:
            listed.append((here, f"forward, {count} {'step' if count == 1 else 'steps'}"))
        else:
            times = "" if count == 1 else f", {count} times"
            listed.append((here, f"bump: turn {action:g}°{times}"))
        at += count
    more = len(listed) - _MOST_LISTED
    listed = listed[:_MOST_LISTED] + ([("...", f"and {more} more")] if more > 0 else [])
    listed.append((configuration(cells, summary["goal"]), "the goal"))
    table("The plan", ("in cell", "action"), listed)
