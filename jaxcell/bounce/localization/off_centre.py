"""Robots that start off the centres of cells, and how often a filter fails to locate them.

The filter assumes a robot at the centre of a cell. A robot that starts off the centre makes the
same steps of whole cells. So it stays off the centre, and may bump in cells where the filter
expects no bump.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ...automata import Filter, Policy
from ...space import CELL_BY_CELL, CellSpace, Motion
from ...space.cells import free_space_in_cells
from ...space.occupancy import TOLERANCE
from ...space.segments import displacement
from ...space.strides import stride_legs
from ..joint_image import squares_of


STARTS = 1_000
OBSERVATIONS = 60


class Shares(NamedTuple):
    """The shares of robots that a filter or a policy fails to locate."""

    lost: float
    "Share of the robots that make an observation that the filter excludes."
    wrong: float
    "Share of the robots that are not lost, but whose cell is not among the possible cells."


@dataclasses.dataclass(eq=False)
class OffCentre:
    """Robots at any point of their cells, whose steps are whole numbers of cells."""

    cells: CellSpace
    motion: Motion
    free: shapely.Geometry
    "The free space in cells, enlarged by their tolerance, so that a step may graze a corner."
    step: Float[np.ndarray, "directions 2"]
    "The displacement by a step in each direction, in cells."
    path: Float[np.ndarray, "directions corners 2"]
    "The corners of the path of a step in each direction, in cells from its start."
    offset: Float[np.ndarray, "robots 2"]
    "The offset of each robot from the lower left corner of its square, from 0 to 1."
    square: Int[np.ndarray, "robots 2"]
    "The column and the row of the square of each robot."
    direction: Int[np.ndarray, "robots"]

    @classmethod
    def drawn(
        cls,
        cells: CellSpace,
        count: int,
        seed: int,
        *,
        motion: Motion = CELL_BY_CELL,
        walker: bool = False,
    ) -> "OffCentre":
        """Draw robots uniformly over the free cells, at any point in the square of their cell.

        Points in obstacles are drawn again. If `walker` is true, each step has the two stretches of
        [`walker_path`][]; otherwise it is straight.
        """
        length = motion.in_cells(cells.cell)
        steps = np.array(
            [displacement(k, cells.directions, length) for k in range(cells.directions)]
        )
        rng = np.random.default_rng(seed)
        path = walker_path(cells, motion) if walker else np.stack([0 * steps, steps], axis=1)
        free = free_space_in_cells(cells).buffer(TOLERANCE, join_style="mitre")
        shapely.prepare(free)
        robots = cls(cells, motion, free, steps, path, *_draw(cells, count, rng))
        while (inside := ~robots._is_free(robots.offset + robots.square)).any():
            again = _draw(cells, int(inside.sum()), rng)
            robots.offset[inside], robots.square[inside], robots.direction[inside] = again
        return robots

    @property
    def cell(self) -> Int[np.ndarray, "robots"]:
        """The cell of each robot; -1 if its square is not free."""
        position = self.cells.position_of_square[*self.square.T[::-1]]
        return np.where(position < 0, -1, self.direction * self.cells.positions + position)

    def advance(self) -> Bool[np.ndarray, "robots"]:
        """Move each robot by a step unless a wall blocks it; return a mask of the bumps."""
        step = self.step[self.direction]
        point = self.offset + self.square
        # The step leads from the centre of a cell into the cell where the robot is next.
        square = self.square + np.floor(np.round(step + 0.5, 9)).astype(int)
        able = self._is_free(self.offset + square)
        paths = point[:, None] + self.path[self.direction]
        able &= shapely.covers(self.free, self.motion.rule.part(paths))
        self.square = np.where(able[:, None], square, self.square)
        return ~able

    def turn(self, shift: Int[np.ndarray, "robots"]) -> None:
        """Turn each robot to the left by a number of directions."""
        self.direction = (self.direction + shift) % self.cells.directions

    def _is_free(self, points: Float[np.ndarray, "robots 2"]) -> Bool[np.ndarray, "robots"]:
        return np.asarray(shapely.contains_xy(self.free, points))


def walker_path(cells: CellSpace, motion: Motion) -> Float[np.ndarray, "directions 3 2"]:
    """Compute the path of a robot that drives a step in two straight stretches, for each direction.

    The stretches of [`jaxcell.space.stride_legs`][] lead from the centre of a cell to that of
    another. The path is its start and the ends of both stretches, in cells relative to the start.
    """
    first, turn, rest = stride_legs(cells.directions, 1.0, motion.in_cells(cells.cell)).T
    heading = 2 * np.pi * np.arange(cells.directions) / cells.directions
    begin = first * np.exp(1j * heading)
    path = np.stack([0 * begin, begin, begin + rest * np.exp(1j * (heading + turn))], axis=1)
    return np.stack([path.real, path.imag], axis=-1)


def filter_shares(
    filter: Filter,
    cells: CellSpace,
    shift: int,
    motion: Motion = CELL_BY_CELL,
    *,
    walker: bool = False,
) -> Shares:
    """Measure how often a filter fails to locate robots that start anywhere in the cells.

    Robots turn by `shift` directions at a bump, and `walker` is as in [`OffCentre.drawn`][].
    """
    robots = OffCentre.drawn(cells, STARTS, 0, motion=motion, walker=walker)
    transition = filter.with_trap().transition
    state = np.zeros(STARTS, np.int64)
    for _ in range(OBSERVATIONS):
        bumped = robots.advance()
        robots.turn(shift * bumped)
        state = transition[state, bumped.astype(int)]
    lost = state == len(transition) - 1
    return _shares(filter, state, robots.cell, lost)


def policy_shares(
    policy: Policy, cells: CellSpace, shifts: Int[np.ndarray, "angles"], motion: Motion
) -> Shares:
    """Measure how often a policy fails to locate robots that start anywhere in the cells.

    `shifts` are the angles as numbers of directions. The location of a robot is wrong if its cell
    at its last bump is not among the cells that the policy considers possible at this bump.
    """
    robots = OffCentre.drawn(cells, STARTS, 0, motion=motion)
    owner = np.repeat(np.arange(policy.turn.size), np.diff(policy.first))
    longest = np.zeros(policy.turn.size, np.int64)
    np.maximum.at(longest, owner, policy.steps)
    ends = np.diff(policy.first) == 0

    state, steps, cell = np.zeros((3, STARTS), np.int64)
    lost = np.zeros(STARTS, bool)
    for _ in range(OBSERVATIONS):
        bumped = robots.advance()
        runs = ~lost & ~ends[state]
        after = policy.next_states(state, steps)
        lost |= runs & np.where(bumped, after < 0, steps >= longest[state])
        known = runs & bumped & ~lost
        state[known] = after[known]
        cell[known] = robots.cell[known]
        steps = np.where(bumped, 0, steps + 1)
        angle = policy.turn[state]
        robots.turn(np.where(known & (angle >= 0), shifts[angle], 0))
    return _shares(policy, state, cell, lost)


def _shares(
    automaton: Filter | Policy,
    state: Int[np.ndarray, "robots"],
    cell: Int[np.ndarray, "robots"],
    lost: Bool[np.ndarray, "robots"],
) -> Shares:
    left = zip(state[~lost].tolist(), cell[~lost].tolist(), strict=True)
    wrong = sum(place not in automaton.cells(number) for number, place in left)
    return Shares(lost.mean().item(), wrong / lost.size)


def _draw(
    cells: CellSpace, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "robots 2"], Int[np.ndarray, "robots 2"], Int[np.ndarray, "robots"]]:
    """Draw the offset in the square, the square, and the direction of each robot."""
    direction, position = np.divmod(rng.integers(cells.size, size=count), cells.positions)
    return rng.uniform(size=(count, 2)), squares_of(cells).T[position], direction
