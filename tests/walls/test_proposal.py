"""The proposed angles are the best of all sets if the search keeps all, and serve a goal."""

import itertools
import math

import numpy as np
import pytest

from jaxcell import space, study, walls


ROOM = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
ANGLES = [math.radians(angle) for angle in (45, 90, 135, 225)]


@pytest.fixture(scope="module")
def filter_of_room():
    return walls.WallFilter.of(ROOM, headings=8, errors=walls.Errors(distance=0.01))


def test_a_search_that_keeps_all_sets_finds_the_best_sets(filter_of_room):
    shared = {"robots": 8, "bumps": 6, "headings": 8, "seed": 4}
    best, tried, finished = walls.propose_angles(
        ROOM, filter_of_room, ANGLES, most=2, radius=0.1, kept=9, **shared
    )
    assert tried == 4 + 6
    assert finished
    for size, found in enumerate(best, 1):
        means = {}
        for angles in itertools.combinations(ANGLES, size):
            extent = walls.drive_anywhere(ROOM, filter_of_room, angles, **shared).extent
            known = [next((k + 1 for k, e in enumerate(row) if e <= 0.2), 12) for row in extent]
            means[angles] = sum(known) / 8
        assert means[found] == min(means.values())


def test_a_goal_that_one_angle_cannot_reach_takes_several(filter_of_room):
    goal = (2.5, 0.0), 0.5
    best, *_ = walls.propose_angles(
        ROOM, filter_of_room, ANGLES, most=2, radius=0.5, goal=goal, headings=8, robots=6
    )
    bumps = [walls.Homing(filter_of_room, *goal, angles).bumps.mean() for angles in best]
    assert bumps[1] < bumps[0]
    homing = walls.Homing(filter_of_room, *goal, tuple(ANGLES))
    np.testing.assert_array_equal(
        homing.bumps_by(best[1]), walls.Homing(filter_of_room, *goal, best[1]).bumps
    )


def test_rounds_with_few_robots_keep_an_angle_that_is_far_better(filter_of_room):
    """Turns by 90 degrees localize no robot in this room, and turns by 135 degrees each robot."""
    angles = [math.radians(angle) for angle in (90, 180, 135, 360, 270)]
    (best,), *_ = walls.propose_angles(
        ROOM, filter_of_room, angles, most=1, radius=0.1, kept=1, headings=8
    )
    assert best == (angles[2],)


def test_a_search_whose_time_is_over_returns_what_it_has_found(filter_of_room):
    best, tried, finished = walls.propose_angles(
        ROOM, filter_of_room, ANGLES, most=2, radius=0.1, headings=8, robots=4, seconds=0.0
    )
    assert (best, tried, finished) == (((ANGLES[0],),), 1, False)


def test_an_unfinished_search_says_so():
    found = study.ChooseAngles(
        map=ROOM, for_="localize", resolution=90.0, robots=4, bumps=4, measured=True, seconds=1e-9
    ).run()
    assert not found.finished
    assert "after 1 set of angles" in found.answer[1]


def test_the_answer_names_the_angles_and_the_poses_that_look_alike():
    """A room of 5 m by 1 m looks the same from the opposite pose whatever the angles are."""
    room = space.Workspace([(0, 0), (5, 0), (5, 1), (0, 1)])
    found = study.ChooseAngles(
        map=room, for_="localize", count=1, resolution=90.0, robots=8, bumps=6, measured=True
    ).run()
    assert found.angles_deg[0] in found.answer[0]
    assert "8 simulated robots" in found.answer[0]
    assert "not localized by any" in found.answer[1]
    assert found.share[0] == np.isfinite(found.best.bumps_until_localized).mean()
