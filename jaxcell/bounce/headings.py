import dataclasses
import math

import numpy as np
from jaxtyping import Bool, Int


@dataclasses.dataclass(frozen=True, eq=False)
class Headings:
    """The directions that a robot takes at successive bumps, divided into independent cycles.

    The directions of one cycle differ by multiples of `cycles`. Directions with equal steps form a
    class, called a *way*. If cycles have the same ways in the same order, they have the same walls
    and groups, and only the first of them is followed. The directions of this cycle are *leading*.
    """

    shift: int
    "Number of directions by which the robot turns at a bump."
    cycles: int
    like: Int[np.ndarray, "cycles"]
    "For each cycle of headings, the first cycle whose directions have the same steps."
    alike: Int[np.ndarray, "directions"]
    "For each direction, the leading direction that has the same groups."

    @property
    def leading(self) -> Bool[np.ndarray, "directions"]:
        """A mask of the leading directions, whose cycles are followed."""
        return self.alike == np.arange(self.alike.size)

    @classmethod
    def of(cls, way: Int[np.ndarray, "directions"], shift: int) -> "Headings":
        """Find the cycles of a robot that turns by `shift` directions at a bump."""
        cycles = math.gcd(shift, way.size)
        first: dict[bytes, int] = {}
        # Corresponding directions of two cycles differ by the same number.
        rows = map(bytes, np.ascontiguousarray(way.reshape(-1, cycles).T))
        like = np.array([first.setdefault(row, cycle) for cycle, row in enumerate(rows)])
        cycle = np.arange(way.size) % cycles
        return cls(shift, cycles, like, np.arange(way.size) - cycle + like[cycle])

    def spread(
        self, leads: Bool[np.ndarray, "slots"], lowest: Int[np.ndarray, "slots"], positions: int
    ) -> "SpreadGroups":
        """Number the groups of all cycles in the order of their smallest cells.

        A slot is a wall of a leading direction. `leads` is a mask of the slots that represent
        groups, and `lowest[s]` is the smallest cell of the group that slot `s` represents. A
        direction has `positions` cells.
        """
        leaders = np.flatnonzero(leads)
        lowest = lowest[leaders]
        kind = self.like[lowest // positions % self.cycles]
        order = np.argsort(kind, kind="stable")
        first, end = np.searchsorted(kind[order], [self.like, self.like + 1])
        count = end - first
        begin = np.cumsum(count) - count
        cycle = np.repeat(np.arange(self.cycles), count)
        known = order[np.arange(cycle.size) + (first - begin)[cycle]]
        by_cell = np.argsort(lowest[known] + (cycle - self.like[cycle]) * positions)
        number = np.empty(cycle.size, np.int32)
        number[by_cell] = np.arange(cycle.size)
        place = np.zeros(leads.size, np.int32)
        place[leaders[order]] = np.arange(order.size) - first[kind[order]]
        begin = np.tile(begin, self.alike.size // self.cycles)
        return SpreadGroups(leaders[known[by_cell]], number, begin, place)


@dataclasses.dataclass(frozen=True, eq=False)
class SpreadGroups:
    """The groups of all cycles of headings, derived from the groups of the leading directions."""

    slot: Int[np.ndarray, "groups"]
    """For each group, the slot (a wall of a leading direction; see [`Headings`][]) that represents
    it. Groups that differ only by a turn of all their cells have the same slot."""
    number: Int[np.ndarray, "groups"]
    """Numbers of groups, cycle by cycle, from index `begin[d]` for the cycle of direction `d`. In
    this cycle, slot `s` represents the group with the number `number[begin[d] + place[s]]`."""
    begin: Int[np.ndarray, "directions"]
    place: Int[np.ndarray, "slots"]
