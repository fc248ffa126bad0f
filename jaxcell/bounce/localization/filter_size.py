import numpy as np
from jaxtyping import Int, UInt64

from ...space.copies import copies
from ..wall_tables import Walls


# All candidates of a robot that knows its heading have the same heading. After a bump they stand at
# walls, and each runs to its next wall. The candidates that are still running after `t` steps make
# one state of the filter, until all have bumped. So a state consists of the walls ahead, the
# differences of their distances from the farthest distance, and that distance. The first two stay
# the same until the next candidate bumps, and only the range of the third counts.


def heading_filter_sizes(
    walls: Walls, shift: Int[np.ndarray, "angles"]
) -> Int[np.ndarray, "grids angles"]:
    """Count the states of the filter of a robot that knows its heading but not its place.

    The robot starts in any free square, in direction 0, with a bump sensor and a clock. The states
    are the sets of cells that are possible after its observations; the set at the start counts, and
    the empty set does not. They are those of [`jaxcell.automata.subset_construction`][], but are
    found from bump to bump instead of cell by cell.

    Sets are distinguished by hashes of 64 bits. The probability that two of a million states have
    equal hashes is 3e-8.

    **Arguments:** the walls of grids, and the turns at bumps as numbers of directions. **Returns:**
    the number of states for each grid and turn.

    An open room of two rows of three squares, with turns by 90 and by 180 degrees:

        >>> import numpy as np
        >>> from jaxcell import bounce
        >>> walls = bounce.walls(np.ones((1, 2, 3), bool), directions=4)
        >>> bounce.heading_filter_sizes(walls, np.array([1, 2])).tolist()
        [[14, 8]]
    """
    sizes = [_sizes(walls, grid, shift) for grid in range(len(walls.count))]
    return np.array(sizes, np.int64).reshape(len(walls.count), shift.size)


def _sizes(walls: Walls, grid: int, shift: Int[np.ndarray, "angles"]) -> Int[np.ndarray, "angles"]:
    after, length, behind = walls.next[grid], walls.length[grid], walls.behind[grid]
    directions, slots = walls.way.size, walls.slots
    order = directions // np.gcd(shift, directions)
    first = np.cumsum(order * slots) - order * slots
    # For each angle, heading and wall: the longest run of a single candidate to it, and whether a
    # candidate has bumped there.
    farthest = np.full(int((order * slots).sum()), -1, np.int32)
    bumped = np.zeros(farthest.size, bool)

    live = np.maximum(0, behind[walls.way[0]] + 1)
    slot, run = copies(live)
    angle_of_set = np.arange(shift.size)
    member = np.repeat(angle_of_set, slot.size), *(np.tile(x, shift.size) for x in (slot, run))
    # Angle, wall ahead and length of the run of single candidates.
    alone, place, run_alone = np.empty((3, 0), np.int64)
    seen: set[int] = set()
    # The key, the angle, and the least and the largest distance of the farthest wall.
    chains: list[tuple[np.ndarray, ...]] = []
    bumps = 0
    while angle_of_set.size or alone.size:
        way, turned = (walls.way[(n * shift) % directions] for n in (bumps, bumps + 1))
        row = first + bumps % order * slots
        np.maximum.at(farthest, row[alone] + place, run_alone)
        new_angle, new_slot = alone, place
        groups = None
        if angle_of_set.size:
            groups = _Groups(angle_of_set, *member)
            one = groups.size_so_far == 1
            at = row[groups.angle[one]] + groups.slot[groups.end[one]]
            np.maximum.at(farthest, at, groups.most[one])
            salt = _salt(groups.angle, bumps, order, directions)
            more = ~one
            chains.append(
                tuple(x[more] for x in (groups.key + salt, groups.angle, groups.least, groups.most))
            )
            one = groups.size == 1
            new_angle = np.append(new_angle, groups.angle[one])
            new_slot = np.append(new_slot, groups.slot[groups.end[one]])

        here = row[new_angle] + new_slot
        _, which = np.unique(here, return_index=True)
        which = which[~bumped[here[which]]]
        bumped[here[which]] = True
        alone, place = new_angle[which], new_slot[which]
        turn = way[alone], turned[alone], place
        place, run_alone = after[turn].astype(np.int64), length[turn]

        bumps += 1
        if groups is not None:
            angle_of_set, number, at = groups.next_sets(seen, bumps, order, directions)
            turn = way[angle_of_set[number]], turned[angle_of_set[number]], at
            member = number, after[turn].astype(np.int64), length[turn].astype(np.int64)

    total = np.append(0, np.cumsum(farthest + 1, dtype=np.int64))
    states = total[first + order * slots] - total[first]
    key, angle, least, most = (np.concatenate(x) for x in zip(*chains, strict=True))
    if key.size:
        by_key = np.argsort(key)
        start = np.flatnonzero(np.diff(key[by_key], prepend=~key[by_key[:1]]) != 0)
        lengths = np.maximum.reduceat(most[by_key], start) - least[by_key[start]] + 1
        states += np.bincount(angle[by_key[start]], lengths, shift.size).astype(np.int64)
    return states


class _Groups:
    """The possible cells of each set, divided into groups that bump at the same time.

    A possible cell, a *candidate*, is stored as the wall ahead of it and the length of the run to
    this wall. Candidates are sorted by set, then by the length of their runs, longest first.
    """

    def __init__(
        self,
        angle_of_set: Int[np.ndarray, "sets"],
        number: Int[np.ndarray, "members"],
        slot: Int[np.ndarray, "members"],
        run: Int[np.ndarray, "members"],
    ):
        packed = (number << 32) | (0xFFFF - run << 16) | slot
        packed.sort()
        slot, run, number = packed & 0xFFFF, 0xFFFF - (packed >> 16 & 0xFFFF), packed >> 32
        self.slot = slot
        last = np.append(packed[1:] >> 16 != packed[:-1] >> 16, True)
        self.end = np.flatnonzero(last)
        "The last member of each group."
        self.size = np.diff(self.end, prepend=-1)
        of_group = number[self.end]
        self.angle = angle_of_set[of_group]
        set_start = np.searchsorted(number, np.arange(angle_of_set.size))
        longest = run[set_start]
        later = longest[number] - run
        words = np.cumsum(_mix(slot | later << 16))
        before = np.append(np.zeros(1, np.uint64), words)[set_start]
        self.key = words[self.end] - before[of_group]
        "A hash of the walls ahead of the members up to this group, and of their distances."
        self.size_so_far = self.end - set_start[of_group] + 1
        self.least = later[self.end]
        last_of_set = np.append(of_group[1:] != of_group[:-1], True)
        next_least = np.append(self.least[1:], 0) - 1
        self.most = np.where(last_of_set, longest[of_group], next_least)

    def next_sets(
        self, seen: set[int], bumps: int, order: Int[np.ndarray, "angles"], directions: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Collect the new sets: the groups of two or more candidates whose hash is not in `seen`.

        **Returns:** the angle of each set; for each candidate, the number of its set and its wall.
        """
        many = np.flatnonzero(self.size > 1)
        start = self.end - self.size + 1
        words = np.append(np.zeros(1, np.uint64), np.cumsum(_mix(self.slot)))
        angle = self.angle[many]
        key = words[self.end[many] + 1] - words[start[many]]
        key += _salt(angle, bumps, order, directions)
        fresh = []
        for i, one in enumerate(key.tolist()):
            if one not in seen:
                seen.add(one)
                fresh.append(i)
        many = many[fresh]
        size = self.size[many]
        number, within = copies(size)
        return self.angle[many], number, self.slot[start[many][number] + within]


def _salt(
    angle: Int[np.ndarray, "_"], bumps: int, order: Int[np.ndarray, "angles"], directions: int
) -> UInt64[np.ndarray, "_"]:
    """Hash the angle of each set and its heading, which depends on `bumps` modulo `order`."""
    return _mix(1 << 40 | angle * directions + (bumps % order)[angle])


def _mix(x: Int[np.ndarray, "_"]) -> UInt64[np.ndarray, "_"]:
    """Hash numbers to 64 bits, as SplitMix64 does."""
    z = (x.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
