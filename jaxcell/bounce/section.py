"""The periodic groups of a bouncing robot, found from the cells where it bumps.

Between two bumps a robot runs straight. So every orbit passes through the cells where it bumps, the
*section*. Every other cell leads straight to a cell of the section, in a known number of steps.
"""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Int, Int32

from ..mapping import GroupSummary, Section
from ..mapping.section import bucket, section_cycles
from ..space import CellSpace
from .headings import Headings, SpreadGroups
from .straight_runs import Runs


@dataclasses.dataclass(frozen=True, eq=False)
class CellsOfDirection:
    """The images and the groups of the cells of one direction."""

    image: Int32[np.ndarray, "positions"]
    group: Int32[np.ndarray, "positions"]
    "The group that each cell reaches; groups are numbered in the order of their smallest cells."
    step: Int32[np.ndarray, "positions"]
    "Number of steps and bumps from each cell to its periodic group; 0 for cells in the group."


@dataclasses.dataclass(frozen=True, eq=False)
class AngleGroups:
    """The periodic groups of one bouncing angle, stored for the walls of leading directions only.

    [`Headings`][] defines the leading directions. Each of their walls has a *slot*, which is its
    index in the arrays. The groups of all cells follow from the groups of the walls, and are
    computed one direction at a time, because those of all cells may not fit in memory.
    """

    cells: CellSpace
    runs: Runs
    headings: Headings
    first: Int32[np.ndarray, "directions"]
    "For each direction, the index of the first slot of the leading direction with the same groups."
    wall: Int[np.ndarray, "slots"]
    "For each slot, the number of its wall in `runs`."
    leader: Int32[np.ndarray, "slots"]
    "For each slot, the slot that represents the group reached from it."
    lead: Int32[np.ndarray, "slots"]
    "Number of steps and bumps from a slot to its group; see [`jaxcell.mapping.SectionCycles`][]."
    groups: SpreadGroups
    "The groups of all directions."
    period: Int32[np.ndarray, "groups"]

    def summary(self) -> GroupSummary:
        """Measure the periods, the basins and the longest transients of the groups."""
        behind, slot = self.runs.behind[self.wall], self.groups.slot
        basin = np.bincount(self.leader, behind + 1)[slot].astype(np.int32)
        # The type is that of `behind`, because NumPy is slow if types differ.
        transient = np.zeros(self.wall.size, behind.dtype)
        np.maximum.at(transient, self.leader, behind + self.lead)
        longest = transient[slot].astype(np.int32)
        return GroupSummary(np.array(slot.size), self.period, basin, longest)

    def of_walls(
        self, direction: int
    ) -> tuple[Int32[np.ndarray, "walls"], Int32[np.ndarray, "walls"]]:
        """Find the group of each wall of a direction, and count the steps and bumps to it."""
        way = self.runs.steps.way[direction]
        slots = self.first[direction] + np.arange(np.diff(self.runs.begin)[way])
        place = self.groups.place[self.leader[slots]]
        return self.groups.number[self.groups.begin[direction] + place], self.lead[slots]

    def of_cells(self, direction: int) -> CellsOfDirection:
        """Find the images, groups and steps of the cells of a direction."""
        runs, positions = self.runs, self.cells.positions
        way = int(runs.steps.way[direction])
        position = self.cells.position_of_square.ravel()
        turned = (direction + self.headings.shift) % self.cells.directions
        number, lead = self.of_walls(direction)
        image, group, step = np.empty((3, positions), np.int32)
        for square, wall, left in runs.followed(way):
            here = position[square]
            group[here] = number[wall]
            step[here] = np.maximum(0, left + lead[wall])
            # The images of walls are replaced below.
            image[here[:-1]] = direction * positions + here[1:]
        bumps = position[runs.square[runs.of_way(way)]]
        image[bumps] = turned * positions + bumps
        return CellsOfDirection(image, group, step)


_cycles_of_angles = jax.jit(jax.vmap(section_cycles))


def angle_groups(cells: CellSpace, runs: Runs, shifts: Sequence[int]) -> list[AngleGroups]:
    """Find the periodic groups of bouncing angles, which are given as numbers of directions."""
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
    fields = (cycles.leader, cycles.lead, cycles.leads, cycles.lowest, cycles.period)
    of_angles = (np.asarray(field).reshape(len(shifts), slots) for field in fields)
    groups = []
    for one, (first, _, wall), *rows in zip(headings, sections, *of_angles, strict=True):
        leader, lead, leads, lowest, period = (row[: wall.size] for row in rows)
        spread = one.spread(leads, lowest, cells.positions)
        first, period = first[one.alike], period[spread.slot]
        groups.append(AngleGroups(cells, runs, one, first, wall, leader, lead, spread, period))
    return groups


def _returns(
    cells: CellSpace,
    runs: Runs,
    first: Int32[np.ndarray, "directions"],
    direction: Int32[np.ndarray, "walls"],
    wall: Int[np.ndarray, "walls"],
    shift: int,
    slots: int,
) -> Section:
    """Build the first-return map of listed walls, padded to `slots` entries.

    [`Runs.of_directions`][] lists the walls; `first`, `direction` and `wall` are its results.
    """
    # The robot turns, then runs to the next wall.
    turned = (direction + shift) % cells.directions
    way, place = runs.steps.way[turned], runs.place[wall]
    ahead = runs.ahead[way, place]
    # Along a run, the numbers of squares only rise or only fall, so its smallest is at an end.
    least = np.minimum(runs.bump[place], runs.square[runs.begin[way] + ahead])
    own, used = np.arange(slots, dtype=np.int32), slice(wall.size)
    successor, duration, lowest = own.copy(), np.ones_like(own), np.zeros_like(own)
    successor[used] = first[turned] + ahead
    duration[used] += runs.length[way, place]
    lowest[used] = turned * cells.positions + cells.position_of_square.ravel()[least]
    return Section(successor, duration, lowest, own < wall.size)
