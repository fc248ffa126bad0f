import functools
import itertools
import math
from fractions import Fraction

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_rooms import grids

from jaxcell.bounce import TeamOutcome, bounce_map, moves, team_trajectories, team_trajectory
from jaxcell.bounce.joint_image import joint_image, joint_orbits, squares_of
from jaxcell.space import CellSpace, Motion


SPACES = grids(14, (4, 5)).map(lambda free: CellSpace.of_grid(free, 8))
# Few numbers, because each number of robots is compiled.
NUMBERS = st.sampled_from([2, 5])


def states_of(cells, robots, seed, count):
    rng = np.random.default_rng(seed)
    places = [rng.choice(cells.positions, robots, replace=False) for _ in range(count)]
    return np.array(places) + cells.positions * rng.integers(cells.directions, size=(count, robots))


def orbits(cells, shift, states, *, step):
    """Follow joint states for 40 steps; only one length, because each is compiled."""
    arrays = squares_of(cells), np.asarray(shift, np.int32), np.asarray(states, np.int32)
    possible = moves(cells, motion=Motion(step))
    return jax.device_get(joint_orbits(possible, *jax.device_put(arrays), steps=40))


def one_step(cells, shift, state, step=None):
    """Compute the joint image of one joint state."""
    arrays = squares_of(cells), np.asarray(shift, np.int32), np.asarray(state, np.int32)
    return joint_image(moves(cells, motion=Motion(step)), *jax.device_put(arrays))


class Oracle:
    """The joint map and Alg. 3.4 in plain Python, one robot and one pair at a time."""

    def __init__(self, cells, shifts, step):
        self.cells, self.shifts = cells, shifts
        alone = bounce_map(cells, 0.0, motion=Motion(step * cells.cell))
        self.image, self.walled = np.asarray(alone.image).tolist(), np.asarray(alone.bumped)
        # Two robots can only meet at a multiple of the inverse of their relative speed.
        speeds = range(1, 2 * math.ceil(step) + 1)
        self.times = sorted({Fraction(n, d) for d in speeds for n in range(1, d + 1)})
        self.meet = functools.cache(self.meet)

    def square(self, z):
        return divmod(int(self.cells.square[z % self.cells.positions]), self.cells.free.shape[1])

    def meet(self, z, to_z, w, to_w):
        ends = [*zip(*map(self.square, (z, to_z, w, to_w)), strict=True)]
        return any(
            all(a + t * (b - a) == c + t * (d - c) for a, b, c, d in ends) for t in self.times
        )

    def step(self, state):
        robots = range(len(state))
        wish = [self.image[z] for z in state]
        bumped = {i for i in robots if self.walled[state[i]]}
        # One round per robot that may bump, and a last round without changes.
        for _ in range(len(state) + 1):
            collisions = set()
            for i, j in itertools.combinations(robots, 2):
                i_moves, j_moves = ((wish[k] != state[k]) for k in (i, j))
                both = i_moves and j_moves and self.meet(state[i], wish[i], state[j], wish[j])
                into_j = j in bumped and self.meet(state[i], wish[i], state[j], state[j])
                into_i = i in bumped and self.meet(state[i], state[i], state[j], wish[j])
                if both or into_j or into_i:
                    collisions.add((i, j))
                    bumped |= {
                        k for k, found in ((i, both or into_j), (j, both or into_i)) if found
                    }
        size, positions = self.cells.size, self.cells.positions
        image = [
            (z + self.shifts[i] * positions) % size if i in bumped else wish[i]
            for i, z in enumerate(state)
        ]
        involved = {i for pair in collisions for i in pair}
        return (
            image,
            [i in bumped for i in robots],
            [i in involved for i in robots],
            len(collisions),
        )

    def reach(self, start):
        cells = range(self.cells.size)
        steps = {(self.place(z), self.place(self.image[z])) for z in cells}
        reached = {*map(self.place, start)}
        for _ in range(self.cells.positions):
            reached |= {q for p, q in steps if p in reached}
        return reached

    def place(self, z):
        return z % self.cells.positions

    def part(self, begin, visited, covered, reach, limit):
        states, events, known = [begin], [], visited | {tuple(begin)}
        covered = covered | {*map(self.place, begin)}
        while covered != reach and len(events) < limit:
            image, *event = self.step(states[-1])
            states.append(image)
            events.append(event)
            covered |= {*map(self.place, image)}
            if tuple(image) in known:
                break
            known.add(tuple(image))
        return states, events, covered, known

    def begins(self, last):
        for i in range(len(last)):
            for turn in 1, -1:
                begin = list(last)
                begin[i] = (begin[i] + turn * self.cells.positions) % self.cells.size
                yield begin

    def trajectory(self, start, max_parts, limit):
        reach, none = self.reach(start), [False] * len(start)
        states, events, covered, visited = self.part(start, set(), set(), reach, limit)
        parts, outcome = [0], TeamOutcome.OUT_OF_PARTS
        while covered != reach and len(parts) < max_parts:
            begins = [begin for begin in self.begins(states[-1]) if tuple(begin) not in visited]
            if not begins:
                outcome = TeamOutcome.STUCK
                break
            tries = [self.part(begin, visited, covered, reach, limit) for begin in begins]
            best = max(tries, key=lambda part: (len(part[2]), -sum(event[2] for event in part[1])))
            parts.append(len(states))
            events = [*events, [none, none, 0], *best[1]]
            states, covered, visited = states + best[0], best[2], best[3]
        if covered == reach:
            everywhere = len(reach) == self.cells.positions
            outcome = TeamOutcome.COVERED if everywhere else TeamOutcome.OUT_OF_REACH
        return states, events, parts, covered, outcome


@given(SPACES, NUMBERS, st.sampled_from([1.0, 2.5]), st.integers(0, 2**32))
def test_joint_map_follows_its_rules(cells, robots, step, seed):
    states = states_of(cells, robots, seed, 32)
    shift = np.random.default_rng(seed).integers(8, size=robots)
    oracle = Oracle(cells, shift.tolist(), step)
    joint = orbits(cells, shift, states, step=step)
    fields = joint.image, joint.bumped, joint.collided, joint.collisions
    for i, state in enumerate(states.tolist()):
        assert tuple(field[0, i].tolist() for field in fields) == oracle.step(state)


@given(SPACES, NUMBERS, st.sampled_from([1.0, 2.5]), st.integers(0, 2**32))
@settings(max_examples=20)
def test_robots_never_share_a_position_and_their_order_makes_no_difference(
    cells, robots, step, seed
):
    rng = np.random.default_rng(seed)
    states = states_of(cells, robots, seed, 32)
    shift = rng.integers(8, size=robots)
    order = rng.permutation(robots)
    plain = orbits(cells, shift, states, step=step)
    mixed = orbits(cells, shift[order], states[:, order], step=step)
    positions = np.sort(plain.image % cells.positions, axis=-1)
    assert (np.diff(positions, axis=-1) > 0).all()
    for name in ("image", "bumped", "collided"):
        np.testing.assert_array_equal(getattr(plain, name)[..., order], getattr(mixed, name))
    np.testing.assert_array_equal(plain.collisions, mixed.collisions)


# Directions 0 to 7: E, NE, N, NW, W, SW, S, SE. Robots are (column, row, direction).
EAST, NORTH_EAST, NORTH, NORTH_WEST, WEST, SOUTH = 0, 1, 2, 3, 4, 6


MEETINGS = {
    "same cell": ([(1, 1, EAST), (3, 1, WEST)], [1, 1], 1),
    "change places": ([(1, 1, EAST), (2, 1, WEST)], [1, 1], 1),
    "cross on diagonals": ([(1, 1, NORTH_EAST), (2, 1, NORTH_WEST)], [1, 1], 1),
    "one follows another": ([(1, 1, EAST), (2, 1, EAST)], [0, 0], 0),
    "round dance": ([(1, 1, EAST), (2, 1, NORTH), (2, 2, WEST), (1, 2, SOUTH)], [0, 0, 0, 0], 0),
    "queue at a wall, and a robot behind the queue": (
        [(4, 0, EAST), (3, 0, EAST), (2, 0, EAST), (0, 0, EAST)],
        [1, 1, 1, 0],
        2,
    ),
    "behind two robots that change places": (
        [(0, 1, EAST), (1, 1, EAST), (2, 1, WEST)],
        [1, 1, 1],
        3,
    ),
    "three in one cell": ([(1, 1, EAST), (3, 1, WEST), (2, 0, NORTH)], [1, 1, 1], 3),
    "into a cell that is left": ([(1, 1, EAST), (2, 1, NORTH_EAST)], [0, 0], 0),
}


@pytest.mark.parametrize(("robots", "bumped", "collisions"), MEETINGS.values(), ids=MEETINGS)
def test_robots_that_meet_bump_and_collide(robots, bumped, collisions):
    cells = CellSpace.of_grid(np.ones((4, 5), bool), 8)
    state = [cells.index(x + 0.5, y + 0.5, k * math.pi / 4) for x, y, k in robots]
    joint = one_step(cells, np.full(len(robots), 3), np.array(state))
    np.testing.assert_array_equal(joint.bumped, bumped)
    np.testing.assert_array_equal(joint.collided, bumped)
    assert joint.collisions == collisions
    for (x, y, k), stays, z in zip(robots, bumped, joint.image.tolist(), strict=True):
        if stays:
            assert z == cells.index(x + 0.5, y + 0.5, (k + 3) * math.pi / 4)


@given(
    SPACES,
    st.sampled_from([1, 3]),
    st.sampled_from([1.0, 2.0]),
    st.sampled_from([(20, None), (3, None), (40, 7)]),
    st.integers(0, 2**32),
)
def test_trajectory_follows_the_algorithm(cells, robots, step, limits, seed):
    max_parts, part_steps = limits
    start = states_of(cells, robots, seed, 1)[0].tolist()
    shift = np.random.default_rng(seed).integers(8, size=robots)
    result = team_trajectory(
        cells,
        start,
        shift * 2 * math.pi / 8,
        motion=Motion(step),
        max_parts=max_parts,
        part_steps=part_steps,
    )
    limit = cells.size if part_steps is None else part_steps
    states, events, parts, covered, outcome = Oracle(cells, shift.tolist(), step).trajectory(
        start, max_parts, limit
    )
    assert result.cell.tolist() == states
    assert result.bumped.tolist() == [event[0] for event in events]
    assert result.collided.tolist() == [event[1] for event in events]
    assert result.collisions.tolist() == [event[2] for event in events]
    assert result.part_begin.tolist() == parts
    assert result.uncovered_positions.tolist() == sorted(set(range(cells.positions)) - covered)
    assert result.outcome is outcome
    visited = set()
    for joint, count in zip(states, result.covered, strict=True):
        visited |= {z % cells.positions for z in joint}
        assert count == len(visited)


@given(SPACES, st.sampled_from([1, 3]), st.integers(0, 2**32))
@settings(max_examples=15)
def test_runs_of_a_batch_equal_single_runs(cells, robots, seed):
    starts = states_of(cells, robots, seed, 5)
    options = {"max_parts": 30, "part_steps": 60}
    batch = team_trajectories(cells, starts, 3 * math.pi / 4, **options)
    assert len(batch) == 5
    for start, one in zip(starts, batch, strict=True):
        alone = team_trajectory(cells, start, [3 * math.pi / 4], **options)
        assert vars(one).keys() == vars(alone).keys()
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(alone, name), err_msg=name)


def room():
    free = np.ones((10, 10), bool)
    free[2:4, 2:4] = free[6:8, 5:9] = free[0:2, 7] = False
    return CellSpace.of_grid(free, 8)


@pytest.mark.parametrize(
    ("starts", "bounces", "options", "message"),
    [
        ([], 0.0, {}, "starts: there are no robots"),
        ([0, 800], 0.0, {}, "robot 1 is in cell 800, which does not exist; cells are 0 to 687"),
        ([-1], 0.0, {}, "robot 0 is in cell -1"),
        ([5, 7, 5 + 86], 0.0, {}, "robots 0 and 2 are both at position 5, in cells 5 and 91"),
        ([0, 1], [], {}, "bounces: got 0 angles for 2 robots"),
        ([0, 1], [0.0, 0.0, 0.0], {}, "bounces: got 3 angles for 2 robots"),
        ([0], 0.0, {"max_parts": 0}, "max_parts: expected at least 1, got 0"),
        ([0], 0.0, {"part_steps": 0}, "part_steps: expected at least 1, got 0"),
    ],
)
def test_starts_and_angles_that_do_not_fit_are_refused(starts, bounces, options, message):
    with pytest.raises(ValueError, match=message):
        team_trajectory(room(), starts, bounces, **options)


def test_a_refused_run_of_a_batch_is_named_by_its_number():
    with pytest.raises(ValueError, match="starts of run 1: robots 0 and 1 are both at position 3"):
        team_trajectories(room(), np.array([[0, 1], [3, 3]]), 0.0)
