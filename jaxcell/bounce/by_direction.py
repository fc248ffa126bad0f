import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int, Int32

from ..mapping import GroupSummary, GroupTotals, Section, section_groups
from ..mapping.section import bucket
from ..space import CellSpace
from ..space.steps import Steps
from .wall_map import WayWalls


# Cells that are followed to their walls at once.
_AT_ONCE = 2**20


@dataclasses.dataclass(frozen=True, eq=False)
class CellsOfDirection:
    """Where the cells of one direction lead."""

    image: Int32[np.ndarray, "positions"]
    "The image of each cell."
    group: Int32[np.ndarray, "positions"]
    "The periodic group that it reaches, numbered from 0 by their smallest cells."
    step: Int32[np.ndarray, "positions"]
    "Mappings until it is on its periodic group, 0 on it."


@dataclasses.dataclass(frozen=True, eq=False)
class DirectionGroups:
    """The periodic groups of a bouncing angle, known at the bumps.

    What the cells of a direction do follows from its walls, so that the cells of all directions are
    never held at once.
    """

    cells: CellSpace
    steps: Steps
    walls: tuple[WayWalls, ...]
    "The walls of each way."
    shift: int
    "Directions that the robot turns by at a bump."
    first: Int[np.ndarray, "directions"]
    "The first slot of each direction in the section, which lists its walls."
    group: Int[np.ndarray, "slots"]
    lead: Int[np.ndarray, "slots"]
    "What is added to the steps to the wall, as [`jaxcell.mapping.SectionGroups`][] has them."
    period: Int[np.ndarray, "groups"]
    "The period of each group."

    @classmethod
    def of(
        cls, cells: CellSpace, steps: Steps, walls: tuple[WayWalls, ...], shift: int
    ) -> "DirectionGroups":
        """Find the groups of one angle on the section of its bumps."""
        way, positions = steps.way.tolist(), cells.position_of_square.ravel()
        count = [walls[one].square.size for one in way]
        first = np.cumsum(count) - count
        slots = sum(count)
        successor = np.arange(bucket(slots), dtype=np.int32)
        duration, lowest = np.ones((2, successor.size), np.int32)
        returns: dict[tuple[int, int], list[np.ndarray]] = {}
        for direction, here in enumerate(way):
            turned = (direction + shift) % len(way)
            pair = here, way[turned]
            if pair not in returns:
                square, there = walls[here].square, walls[pair[1]]
                at, length = there.ahead(steps.places(int(steps.line[pair[1]]), square))
                # Positions along a run rise or fall throughout.
                least = np.minimum(positions[square], positions[there.square[at]])
                returns[pair] = [one.astype(np.int32) for one in (at, length, least)]
            at, length, least = returns[pair]
            some = slice(first[direction], first[direction] + count[direction])
            successor[some] = first[turned] + at
            duration[some] = 1 + length
            lowest[some] = turned * cells.positions + least
        live = np.arange(successor.size) < slots
        found = section_groups(Section(*map(jnp.asarray, (successor, duration, lowest, live))))
        group, lead, period = map(np.asarray, (found.group, found.lead, found.period))
        numbers = group[:slots], lead[:slots], period[: int(found.count)]
        return cls(cells, steps, walls, shift, first, *numbers)

    def totals(self) -> GroupTotals:
        """The groups in a few numbers."""
        behind = np.concatenate([self.walls[way].behind for way in self.steps.way])
        transient = np.zeros_like(self.period)
        np.maximum.at(transient, self.group, behind + self.lead)
        basin = np.bincount(self.group, behind + 1).astype(np.int64)
        return GroupSummary(np.array(basin.size), self.period, basin, transient).totals()

    def of_cells(self, direction: int) -> CellsOfDirection:
        """The images, groups and steps of the cells of a direction, wall by wall."""
        way = int(self.steps.way[direction])
        walls, hop = self.walls[way], self.steps.hop(way)
        positions = self.cells.position_of_square.ravel()
        turned = (direction + self.shift) % self.cells.directions
        own, around = direction * self.cells.positions, turned * self.cells.positions
        image, group, step = np.empty((3, self.cells.positions), np.int32)
        count = walls.behind + 1
        end = np.cumsum(count)
        cuts = np.unique(np.searchsorted(end, np.arange(0, end[-1], _AT_ONCE)))
        for some in np.split(np.arange(count.size), cuts[1:]):
            wall = np.repeat(some, count[some])
            left = end[wall] - 1 - np.arange(end[some[0]] - count[some[0]], end[some[-1]])
            here = positions[walls.square[wall] - left * hop]
            slot = self.first[direction] + wall
            group[here] = self.group[slot]
            step[here] = np.maximum(0, left + self.lead[slot])
            # At the walls it is another one.
            image[here[:-1]] = own + here[1:]
        bumps = positions[walls.square]
        image[bumps] = around + bumps
        return CellsOfDirection(image, group, step)
