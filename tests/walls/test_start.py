"""Sets of robots from a start region, compared with robots that are simulated in shapely."""

import math

import numpy as np
import pytest
import shapely

from jaxcell import space, walls
from jaxcell.base.bundled import bundled
from jaxcell.base.formatting import format_value
from jaxcell.base.quantities import quantity
from jaxcell.study.bounce.anywhere import NavigateAnywhere, region_of


ERRORS = walls.Errors(run=0.02, distance=0.03, turn=math.radians(1), heading=math.radians(2))


def ray(free, x, y, heading):
    """The length of the free way from a place, or 0 if a robot at a wall faces it."""
    far = (x + 100 * math.cos(heading), y + 100 * math.sin(heading))
    inside = shapely.LineString([(x, y), far]) & free
    parts = [part for part in shapely.get_parts(inside) if part.length > 1e-9]
    near = [part for part in parts if part.distance(shapely.Point(x, y)) < 1e-7]
    return near[0].length if near else 0.0


def drive_from(free, place, radius, heading, errors, bumps, angle, rng):
    """Drive one robot from a disc with errors at their bounds: headings, places, and lengths."""
    while True:
        x, y = np.array(place) + radius * rng.uniform(-1, 1, 2)
        if math.dist((x, y), place) <= radius and free.covers(shapely.Point(x, y)):
            break
    heading += rng.choice([-1, 1]) * errors.heading * 0.9999
    rows = []
    for _ in range(bumps):
        run = ray(free, x, y, heading)
        x, y = x + run * math.cos(heading), y + run * math.sin(heading)
        measured = run * (1 + rng.choice([-1, 1]) * errors.run)
        measured += rng.choice([-1, 1]) * errors.distance
        rows.append((heading, x, y, max(measured, 0.0)))
        heading += angle + rng.choice([-1, 1]) * errors.turn * 0.9999
    return np.array(rows)


def covered(larger, smaller):
    """Check that each stretch of a set lies in a stretch of a larger set."""
    for robot, slice_, wall, begin, end in zip(*smaller, strict=True):
        same = (larger.robot == robot) & (larger.slice == slice_) & (larger.wall == wall)
        if not (same & (larger.begin <= begin + 1e-6) & (larger.end >= end - 1e-6)).any():
            return False
    return True


@pytest.mark.parametrize(
    ("name", "place", "radius"),
    [("lab_b", (1.0, 1.0), 0.1), ("complex", (2.0, 1.5), 0.0), ("arena", (0.5, 0.5), 0.2)],
)
@pytest.mark.parametrize("heading", [math.radians(93), None])
def test_set_from_a_dock_holds_its_robots_and_is_not_larger_than_from_anywhere(
    name, place, radius, heading
):
    room, angle, robots = space.Workspace.load(bundled(name)), math.radians(136), 12
    rng = np.random.default_rng(1)
    region = walls.StartRegion(place, heading, radius)
    dock = walls.WallFilter.of(room, slices=180, errors=ERRORS, start=region)
    anywhere = walls.WallFilter(dock.chords, ERRORS, np.ones(180, bool), 0.0)
    facing = rng.uniform(0, math.tau, robots) if heading is None else [heading] * robots
    driven = [
        drive_from(room.free_space, place, radius, one, ERRORS, 8, angle, rng) for one in facing
    ]
    own = wide = None
    for bump in np.stack(driven, axis=1):
        own, wide = dock.observe(own, bump[:, 3]), anywhere.observe(wide, bump[:, 3])
        assert walls.contains(dock.boundary, own, dock.slice_of(bump[:, 0]), bump[:, 1:3]).all()
        assert covered(wide, own)
        assert (dock.extent(own, robots) <= anywhere.extent(wide, robots) + 1e-6).all()
        own, wide = dock.turn(own, angle), anywhere.turn(wide, angle)


@pytest.mark.parametrize("degrees", range(0, 360, 45))
def test_a_dock_at_a_wall_holds_a_robot_of_each_known_heading(degrees):
    room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
    heading = math.radians(degrees)
    region = walls.StartRegion((0.0, 2.0), heading)
    filter = walls.WallFilter.of(room, headings=8, start=region)
    run = ray(room.free_space, 0.0, 2.0, heading)
    state = filter.observe(None, run)
    end = np.array([[run * math.cos(heading), 2 + run * math.sin(heading)]])
    assert walls.contains(filter.boundary, state, filter.slice_of([heading]), end).all()
    assert filter.extent(state, 1) < 1e-6


def test_longer_runs_and_other_starts_are_refused():
    room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
    filter = walls.WallFilter.of(room, headings=8, start=walls.StartRegion((1.0, 1.0), 0.0))
    assert filter.refuted(filter.observe(None, [4.0, 3.9, 40.0]), 3).tolist() == [False, True, True]
    for region, message in (
        (walls.StartRegion((3.0, 3.0)), "not in the free space"),
        (walls.StartRegion((1.0, 1.0), 0.0, -1.0), "radius: expected"),
        (walls.StartRegion((1.0, 1.0), 0.1), "one of the headings"),
    ):
        with pytest.raises(ValueError, match=message):
            walls.WallFilter.of(room, headings=8, start=region)


@pytest.mark.parametrize(
    ("text", "degrees"), [("1,1,North,0.1", 90), ("1,1, south", 270), ("1,1,East", 0)]
)
def test_a_word_of_a_compass_is_a_heading(text, degrees):
    lab = space.Workspace.load(bundled("lab_b"))
    assert region_of(lab, text, 8).heading == pytest.approx(math.radians(degrees))
    with pytest.raises(ValueError, match="such as 1,1,90"):
        region_of(lab, "1,1,Nowhere", 8)


def navigate(goal, **given):
    return NavigateAnywhere(
        map=bundled("complex"), bounce=(45.0, 90.0, 135.0), goal=goal, measured=True, **given
    ).run()


def test_robots_from_one_pose_without_errors_are_the_same():
    result = navigate("5,11", from_="1,1,North", robots=3, bumps=2)
    assert result.homing.radius == pytest.approx(2.25)
    first, why, known = result.answer[:3]
    assert first.startswith("0 % of 3 simulated robots (all the same) are within ")
    assert why == "0 of the 3 others were there at a bump and did not know it."
    assert known == (
        "From (1 m, 1 m), each of 3 simulated robots (all the same) knows its place to within "
        "less than 1 mm after 1, less than 1 mm after 2 bumps."
    )
    assert "Headings and turns are taken as exact" in result.answer[4]


def test_robots_that_are_there_and_do_not_know_it_are_counted():
    wide = {"from_": "1,1,North,0.1", "robots": 12, "bumps": 8, "slices": 72}
    result = navigate("1,12.5,0.6", errors=("run=0.02", "turn=0.02", "heading=0.05"), **wide)
    there = np.hypot(*np.moveaxis(result.trial.place - (1, 12.5), 2, 0)) <= 0.6
    others = np.isinf(result.bumps_until_home)
    count = (there.any(axis=1) & others).sum()
    assert f"{count} of the {others.sum()} others were there at a bump" in result.answer[1]
    assert count
    assert "(likely " in result.answer[0]


def test_a_robot_that_knows_its_pose_needs_the_bumps_of_its_way():
    room = space.Workspace([(0, 0), (4, 0), (4, 4), (0, 4)])
    filter = walls.WallFilter.of(room, headings=8)
    homing = walls.Homing(filter, (0.0, 2.0), 0.5, (math.pi,))
    place = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 3.5]])
    heading = np.array([math.pi, 0.0, 0.0])
    np.testing.assert_allclose(homing.expected(place, heading), [1, 2, math.inf])


def test_extents_are_written_as_anywhere_or_as_less_than_a_millimetre():
    about = quantity("", "extent", "m", kind="extent")
    written = [format_value(extent, about) for extent in (math.inf, 0.0, 1e-8, 0.25)]
    assert written == ["anywhere", "< 1 mm", "< 1 mm", "0.25 m"]
