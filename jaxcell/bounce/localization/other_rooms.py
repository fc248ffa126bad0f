"""The share of robots that a filter or a policy localizes although they are in another room.

The rooms are drawn at random, with as many rows and columns as the positions of the map span, and
one to five obstacles. A robot in such a room agrees with the map until an observation cannot occur
there.
"""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float, Int

from ...automata import Filter, Policy
from ...mapping import SimpleMap
from ...space import CELL_BY_CELL, CellSpace, Motion
from ...space.copies import copies
from ...space.maps.random_rooms import random_room
from ..dynamics import bounce_map
from ..plans.roadmap import Roadmap


ROOMS = 8
STARTS = 2_000
MOST_CELLS = 100_000
"The largest number of cells of a room in which robots are simulated."
CONFIRM = (0, 10, 20, 30, 40, 60, 100, 200)
"The numbers of further observations for which the shares are computed."
_MOST_OBSERVATIONS = 1_000


def filter_agreement(
    filter: Filter,
    cells: CellSpace,
    bounce: float,
    motion: Motion = CELL_BY_CELL,
    mapping: Callable[..., SimpleMap] = bounce_map,
) -> Mapping[int, float]:
    """Compute the shares of robots in other rooms that a filter localizes.

    The robots start in all configurations of each room, or in `STARTS` random ones, and turn by
    `bounce` radians at each bump. `mapping` computes the map of a room. **Returns:** for each
    number of observations in `CONFIRM`, the share of the robots for which the filter leaves one
    configuration, or is in a knowledge cycle, and which then agree with the map for that number of
    further observations.
    """
    transition = filter.with_trap().transition
    trap = len(transition) - 1
    known = np.zeros(len(transition), bool)
    known[: filter.color.size] = (filter.uncertainty == 1) | (filter.color > 1)
    agreed = []
    for room, rng in _rooms(cells):
        mapped = mapping(room, bounce, motion=motion)
        image, bumped = np.asarray(mapped.image), np.asarray(mapped.bumped).astype(int)
        cell = _starts(image.size, rng)
        state, count = np.zeros(cell.size, np.int64), np.full(cell.size, -1)
        for _ in range(_MOST_OBSERVATIONS):
            state = transition[state, bumped[cell]]
            cell = image[cell]
            count += (state != trap) & (known[state] | (count >= 0))
            if not np.any((state != trap) & (count < CONFIRM[-1])):
                break
        agreed.append(count)
    return _shares(agreed)


def policy_agreement(
    policy: Policy,
    cells: CellSpace,
    bounces: Float[np.ndarray, "angles"],
    motion: Motion = CELL_BY_CELL,
) -> Mapping[int, float]:
    """Compute the shares of robots in other rooms that a policy localizes.

    The robots turn by `bounces`, in radians; the policy must have the table `onward`. **Returns:**
    the shares as in [`filter_agreement`][].
    """
    assert policy.onward is not None
    agreed = []
    for room, rng in _rooms(cells):
        cell = _starts(room.size, rng)
        roadmap = Roadmap.of(room, bounces, motion=motion)
        count = np.full(cell.size, -1)
        robot, state = np.arange(cell.size), np.zeros(cell.size, np.int64)
        while robot.size:
            state = policy.next_states(state, roadmap.length[cell])
            agrees = state >= 0
            robot, wall, state = robot[agrees], roadmap.wall[cell[agrees]], state[agrees]
            ends = policy.turn[state] < 0
            count[robot[ends]] = 0
            _go_on(policy, roadmap, robot[ends], state[ends], wall[ends], count)
            robot, state, wall = robot[~ends], state[~ends], wall[~ends]
            cell = roadmap.turned[policy.turn[state], wall]
        agreed.append(count)
    return _shares(agreed)


def _go_on(
    policy: Policy,
    roadmap: Roadmap,
    robot: Int[np.ndarray, "robots"],
    state: Int[np.ndarray, "robots"],
    wall: Int[np.ndarray, "robots"],
    count: Int[np.ndarray, "starts"],
) -> None:
    """Count, for robots at a wall, the observations after the end of the policy that agree."""
    onward = policy.onward
    assert onward is not None
    # The entries of `onward` that are possible, one robot after the other.
    which, number = copies(policy.uncertainty[state])
    entry = np.searchsorted(onward.at, policy.members[policy.offsets[state][which] + number])
    while which.size:
        cell = roadmap.turned[onward.turn, wall]
        agrees = onward.steps[entry] == roadmap.length[cell][which]
        agrees &= count[robot[which]] < CONFIRM[-1]
        which, entry = which[agrees], onward.target[entry[agrees]]
        alive = np.unique(which)
        count[robot[alive]] += roadmap.length[cell][alive] + 1
        wall = roadmap.wall[cell]


def _rooms(cells: CellSpace) -> Iterator[tuple[CellSpace, np.random.Generator]]:
    """Draw the rooms, with a generator of the starts in them."""
    rng = np.random.default_rng(0)
    # A drawn map has a frame of walls, which is not a part of the room.
    rows, columns = (int(np.ptp(place)) + 1 for place in np.nonzero(cells.position_of_square >= 0))
    for number in range(ROOMS):
        free = random_room(0, number, columns, rows, 1 + number % 5)
        yield CellSpace.of_grid(free, cells.directions, cell=cells.cell), rng


def _starts(size: int, rng: np.random.Generator) -> Int[np.ndarray, "robots"]:
    return rng.choice(size, min(STARTS, size), replace=False)


def _shares(agreed: list[Int[np.ndarray, "_"]]) -> Mapping[int, float]:
    counts = np.concatenate(agreed)
    return {least: float((counts >= least).mean()) for least in CONFIRM}
