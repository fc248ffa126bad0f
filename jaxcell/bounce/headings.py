import dataclasses
import functools
import math

import numpy as np
from jaxtyping import Bool, Int


@dataclasses.dataclass(frozen=True, eq=False)
class Headings:
    """The directions that a robot takes at its bumps one after the other, in independent cycles.

    Directions that differ by a multiple of `cycles` are those of one cycle. Walls matter to it by
    the ways of its directions only, so that cycles of the same ways, one after the other, have the
    same groups: it is enough to follow the first of them, whose directions are *leading*.
    """

    shift: int
    "Directions that the robot turns by at a bump."
    cycles: int
    "Number of cycles."
    like: Int[np.ndarray, "cycles"]
    "The first cycle that has the same ways as each."
    alike: Int[np.ndarray, "directions"]
    "The leading direction that stands for each direction; itself where it is one."

    @property
    def leading(self) -> Bool[np.ndarray, "directions"]:
        """Which directions lead."""
        return self.alike == np.arange(self.alike.size)

    @classmethod
    def of(cls, way: Int[np.ndarray, "directions"], shift: int) -> "Headings":
        """The cycles of a robot that turns by so many directions.

        **Arguments:**

        - `way`: the way of each direction.
        - `shift`: directions that the robot turns by at a bump.
        """
        return _headings(way.tobytes(), way.dtype.str, shift)

    def spread(
        self, leads: Bool[np.ndarray, "slots"], lowest: Int[np.ndarray, "slots"], positions: int
    ) -> "SpreadGroups":
        """Number the groups of all cycles by their smallest cells.

        **Arguments:**

        - `leads`: whether a slot of the section of the leading directions stands for a group.
        - `lowest`: the smallest cell of that group.
        - `positions`: how many cells a direction has.

        **Returns:** [`SpreadGroups`][].
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
    """The groups of all cycles of headings, when those of the leading directions are known."""

    slot: Int[np.ndarray, "groups"]
    "The slot that stands for each group or the one that it is like, in the order of numbers."
    number: Int[np.ndarray, "groups"]
    "That of what slot `s` stands for, for direction `d`, is `number[begin[d] + place[s]]`."
    begin: Int[np.ndarray, "directions"]
    place: Int[np.ndarray, "slots"]


@functools.lru_cache(maxsize=1024)
def _headings(ways: bytes, kind: str, shift: int) -> Headings:
    way = np.frombuffer(ways, kind)
    cycles = math.gcd(shift, way.size)
    first: dict[bytes, int] = {}
    # The directions of two cycles differ by the same number throughout.
    rows = map(bytes, np.ascontiguousarray(way.reshape(-1, cycles).T))
    like = np.array([first.setdefault(row, cycle) for cycle, row in enumerate(rows)])
    cycle = np.arange(way.size) % cycles
    return Headings(shift, cycles, like, np.arange(way.size) - cycle + like[cycle])
