"""Figures 3.17 and 3.18 of Alam 2018: steps that teams of bouncing robots take to cover two grids.

    python -m experiments.chapter_3.team_coverage

Teams of 2 to 5 robots with bouncing angle 135 deg cover grids of 10 x 10 and 15 x 15 squares, each
from 20 random starts. The source shows its grids as pictures only. Ours are other grids, so the
statements of the source can be compared, but not its numbers.

Two rules end a part of a trajectory: `repeat`, as in Alg. 3.4 (a joint state repeats), and `short`
(the same, or after as many steps as there are positions). Section 6.3 suggests a boustrophedon
sweep for comparison. Rows of free squares that match one to one form a strip, which is swept back
and forth. The next strip is the nearest one along free squares. The path is cut into equal pieces,
one per robot, and each robot goes from its start to an end of its piece, such that the last robot
is done as early as possible. A change of heading counts as a step, as a bump does. These robots
know the map and their positions. They also have the advantage that they never collide, because they
may pass through one another.

The script writes `team_coverage.nc` and `team_coverage.png`.
"""

import itertools
import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy.sparse
import xarray as xr
from scipy.sparse.csgraph import shortest_path

import jaxcell
from jaxcell import bounce
from jaxcell.base.runtime import configure_jax
from jaxcell.space import CellSpace

from ..shared.data import squares
from ..shared.figures import draw_boxes, draw_room, plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import show, tracked


DIRECTIONS = 8
BOUNCE_DEG = 135
ROBOTS = (2, 3, 4, 5)
# More steps than any part here takes until a joint state repeats.
UNLIMITED = 1_000_000
GRIDS = {
    "10 x 10": """
        ..........
        ..........
        .....####.
        .....####.
        ..........
        ..........
        ..##......
        ..##......
        .......#..
        .......#..""",
    "15 x 15": """
        ............#..
        .....###....#..
        .....###.......
        ...............
        ........##.....
        ####....##.....
        ####....##.....
        ........##.....
        ........##.....
        ...............
        ..####.....####
        ..####.....####
        ..####.........
        ...............
        ...............""",
}


def grid(name: str) -> CellSpace:
    return CellSpace.of_grid(squares(GRIDS[name]), DIRECTIONS)


def random_starts(cells: CellSpace, robots: int, runs: int, seed: int) -> np.ndarray:
    """Draw start cells `[runs, robots]`, at different positions in each run."""
    rng = np.random.default_rng([seed, cells.positions, robots])
    positions = [rng.choice(cells.positions, robots, replace=False) for _ in range(runs)]
    return np.array(positions) + cells.positions * rng.integers(DIRECTIONS, size=(runs, robots))


# The boustrophedon sweep.


class Roads(NamedTuple):
    """Shortest paths between all positions."""

    moves: np.ndarray
    "Number of moves, `[start, end]`."
    before: np.ndarray
    "The last position before the end, `[start, end]`."

    @classmethod
    def of(cls, cells: CellSpace) -> "Roads":
        target = np.asarray(bounce.moves(cells).target)
        start = np.broadcast_to(np.arange(cells.positions), target.shape)
        graph = scipy.sparse.coo_array(
            (np.ones(target.size), (start.ravel(), target.ravel())), (cells.positions,) * 2
        )
        return cls(*shortest_path(graph.tocsr(), unweighted=True, return_predecessors=True))

    def way(self, start: int, end: int) -> list[int]:
        """List the positions of the path after `start`, up to `end`."""
        way = []
        while end != start:
            way.append(end)
            end = int(self.before[start, end])
        return way[::-1]


def strips(cells: CellSpace) -> list[list[tuple[int, int]]]:
    """List the strips, each with its rows from the bottom up, as first and last positions."""
    free = np.pad(cells.free, ((0, 0), (1, 1))).astype(np.int8)
    row, first = np.nonzero(np.diff(free, axis=1) == 1)
    last = np.nonzero(np.diff(free, axis=1) == -1)[1] - 1
    above = (row == row[:, None] + 1) & (first <= last[:, None]) & (last >= first[:, None])
    # A run continues in the run above it if neither touches another run of the other's row.
    continued = above & (above.sum(axis=1, keepdims=True) == 1) & (above.sum(axis=0) == 1)
    runs: list[list[int]] = []
    of_run: dict[int, list[int]] = {}
    for run in range(len(row)):
        below = np.flatnonzero(continued[:, run])
        if below.size:
            of_run[run] = of_run[int(below[0])]
        else:
            of_run[run] = []
            runs.append(of_run[run])
        of_run[run].append(run)
    position = cells.position_of_square
    ends = [
        (int(position[r, a]), int(position[r, b])) for r, a, b in zip(row, first, last, strict=True)
    ]
    return [[ends[run] for run in strip] for strip in runs]


def sweep(cells: CellSpace, roads: Roads) -> list[int]:
    """List the positions of a boustrophedon path that begins in the lower left corner."""
    left = strips(cells)
    path = [left[0][0][0]]
    while left:
        # A sweep of a strip may begin at each of its four corners.
        choices = [
            (roads.moves[path[-1], runs[0][side]], i, order, side)
            for i, strip in enumerate(left)
            for order in (1, -1)
            for runs in [strip[::order]]
            for side in (0, 1)
        ]
        _, i, order, side = min(choices)
        for first, last in left.pop(i)[::order]:
            run = range(first, last + 1)[:: 1 - 2 * side]
            path += [*roads.way(path[-1], run[0]), *run[1:]]
            side = 1 - side
    return path


def moves_and_turns(cells: CellSpace, path: list[int]) -> tuple[int, int]:
    """Count the moves and the changes of heading along positions."""
    row, column = np.divmod(cells.square[path], cells.free.shape[1])
    headings = np.stack([np.diff(row), np.diff(column)])
    return len(path) - 1, int((np.diff(headings, axis=1) != 0).any(axis=0).sum())


def team_sweep(
    cells: CellSpace, roads: Roads, path: list[int], start: np.ndarray
) -> tuple[int, int]:
    """Count the moves and turns of the robot that is done last, if the robots share a path."""
    pieces = [piece.tolist() for piece in np.array_split(path, len(start))]

    def cost(robot: int, piece: list[int]) -> tuple[int, int]:
        ways = [
            moves_and_turns(cells, [robot, *roads.way(robot, way[0]), *way[1:]])
            for way in (piece, piece[::-1])
        ]
        return min(ways, key=sum)

    costs = [[cost(int(z) % cells.positions, piece) for piece in pieces] for z in start]
    shares = itertools.permutations(range(len(start)))
    lasts = [max((costs[i][j] for i, j in enumerate(share)), key=sum) for share in shares]
    return min(lasts, key=sum)


def study(runs: int, seed: int) -> xr.Dataset:
    """Simulate all teams by both rules, and their sweeps."""
    rules = ["repeat", "short"]
    shape = (len(GRIDS), len(ROBOTS), runs)
    steps, uncovered, parts, collisions = np.zeros((4, len(rules), *shape), np.int32)
    sweep_moves, sweep_turns = np.zeros((2, *shape), np.int32)
    starts = np.full((*shape, max(ROBOTS)), -1, np.int32)
    pairs = list(itertools.product(enumerate(GRIDS), enumerate(ROBOTS)))
    for (i, name), (j, robots) in tracked(pairs, "teams"):
        cells = grid(name)
        roads = Roads.of(cells)
        path = sweep(cells, roads)
        start = random_starts(cells, robots, runs, seed)
        starts[i, j, :, :robots] = start
        for k, limit in enumerate((UNLIMITED, cells.positions)):
            trajectories = bounce.team_trajectories(
                cells, start, math.radians(BOUNCE_DEG), part_steps=limit
            )
            steps[k, i, j] = [one.steps for one in trajectories]
            uncovered[k, i, j] = [one.uncovered for one in trajectories]
            parts[k, i, j] = [one.parts for one in trajectories]
            collisions[k, i, j] = [one.collisions_in_all for one in trajectories]
        shared = [team_sweep(cells, roads, path, one) for one in start]
        sweep_moves[i, j], sweep_turns[i, j] = np.array(shared).T
    dims = ("environment", "robots", "run")
    ruled = ("rule", *dims)
    return xr.Dataset(
        {
            "steps": (ruled, steps, {"long_name": "steps until the end of the trajectory"}),
            "uncovered": (ruled, uncovered, {"long_name": "positions that remain uncovered"}),
            "parts": (ruled, parts, {"long_name": "parts of the trajectory"}),
            "collisions": (ruled, collisions, {"long_name": "collisions of two robots"}),
            "sweep_moves": (dims, sweep_moves, {"long_name": "moves of the last robot to sweep"}),
            "sweep_turns": (dims, sweep_turns, {"long_name": "turns of the last robot to sweep"}),
            "start": ((*dims, "robot"), starts, {"long_name": "cell of each robot, -1 for none"}),
            "positions": ("environment", [grid(name).positions for name in GRIDS]),
        },
        {"rule": rules, "environment": list(GRIDS), "robots": list(ROBOTS)},
        {
            "title": "Coverage by teams of bouncing robots",
            "source": "jaxcell; after Alam 2018, section 3.5.4, Figures 3.17 and 3.18; own maps",
            "jaxcell_version": jaxcell.__version__,
            "jax_version": jax.__version__,
            "directions": DIRECTIONS,
            "bounce_deg": BOUNCE_DEG,
            "collision": "swept",
            "seed": seed,
            **{f"map {name}": "\n".join(text.split()) for name, text in GRIDS.items()},
        },
    )


def row_of(robots: int, rule: str, steps: np.ndarray, done: np.ndarray) -> dict[str, Any]:
    """Describe the steps of the runs that cover the grid."""
    row = {"robots": str(robots), "rule": rule, "covered": f"{done.sum()} of {done.size}"}
    for name, statistic in {"min": np.min, "median": np.median, "max": np.max}.items():
        row[name] = float(statistic(steps[done])) if done.any() else None
    return row


def report(results: xr.Dataset) -> None:
    """Print a table for each grid, and compare it with section 3.5.4 of the source."""
    swept = results.sweep_moves + results.sweep_turns
    for name in results.environment.values:
        here, rows = results.sel(environment=name), []
        for robots in results.robots.values:
            for rule in results.rule.values:
                one = here.sel(rule=rule, robots=robots)
                row = row_of(robots, str(rule), one.steps.values, (one.uncovered == 0).values)
                row["parts"] = float(np.median(one.parts))
                rows.append(row | {"collisions": float(np.median(one.collisions))})
            steps = swept.sel(environment=name, robots=robots).values
            rows.append(row_of(robots, "sweep", steps, np.ones(steps.size, bool)))
        show(f"{name} squares, {int(here.positions)} free: steps to cover all", rows, ",.0f")

    print("Statements of section 3.5.4, and our medians by the rule `repeat`:")
    for name in results.environment.values:
        middle = results.steps.sel(rule="repeat", environment=name).median("run").values
        falls = "yes" if (np.diff(middle) < 0).all() else "no"
        listed = ", ".join(f"{steps:,.0f}" for steps in middle)
        print(f"- steps decrease with more robots: {falls} in {name} ({listed});")
    last = results.steps.sel(environment="15 x 15", rule="repeat", robots=[4, 5]).values
    print(
        "- in the larger grid 5 robots can take longer than 4: "
        f"of {last[0].size ** 2} pairs of such teams here, in {(last[1] > last[0][:, None]).sum()}."
    )
    ratio = (results.steps.sel(rule="repeat") / swept).median("run").values
    print(
        f"Their steps are {ratio.min():.0f} to {ratio.max():.0f} times those of a boustrophedon "
        "sweep by robots that know where they are."
    )
    print("The source shows its numbers and its grids as pictures only.")


def draw(results: xr.Dataset, path: Path) -> None:
    """Draw each grid with its sweep, and the steps of the teams as boxes."""
    series = {
        "bouncing, parts end at a repetition (Alg. 3.4)": ("repeat", "#9ecae1"),
        "bouncing, parts have at most as many steps as positions": ("short", "#fdd0a2"),
        "boustrophedon sweep with map and position": (None, "#a1d99b"),
    }
    figure, panels = plt.subplots(
        len(GRIDS), 2, figsize=(10, 8), layout="constrained", width_ratios=[1, 2]
    )
    for (plan, boxes), name in zip(panels, results.environment.values, strict=True):
        cells, here = grid(name), results.sel(environment=name)
        draw_room(plan, cells.free)
        row, column = np.divmod(cells.square[sweep(cells, Roads.of(cells))], cells.free.shape[1])
        plan.plot(column + 0.5, row + 0.5, "-o", color="#31a354", linewidth=1, markevery=[0])
        plan.set_title(f"{name} squares, {cells.positions} free")
        handles = []
        for k, (rule, color) in enumerate(series.values()):
            if rule is None:
                steps = list((here.sweep_moves + here.sweep_turns).values)
            else:
                one = here.sel(rule=rule)
                steps = [
                    a[b == 0] for a, b in zip(one.steps.values, one.uncovered.values, strict=True)
                ]
            places = np.arange(len(ROBOTS)) + 0.26 * (k - 1)
            handles.append(draw_boxes(boxes, steps, color, 0.22, positions=places)[0])
        boxes.set(
            xticks=range(len(ROBOTS)),
            xticklabels=ROBOTS,
            xlabel="robots",
            ylabel="steps to cover every free square",
            yscale="log",
        )
        boxes.grid(axis="y", alpha=0.3)
    figure.legend(handles, series, loc="outside lower center", fontsize=9)
    figure.suptitle(
        f"Bouncing angle {BOUNCE_DEG}°, {DIRECTIONS} directions, "
        f"{results.sizes['run']} random starts of each team"
    )
    save(figure, path)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_3/team_coverage", seed=0)
    parser.add_argument("--runs", type=at_least(2), default=20, help="random starts of each team")
    options = read_options(parser)

    configure_jax()
    began = time.perf_counter()
    results = study(options.runs, options.seed)
    seconds = time.perf_counter() - began
    report(results)
    results.to_netcdf(options.out / "team_coverage.nc")
    draw(results, options.out / "team_coverage.png")
    print(f"{results.steps.size} trajectories in {seconds:.1f} s; data and figure in {options.out}")


if __name__ == "__main__":
    main()
