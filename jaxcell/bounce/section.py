"""The periodic groups of a bouncing robot, found on the section of its bumps."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Int, Int32

from ..mapping import GroupSummary, Section
from ..mapping.section import bucket, section_cycles
from ..space import CellSpace
from .headings import Headings, SpreadGroups
from .runs import Runs


# Between two bumps a robot runs straight, so the cells where it bumps are a section that every
# orbit meets, and every other cell is a known number of steps before one of them, in its own
# direction.


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
class AngleGroups:
    """The periodic groups of one bouncing angle, known at the walls of its leading directions.

    What the cells of a direction do follows from these, so that the cells of all directions need
    not be held at once. [`Headings`][] says which directions lead, and for which others.
    """

    cells: CellSpace
    runs: Runs
    headings: Headings
    first: Int32[np.ndarray, "directions"]
    "The first slot of the leading direction that stands for each."
    wall: Int[np.ndarray, "slots"]
    "The wall in each slot."
    leader: Int32[np.ndarray, "slots"]
    "The slot that stands for the group of each."
    lead: Int32[np.ndarray, "slots"]
    "What is added to the steps to the wall, as [`jaxcell.mapping.SectionGroups`][] has them."
    groups: SpreadGroups
    "Those of all directions."
    period: Int32[np.ndarray, "groups"]

    def summary(self) -> GroupSummary:
        """The periods, basins and longest transients of the groups."""
        behind, slot = self.runs.behind[self.wall], self.groups.slot
        basin = np.bincount(self.leader, behind + 1)[slot].astype(np.int32)
        # Of the type of what is collected: NumPy is slow where types differ.
        transient = np.zeros(self.wall.size, behind.dtype)
        np.maximum.at(transient, self.leader, behind + self.lead)
        longest = transient[slot].astype(np.int32)
        return GroupSummary(np.array(slot.size), self.period, basin, longest)

    def of_cells(self, direction: int) -> CellsOfDirection:
        """The images, groups and steps of the cells of a direction, run by run."""
        runs, positions = self.runs, self.cells.positions
        way = int(runs.steps.way[direction])
        position = self.cells.position_of_square.ravel()
        turned = (direction + self.headings.shift) % self.cells.directions
        slots = self.first[direction] + np.arange(np.diff(runs.begin)[way])
        number = self.groups.number[
            self.groups.begin[direction] + self.groups.place[self.leader[slots]]
        ]
        image, group, step = np.empty((3, positions), np.int32)
        for square, wall, left in runs.followed(way):
            here = position[square]
            group[here] = number[wall]
            step[here] = np.maximum(0, left + self.lead[slots[wall]])
            # At the walls it is another one.
            image[here[:-1]] = direction * positions + here[1:]
        bumps = position[runs.square[runs.of_way(way)]]
        image[bumps] = turned * positions + bumps
        return CellsOfDirection(image, group, step)


_cycles_of_angles = jax.jit(jax.vmap(section_cycles))


def angle_groups(cells: CellSpace, runs: Runs, shifts: Sequence[int]) -> list[AngleGroups]:
    """Find the periodic groups of some bouncing angles.

    **Arguments:**

    - `cells`, `runs`: the cell space and its straight runs.
    - `shifts`: by how many directions the robot turns at a bump.

    **Returns:** the groups of each angle.
    """
    headings = [Headings.of(runs.steps.way, shift) for shift in shifts]
    sections = [runs.of_directions(one.leading) for one in headings]
    slots = bucket(max(wall.size for _, _, wall in sections))
    returns = [
        _returns(cells, runs, *section, one.shift, slots)
        for one, section in zip(headings, sections, strict=True)
    ]
    if len(shifts) == 1:
        cycles = section_cycles(returns[0])
    else:
        cycles = _cycles_of_angles(jax.tree.map(lambda *each: np.stack(each), *returns))
    of_angles = (
        np.asarray(one).reshape(len(shifts), slots)
        for one in (cycles.leader, cycles.lead, cycles.leads, cycles.lowest, cycles.period)
    )
    found = []
    for one, (first, _, wall), *rows in zip(headings, sections, *of_angles, strict=True):
        leader, lead, leads, lowest, period = (row[: wall.size] for row in rows)
        groups = one.spread(leads, lowest, cells.positions)
        first, period = first[one.alike], period[groups.slot]
        found.append(AngleGroups(cells, runs, one, first, wall, leader, lead, groups, period))
    return found


def _returns(
    cells: CellSpace,
    runs: Runs,
    first: Int32[np.ndarray, "directions"],
    direction: Int32[np.ndarray, "walls"],
    wall: Int[np.ndarray, "walls"],
    shift: int,
    slots: int,
) -> Section:
    """The first-return map from bump to bump, filled up to so many slots."""
    # The robot turns, then runs to the next wall.
    turned = (direction + shift) % cells.directions
    way, place = runs.steps.way[turned], runs.place[wall]
    ahead = runs.ahead[way, place]
    # Squares along a run rise or fall throughout, so its smallest cell is at one of the ends.
    least = np.minimum(runs.bump[place], runs.square[runs.begin[way] + ahead])
    own, some = np.arange(slots, dtype=np.int32), slice(wall.size)
    successor, duration, lowest = own.copy(), np.ones_like(own), np.zeros_like(own)
    successor[some] = first[turned] + ahead
    duration[some] += runs.length[way, place]
    lowest[some] = turned * cells.positions + cells.position_of_square.ravel()[least]
    return Section(successor, duration, lowest, own < wall.size)
