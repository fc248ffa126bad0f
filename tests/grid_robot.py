"""Robots in rooms of squares, computed with whole numbers and without the maps of the library.

A robot is in the middle of a square and looks along one of four or eight directions. A step leads
to the next square, or is a bump if that is blocked.
"""

import numpy as np

from jaxcell.automata import Filter, subset_construction
from jaxcell.robot.followers import Follower
from jaxcell.robot.outcome import RunOutcome


AHEAD = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]


def room(seed: int, rows: int = 7, columns: int = 9, blocked: int = 6) -> np.ndarray:
    """Draw a room with blocked squares, as a mask of the free squares."""
    free = np.ones((rows, columns), bool)
    free.ravel()[np.random.default_rng(seed).choice(free.size, blocked, replace=False)] = False
    return free


class GridRobot:
    """A robot in a room that turns by whole numbers of directions."""

    def __init__(self, free: np.ndarray, cell: int, directions: int = 4) -> None:
        self.free = np.pad(free, 1)
        self.squares = [tuple(square) for square in np.argwhere(free).tolist()]
        self.ahead = AHEAD[:: 8 // directions]
        self.direction, position = divmod(cell, len(self.squares))
        self.row, self.column = self.squares[position]
        self.touched = False
        "True after a step from square to square through the corner of a blocked square."

    @property
    def cell(self) -> int:
        position = self.squares.index((self.row, self.column))
        return self.direction * len(self.squares) + position

    def is_free(self, dx: int, dy: int) -> bool:
        return bool(self.free[self.row + dy + 1, self.column + dx + 1])

    def step(self) -> bool:
        dx, dy = self.ahead[self.direction]
        beside = self.is_free(dx, 0), self.is_free(0, dy)
        # Two blocked squares that touch leave no gap.
        if not self.is_free(dx, dy) or not any(beside):
            return True
        self.touched |= not all(beside)
        self.column, self.row = self.column + dx, self.row + dy
        return False

    def turn(self, shift: int) -> None:
        self.direction = (self.direction + shift) % len(self.ahead)

    def drive(self, follower: Follower, shifts: list[int], limit: int = 1_500) -> RunOutcome:
        """Turn at bumps as the follower says, among numbers of directions."""
        while follower.result is None and len(follower.observations) < limit:
            follower.observe(int(self.step()))
            if follower.turn is not None:
                self.turn(shifts[follower.turn])
        return follower.outcome()


def filter_of(free: np.ndarray, shift: int, directions: int = 4) -> Filter:
    """The filter of a robot that turns by a number of directions at each bump."""
    images, bumps = [], []
    for cell in range(directions * int(free.sum())):
        robot = GridRobot(free, cell, directions)
        bumps.append(robot.step())
        robot.turn(shift * bumps[-1])
        images.append(robot.cell)
    return Filter.of(subset_construction(np.int32(images), np.array(bumps)))
