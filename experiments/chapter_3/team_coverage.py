"""Figures 3.17 and 3.18 of Alam 2018: steps that teams of bouncing robots take to cover two grids.

    python -m experiments.chapter_3.team_coverage

Teams of 2 to 5 robots with bouncing angle 135 deg in grids of 10 x 10 and 15 x 15 squares, each
team from 20 random starts. The source shows its grids as pictures only; ours are of our own
design, so that numbers cannot be compared with its figures, but what it says of them can.

Two rules for the end of a part of a trajectory stand side by side: `repeat`, as in Alg. 3.4 (when
the robots have been in a joint state before), and `short` (then, or after as many steps as there
are positions). Beside both stands the yardstick that section 6.3 asks for, a boustrophedon sweep:
runs of free squares in neighbouring rows that match one to one make a strip, which is swept to and
fro; the next strip is the one nearest by way of free squares. The path is cut into as many equal
pieces as there are robots, and each goes from its start to one end of a piece, so that the last
one is done as early as possible. A change of heading counts as a step, as a bump does. These robots
know the map and where they are, and theirs is the advantage that they never collide: their ways are
timed as if they could pass one another.

Writes `team_coverage.nc` and `team_coverage.png`.
"""

import itertools
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
import scipy.sparse
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.sparse.csgraph import shortest_path

import jaxcell
from jaxcell import bounce
from jaxcell.base.runtime import configure_jax
from jaxcell.space import CellSpace

from ..shared.options import at_least, experiment_parser, read_options


if TYPE_CHECKING:
    import xarray as xr

DIRECTIONS = 8
BOUNCE_DEG = 135
ROBOTS = (2, 3, 4, 5)
# No part here takes this many steps until a joint state repeats.
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
    rows = GRIDS[name].split()[::-1]
    return CellSpace.of_grid(
        np.array([[square == "." for square in row] for row in rows]), DIRECTIONS
    )


def random_starts(cells: CellSpace, robots: int, runs: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng([seed, cells.positions, robots])
    positions = [rng.choice(cells.positions, robots, replace=False) for _ in range(runs)]
    return np.array(positions) + cells.positions * rng.integers(DIRECTIONS, size=(runs, robots))


# The yardstick.


class Roads(NamedTuple):
    """Ways of fewest moves between all positions."""

    moves: np.ndarray
    "Number of moves from one position to another."
    before: np.ndarray
    "The position before the last, on the way from one position to another."

    @classmethod
    def of(cls, cells: CellSpace) -> "Roads":
        target = np.asarray(bounce.moves(cells).target)
        start = np.broadcast_to(np.arange(cells.positions), target.shape)
        graph = scipy.sparse.coo_array(
            (np.ones(target.size), (start.ravel(), target.ravel())), (cells.positions,) * 2
        )
        return cls(*shortest_path(graph.tocsr(), unweighted=True, return_predecessors=True))

    def way(self, start: int, end: int) -> list[int]:
        """The positions after `start`, to `end`."""
        way = []
        while end != start:
            way.append(end)
            end = int(self.before[start, end])
        return way[::-1]


def strips(cells: CellSpace) -> list[list[tuple[int, int]]]:
    """The runs of free squares of each strip, as first and last positions, from the bottom up."""
    free = np.pad(cells.free, ((0, 0), (1, 1))).astype(np.int8)
    row, first = np.nonzero(np.diff(free, axis=1) == 1)
    last = np.nonzero(np.diff(free, axis=1) == -1)[1] - 1
    above = (row == row[:, None] + 1) & (first <= last[:, None]) & (last >= first[:, None])
    # A run is continued by the one above it where each touches no other run of the other's row.
    continued = above & (above.sum(axis=1, keepdims=True) == 1) & (above.sum(axis=0) == 1)
    found: list[list[int]] = []
    of_run: dict[int, list[int]] = {}
    for run in range(len(row)):
        below = np.flatnonzero(continued[:, run])
        if below.size:
            of_run[run] = of_run[int(below[0])]
        else:
            of_run[run] = []
            found.append(of_run[run])
        of_run[run].append(run)
    position = cells.position_of_square
    ends = [
        (int(position[r, a]), int(position[r, b])) for r, a, b in zip(row, first, last, strict=True)
    ]
    return [[ends[run] for run in strip] for strip in found]


def sweep(cells: CellSpace, roads: Roads) -> list[int]:
    """The positions of one boustrophedon path, from the lower left corner on."""
    left = strips(cells)
    path = [left[0][0][0]]
    while left:
        # A strip can be swept from each of its corners: up or down, from either end.
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
    row, column = np.divmod(cells.square[path], cells.free.shape[1])
    headings = np.stack([np.diff(row), np.diff(column)])
    return len(path) - 1, int((np.diff(headings, axis=1) != 0).any(axis=0).sum())


def team_sweep(
    cells: CellSpace, roads: Roads, path: list[int], start: np.ndarray
) -> tuple[int, int]:
    """Moves and turns of the robot that is done last, when the robots share a path."""
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


# The study.


def study(runs: int, seed: int) -> "xr.Dataset":
    import xarray as xr

    rules = ["repeat", "short"]
    shape = (len(GRIDS), len(ROBOTS), runs)
    steps, uncovered, parts, collisions = np.zeros((4, len(rules), *shape), np.int32)
    sweep_moves, sweep_turns = np.zeros((2, *shape), np.int32)
    starts = np.full((*shape, max(ROBOTS)), -1, np.int32)
    with Console(stderr=True).status("") as shown:
        for (i, name), (j, robots) in itertools.product(enumerate(GRIDS), enumerate(ROBOTS)):
            shown.update(f"{name} squares, {robots} robots ...")
            cells = grid(name)
            roads = Roads.of(cells)
            path = sweep(cells, roads)
            start = random_starts(cells, robots, runs, seed)
            starts[i, j, :, :robots] = start
            for k, limit in enumerate((UNLIMITED, cells.positions)):
                found = bounce.team_trajectories(
                    cells, start, math.radians(BOUNCE_DEG), part_steps=limit
                )
                steps[k, i, j] = [one.steps for one in found]
                uncovered[k, i, j] = [one.uncovered for one in found]
                parts[k, i, j] = [one.parts for one in found]
                collisions[k, i, j] = [one.collisions_in_all for one in found]
            shared = [team_sweep(cells, roads, path, one) for one in start]
            sweep_moves[i, j], sweep_turns[i, j] = np.array(shared).T
    dims = ("environment", "robots", "run")
    ruled = ("rule", *dims)
    return xr.Dataset(
        {
            "steps": (ruled, steps, {"long_name": "steps until all is covered, or none is left"}),
            "uncovered": (ruled, uncovered, {"long_name": "positions that stay uncovered"}),
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


def statistics(steps: np.ndarray) -> list[str]:
    return [f"{f(steps):,.0f}" if steps.size else "-" for f in (np.min, np.median, np.max)]


def report(found: "xr.Dataset") -> None:
    swept = found.sweep_moves + found.sweep_turns
    for name in found.environment.values:
        here = found.sel(environment=name)
        table = Table(
            title=f"{name} squares, {int(here.positions)} free: steps to cover all",
            title_justify="left",
            box=SIMPLE_HEAD,
        )
        table.add_column("robots", justify="right")
        table.add_column("rule")
        for column in ("covered", "min", "median", "max", "parts", "collisions"):
            table.add_column(column, justify="right")
        for robots in found.robots.values:
            for rule in found.rule.values:
                one = here.sel(rule=rule, robots=robots)
                done = (one.uncovered == 0).values
                table.add_row(
                    f"{robots}",
                    rule,
                    f"{done.sum()} of {done.size}",
                    *statistics(one.steps.values[done]),
                    f"{np.median(one.parts):,.0f}",
                    f"{np.median(one.collisions):,.0f}",
                )
            steps = swept.sel(environment=name, robots=robots).values
            table.add_row("", "sweep", f"{steps.size} of {steps.size}", *statistics(steps))
        Console().print(table)

    print("Section 3.5.4 says, and here, by the medians of the rule `repeat`:")
    for name in found.environment.values:
        middle = found.steps.sel(rule="repeat", environment=name).median("run").values
        falls = "yes" if (np.diff(middle) < 0).all() else "no"
        listed = ", ".join(f"{steps:,.0f}" for steps in middle)
        print(f"- steps decrease with more robots: {falls} in {name} ({listed});")
    last = found.steps.sel(environment="15 x 15", rule="repeat", robots=[4, 5]).values
    print(
        "- in the larger grid 5 robots can take longer than 4: "
        f"of {last[0].size ** 2} pairs of such teams here, in {(last[1] > last[0][:, None]).sum()}."
    )
    ratio = (found.steps.sel(rule="repeat") / swept).median("run").values
    print(
        f"Their steps are {ratio.min():.0f} to {ratio.max():.0f} times those of a boustrophedon "
        "sweep by robots that know where they are."
    )
    print("The numbers of the source are in pictures only, and so are its grids.")


def draw(found: "xr.Dataset", path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    series = {
        "bouncing, parts end at a repetition (Alg. 3.4)": ("repeat", "#9ecae1"),
        "bouncing, parts of as many steps as positions": ("short", "#fdd0a2"),
        "boustrophedon sweep with map and position": (None, "#a1d99b"),
    }
    figure, panels = plt.subplots(
        len(GRIDS), 2, figsize=(10, 8), layout="constrained", width_ratios=[1, 2]
    )
    for (plan, boxes), name in zip(panels, found.environment.values, strict=True):
        cells, here = grid(name), found.sel(environment=name)
        plan.imshow(cells.free, origin="lower", cmap="gray", vmin=-0.4, vmax=1.05)
        row, column = np.divmod(cells.square[sweep(cells, Roads.of(cells))], cells.free.shape[1])
        plan.plot(column, row, color="#31a354", linewidth=1)
        plan.plot(column[:1], row[:1], "o", color="#31a354")
        plan.set(xticks=[], yticks=[], title=f"{name} squares, {cells.positions} free")
        handles = []
        for k, (rule, color) in enumerate(series.values()):
            if rule is None:
                steps = list((here.sweep_moves + here.sweep_turns).values)
            else:
                one = here.sel(rule=rule)
                steps = [
                    a[b == 0] for a, b in zip(one.steps.values, one.uncovered.values, strict=True)
                ]
            drawn = boxes.boxplot(
                steps,
                positions=np.arange(len(ROBOTS)) + 0.26 * (k - 1),
                widths=0.22,
                patch_artist=True,
                boxprops={"facecolor": color},
                medianprops={"color": "#d55e00", "linewidth": 2},
                flierprops={"marker": ".", "markersize": 5},
            )
            handles.append(drawn["boxes"][0])
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
        f"{found.sizes['run']} random starts of each team"
    )
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_3/team_coverage", seed=0)
    parser.add_argument("--runs", type=at_least(2), default=20, help="starts of each team")
    options = read_options(parser)

    configure_jax()
    began = time.perf_counter()
    found = study(options.runs, options.seed)
    seconds = time.perf_counter() - began
    report(found)
    found.to_netcdf(options.out / "team_coverage.nc")
    draw(found, options.out / "team_coverage.png")
    print(f"{found.steps.size} trajectories in {seconds:.1f} s; data and figure in {options.out}")


if __name__ == "__main__":
    main()
