"""The choice of angles at bumps, and simulated robots that start anywhere."""

import numpy as np
import pytest

from jaxcell import space, walls
from jaxcell.base.bundled import bundled


HALL = space.Workspace([(0, 0), (6, 0), (6, 2), (2, 2), (2, 5), (0, 5)])


@pytest.mark.parametrize("headings", [8, None])
def test_robots_whose_errors_are_at_their_bounds_are_held(headings):
    errors = walls.Errors(
        run=0.02, distance=0.03, late=0.02, turn=np.radians(1), displacement=0.03, heading=0.03
    )
    filter = walls.WallFilter.of(HALL, headings=headings, errors=errors)
    trial = walls.drive_anywhere(
        HALL, filter, [float(np.radians(135))], robots=20, bumps=12, headings=headings, seed=1
    )
    assert trial.held.all()


def test_a_choice_of_angles_needs_fewer_bumps_than_one_angle():
    """Turns by 45 degrees alone do not distinguish the places of this lab."""
    lab = space.Workspace.load(bundled("lab_a"))
    filter = walls.WallFilter.of(lab, headings=8, step=1.0)
    ends = [
        walls.drive_anywhere(
            lab, filter, np.radians(angles).tolist(), robots=40, bumps=20, headings=8, seed=2
        ).extent[:, -1]
        for angles in ([45.0], [45.0, 135.0])
    ]
    assert np.median(ends[1]) < np.median(ends[0])


def size(filter, state):
    """Compute the extent of a set times the length of its stretches, each 5 cm longer."""
    return filter.extent(state, 1)[0] * sum(state.end - state.begin + 0.05)


def test_the_angle_with_the_smaller_expected_set_is_chosen():
    """The expected sizes are computed from many places of the set."""
    filter = walls.WallFilter.of(HALL, errors=walls.Errors(distance=0.05))
    angles, rng = np.radians([90, 130]).tolist(), np.random.default_rng(3)
    state = filter.turn(filter.observe(None, 3.0), angles[1])
    state = filter.observe(state, 1.5)
    place, heading, _ = walls.draw_places(filter, state, 1, 60, rng)
    expected = []
    for angle in angles:
        _, _, run = walls.run_to_wall(filter.boundary, place, heading + angle)
        turned = filter.turn(state, angle)
        sizes = [size(filter, filter.observe(turned, length)) for length in run]
        expected.append(np.mean(sizes))
    votes = [
        int(walls.choose_angles(filter, state, 1, angles, np.random.default_rng(seed))[0])
        for seed in range(9)
    ]
    assert abs(expected[0] - expected[1]) > 0.2
    assert np.median(votes) == np.argmin(expected)


def brute_force(filter, state, angles, aim, ahead):
    """Compute the size after each angle, for all numbers of steps that may be counted."""
    place, heading, _ = walls.draw_places(filter, state, 1, 20_000, np.random.default_rng(9))
    sizes = []
    for angle in angles:
        turned = filter.turn(state, angle)
        _, _, run = walls.run_to_wall(filter.boundary, place, heading + angle)
        steps, count = np.unique(np.floor(run / filter.step + 1e-9), return_counts=True)
        after = [filter.observe(turned, step * filter.step) for step in steps]
        each = [
            size(filter, state)
            if ahead == 1
            else min(brute_force(filter, state, angles, aim, ahead - 1))
            for state in after
        ]
        sizes.append(max(each) if aim == "worst" else np.average(each, weights=count))
    return sizes


@pytest.mark.parametrize("aim", ["worst", "mean"])
def test_chosen_angles_are_as_good_as_each_fixed_angle_and_better_two_bumps_ahead(aim):
    filter = walls.WallFilter.of(HALL, headings=8, step=1.0)
    angles = np.radians([45.0, 135.0, 225.0]).tolist()
    fixed = np.zeros((3, len(angles)))
    chosen = np.zeros((3, 3))
    for run in range(6):
        state = filter.observe(None, float(run))
        sizes = np.array([brute_force(filter, state, angles, aim, ahead) for ahead in (1, 2)])
        fixed[1:] += sizes
        for ahead in (1, 2):
            rng = np.random.default_rng(run)
            best = walls.choose_angles(
                filter, state, 1, angles, rng, aim=aim, ahead=ahead, draws=60
            )
            chosen[ahead, 1:] += sizes[:, best[0]]
    for ahead in (1, 2):
        # Turns by 135 and 225 degrees are equally good, apart from the error of 20,000 draws.
        assert chosen[ahead, ahead] <= 1.005 * fixed[ahead].min()
    assert chosen[2, 2] < chosen[1, 2]


def test_robots_do_not_repeat_an_angle_after_which_they_know_no_more():
    boxes = [[(1, 2), (2.5, 2), (2.5, 3), (1, 3)], [(4, 4.2), (4.6, 4.2), (4.6, 5), (4, 5)]]
    room = space.Workspace([(0, 0), (6, 0), (6, 6), (0, 6)], boxes)
    filter = walls.WallFilter.of(room, headings=8)
    angles = np.radians([45.0, 90.0]).tolist()
    trial = walls.drive_anywhere(room, filter, angles, robots=20, bumps=20, headings=8, seed=0)
    assert (trial.extent[:, -1] < 0.25).mean() > 0.8


def homing_to_the_end_of_the_hall(**errors):
    filter = walls.WallFilter.of(HALL, errors=walls.Errors(**errors))
    angles = tuple(np.radians([70.0, 100.0, 135.0]).tolist())
    return filter, angles, walls.Homing(filter, (5.5, 1.0), 1.2, angles)


def test_robots_come_home_from_anywhere():
    errors = {"run": 0.01, "distance": 0.02, "turn": np.radians(0.5)}
    filter, angles, homing = homing_to_the_end_of_the_hall(**errors)
    trial = walls.drive_anywhere(HALL, filter, angles, robots=12, bumps=40, goal=homing, seed=5)
    home = trial.arrived.any(axis=1)
    assert home.mean() > 0.9
    first = trial.arrived.argmax(axis=1)
    ends = trial.place[np.arange(12), first][home]
    assert (np.hypot(*(ends - (5.5, 1.0)).T) <= 1.2).all()


def test_expected_bumps_to_the_goal_are_those_of_simulated_robots():
    """Robots that know their places choose by the table of expected bumps."""
    filter, angles, homing = homing_to_the_end_of_the_hall(distance=0.05)
    rng = np.random.default_rng(6)
    wall, ends = homing.parts
    robots = 400
    part = rng.integers(wall.size, size=robots)
    arc = ends[:, part].mean(axis=0)
    heading = rng.uniform(0, 2 * np.pi, robots)
    slices = homing.slices
    expected = homing.bumps[np.floor(heading * slices / (2 * np.pi)).astype(int), part]
    place, at = filter.boundary.point(wall[part], arc), wall[part]
    bumps = np.zeros(robots)
    going = np.ones(robots, bool)
    for _ in range(40):
        at, arc, _ = walls.run_to_wall(filter.boundary, place, heading)
        place = filter.boundary.point(at, arc)
        bumps += going
        going &= np.hypot(*(place - (5.5, 1.0)).T) > 1.2
        k = np.floor(heading % (2 * np.pi) * slices / (2 * np.pi)).astype(int)
        own = homing.part_at(at, arc)
        shifts = [round(angle * slices / (2 * np.pi)) for angle in angles]
        after = np.stack([homing.bumps[(k + shift) % slices, own] for shift in shifts])
        heading = heading + np.array(angles)[after.argmin(axis=0)]
    assert going.mean() < 0.05
    assert abs(bumps[~going].mean() - expected[~going].mean()) < 0.7


def test_a_goal_away_from_all_walls_is_refused():
    room = space.Workspace([(0, 0), (9, 0), (9, 9), (0, 9)])
    with pytest.raises(ValueError, match="goal: no wall lies within 1 m"):
        walls.Homing(walls.WallFilter.of(room, headings=8), (4.5, 4.5), 1.0, (1.0,))


@pytest.mark.parametrize(
    ("room", "headings", "places"),
    [
        (HALL, None, 1),
        (space.Workspace([(0, 0), (4, 0), (4, 2), (0, 2)]), None, 2),
        (space.Workspace([(0, 0), (4, 0), (4, 2), (0, 2)]), 8, 2),
        (space.Workspace([(0, 0), (2, 0), (1, np.sqrt(3))]), None, 3),
        (space.Workspace([(0, 0), (2, 0), (1, np.sqrt(3))]), 8, 1),
    ],
)
def test_places_that_look_alike_are_counted(room, headings, places):
    assert walls.alike_places(room, headings) == (places,)


def test_two_rooms_of_one_shape_look_alike():
    twin = [(1, 0.5), (5, 0.5), (5, 2.5), (1, 2.5)]
    between = [(0, 3), (10, 3), (10, 4), (0, 4)]
    bounds = [(0, 0), (10, 0), (10, 7), (0, 7)]
    room = space.Workspace(bounds, [between])
    assert room.pieces == 2
    assert walls.alike_places(room) == (4, 4)
    assert max(walls.alike_places(space.Workspace(bounds, [between, twin]))) < 4


def test_the_set_in_a_symmetric_room_is_symmetric():
    room = space.Workspace([(0, 0), (4, 0), (4, 2), (0, 2)])
    filter = walls.WallFilter.of(room, headings=8, step=0.1)
    trial = walls.drive_anywhere(
        room, filter, np.radians([45.0, 135.0]).tolist(), robots=10, bumps=25, headings=8, seed=7
    )
    last = trial.sets[-1]
    middle = (last.begin + last.end) / 2
    places = filter.boundary.point(last.wall, middle).round(3).tolist()
    mirrored = (np.array([4.0, 2.0]) - places).round(3).tolist()
    assert sorted(places) == sorted(mirrored)


@pytest.mark.parametrize(("radius", "localizes"), [(0.3, True), (0.8, False)])
def test_robots_are_localized_to_the_radius_of_the_goal_before_they_go_home(radius, localizes):
    """The mean over two places 0.7 m apart prefers a turn that need not tell them apart."""
    room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
    filter = walls.WallFilter.of(room, headings=8, errors=walls.Errors(distance=0.01))
    angles = tuple(np.radians([45, 90, 135]).tolist())
    homing = walls.Homing(filter, (2.5, 0.0), radius, angles)
    # Both places are on the lower wall, and the last run was downward.
    begin = np.array([1.0, 1.7])
    zeros = np.zeros(2, int)
    state = walls.WallSet(zeros, zeros + 6, zeros, begin, begin + 1e-3)
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "jaxcell.walls.homing.choose_angles",
            lambda filter, state, robots, *_: seen.append(robots) or np.zeros(robots, int),
        )
        homing.choose(state, 1, np.random.default_rng(0))
    assert bool(seen) == localizes
