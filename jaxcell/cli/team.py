import dataclasses
import math
from typing import TYPE_CHECKING, Any

from .options import MapOptions, OutputOptions, cell_at, starting
from .terminal import configuration, count_cells, note, status, table


if TYPE_CHECKING:
    from ..bounce import TeamTrajectory
    from ..space import CellSpace


_MOST_LISTED = 8


@dataclasses.dataclass(frozen=True, kw_only=True)
class Team(MapOptions, OutputOptions):
    """Find a joint trajectory of several bouncing robots that covers a map."""

    bounce: tuple[float, ...]
    """Bouncing angles in degrees, counter-clockwise: one for all robots, or one for each."""
    robots: int | None = None
    """Number of robots that start at random, by default 2."""
    starts: tuple[str, ...] = ()
    """Start of each robot, not at random: "x,y,heading" in m and degrees, or a cell."""
    seed: int = 0
    """Seed of the random starts."""
    max_parts: int = 1000
    """Parts that the trajectory may have; each but the first begins with a turn of one robot."""
    part_steps: int | None = None
    """Most steps of a part; by default the number of cells, but no more than 100,000."""

    def run(self) -> int:
        from .. import estimates

        if not self.bounce:
            raise ValueError("--bounce: expected at least one angle in degrees")
        cells = self.cells(lambda e: estimates.moves(e, **self.motion), "a team")
        with starting():
            import numpy as np

            from ..bounce import team_trajectory
        starts = self._cells_of_robots(cells)
        spec = {
            **self.spec(cells),
            "robots": len(starts),
            "bounce_deg": list(self.bounce),
            "starts": starts,
            "max_parts": self.max_parts,
            "part_steps": self.part_steps,
        }
        doing = f"covering {cells.positions:,} positions with {_count(len(starts))}"
        with status(doing) as tell:
            run = team_trajectory(
                cells,
                starts,
                np.radians(self.bounce),
                **self.motion,
                max_parts=self.max_parts,
                part_steps=self.part_steps,
                progress=lambda parts, covered: tell(f"{doing}: {covered:,} in {parts:,} parts"),
            )
        summary = {**spec, **describe(cells, run)}
        if self.out is not None:
            from .. import record

            with status(f"writing {self.out}"):
                self.out.mkdir(parents=True, exist_ok=True)
                record.save_dataset(
                    record.team_dataset(cells, run, spec=spec), self.out / "team.nc"
                )
                record.log_team(self.out / "team.rrd", cells, run, spec=spec)
                self._write_for_robots(cells, run, spec)
        differs = self.finish(
            summary,
            lambda: show(cells, summary),
            lambda verify: verify.compare_team(cells, run, np.radians(self.bounce), **self.motion),
        )
        return 1 if run.uncovered.size else differs

    def _write_for_robots(
        self, cells: "CellSpace", run: "TeamTrajectory", spec: dict[str, Any]
    ) -> None:
        """Writes what `jaxcell robot run` needs."""
        from ..robot.team import member_actions, save_team
        from ..space import free_steps

        assert self.out is not None
        step = spec["step_m"] / cells.cell
        x, y, theta = (each.tolist() for each in cells.centre(run.path[0]))
        bounces = self.bounce * (1 if len(self.bounce) > 1 else len(x))
        save_team(
            self.out / "team.json",
            spec,
            list(zip(x, y, theta, strict=True)),
            [math.radians(bounce) for bounce in bounces],
            member_actions(run.path, run.bumped, free_steps(cells, step, self.collision)),
        )

    def _cells_of_robots(self, cells: "CellSpace") -> list[int]:
        """The starts that were given, or random ones in different positions."""
        if self.starts:
            if self.robots not in (None, len(self.starts)):
                raise ValueError(
                    f"--robots {self.robots}: --starts names {len(self.starts)}; give one of them"
                )
            return [cell_at(cells, start, "--starts") for start in self.starts]
        robots = 2 if self.robots is None else self.robots
        if not 1 <= robots <= cells.positions:
            raise ValueError(
                f"--robots {robots}: expected from 1 to {cells.positions}, one for each position"
            )
        import numpy as np

        random = np.random.default_rng(self.seed)
        positions = random.choice(cells.positions, robots, replace=False)
        directions = random.integers(cells.directions, size=robots)
        return [int(z) for z in directions * cells.positions + positions]


def describe(cells: "CellSpace", run: "TeamTrajectory") -> dict[str, Any]:
    """The numbers that a person or a script wants of a joint trajectory."""
    covered = run.covered.tolist()
    steps = {
        f"steps_to_{percent}_percent": next(
            (t for t, count in enumerate(covered) if 100 * count >= percent * cells.positions), None
        )
        for percent in (50, 90, 100)
    }
    return {
        "outcome": run.outcome.name.lower(),
        "meaning": run.outcome.value,
        "steps": len(run.path) - 1,
        **steps,
        "parts": len(run.parts),
        "bumps": int(run.bumped.sum()),
        "collisions": int(run.collisions.sum()),
        "covered": covered[-1],
        "uncovered": len(run.uncovered),
        "uncovered_positions": run.uncovered.tolist(),
        "ends": run.path[-1].tolist(),
    }


def show(cells: "CellSpace", summary: dict[str, Any]) -> None:
    """Prints a joint trajectory for people."""
    bounces = ", ".join(f"{angle:g}°" for angle in summary["bounce_deg"])
    rows: list[tuple[str, object]] = [
        ("cells of one robot", count_cells(cells)),
        ("parts", summary["parts"]),
        ("steps", summary["steps"]),
    ]
    for percent in (50, 90, 100):
        steps = summary[f"steps_to_{percent}_percent"]
        rows.append((f"steps to cover {percent} %", "-" if steps is None else f"{steps:,}"))
    rows += [
        ("bumps", summary["bumps"]),
        ("collisions of two robots", summary["collisions"]),
        ("covered", f"{summary['covered']:,} of {cells.positions:,} positions"),
        ("it ends since", summary["meaning"]),
    ]
    if summary["uncovered"]:
        listed = summary["uncovered_positions"][:_MOST_LISTED]
        places = [f"({x:g} m, {y:g} m)" for x, y, _ in map(cells.centre, listed)]
        more = summary["uncovered"] - len(listed)
        places += [f"and {more:,} more"] if more else []
        rows.append((f"{summary['uncovered']:,} stay uncovered", "\n".join(places)))
    table(
        f"{summary['name'] or summary['map']}: {_count(summary['robots'])}, bounce {bounces}, "
        f"{summary['collision']} collision",
        ("quantity", "value"),
        rows,
    )
    robots = zip(summary["starts"], summary["ends"], strict=True)
    table(
        "The robots",
        ("robot", "starts at", "ends at"),
        [(i, configuration(cells, a), configuration(cells, b)) for i, (a, b) in enumerate(robots)],
    )
    if 2 * summary["robot_radius_m"] > cells.cell:
        note("Robots wider than a cell count as meeting only where their centres do.")


def _count(robots: int) -> str:
    return f"{robots} robot{'s' if robots > 1 else ''}"
