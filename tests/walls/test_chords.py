import numpy as np
import pytest
import shapely

from experiments.chapter_2.file_rays import FileRays, rings_of
from jaxcell import space, walls
from jaxcell.base.bundled import bundled
from jaxcell.walls.sets import WallSet, everywhere, leaving


def test_walls_enclose_the_free_space():
    room = space.Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    boundary = walls.Boundary.of(room)
    ends = boundary.point(np.arange(8), boundary.length)
    assert np.allclose(ends, boundary.begin[boundary.following])
    middle = boundary.point(np.arange(8), boundary.length / 2)
    inside = middle + 1e-3 * boundary.normal
    assert shapely.contains_xy(room.free_space, inside).all()


@pytest.mark.parametrize("name", ["lab_a", "complex", "cafe"])
@pytest.mark.parametrize(
    ("slices", "known", "displacement"), [(16, True, 0.0), (90, False, 0.0), (90, False, 0.03)]
)
def test_every_run_is_within_the_bounds_of_a_chord(name, slices, known, displacement):
    """Runs are from wall to wall through random places, by the polygons of the file."""
    rings, radius = rings_of(bundled(name))
    boundary = walls.Boundary.of(space.Workspace(rings[0], rings[1:], robot_radius=radius))
    chords = walls.Chords.of(boundary, slices, known=known, displacement=displacement)
    room, rng, robots = FileRays(rings, radius), np.random.default_rng(1), 1000
    middle, slides = room.anywhere(robots, rng), np.zeros(robots, bool)
    slice_ = rng.integers(slices, size=robots)
    heading = (slice_ + (0.0 if known else rng.uniform(size=robots))) * 2 * np.pi / slices
    back, start = room.run(middle, heading + np.pi, slides)
    ahead, end = room.run(middle, heading, slides)
    # Some runs begin a little off the wall.
    run = back + ahead - np.minimum(back, rng.choice([0.0, displacement], robots))
    assert all(
        any_row_allows(chords, *one, 1e-8 + 0.003 * radius)
        for one in zip(slice_, start, end, run, strict=True)
    )


@pytest.mark.parametrize(("slices", "known"), [(16, True), (90, False)])
def test_bounds_of_runs_leave_out_only_chords_that_are_impossible(slices, known):
    rings, radius = rings_of(bundled("cafe"))
    boundary = walls.Boundary.of(space.Workspace(rings[0], rings[1:], robot_radius=radius))
    chords, slow = (walls.Chords.of(boundary, slices, known=known) for _ in range(2))
    slow.__dict__["run"] = np.stack([np.zeros(slow.wall.size), np.full(slow.wall.size, np.inf)])
    places, least = everywhere(chords), np.array([0.0, 0.3, 1.0, 4.0])
    state = WallSet(*(np.tile(part, least.size) for part in places))
    state = state._replace(robot=np.repeat(np.arange(least.size), places.robot.size))
    for width in (0.0, 0.1):
        found = leaving(chords, state, least, least + width)
        expected = leaving(slow, state, least, least + width)
        assert all(np.array_equal(*pair) for pair in zip(found, expected, strict=True))


def any_row_allows(chords, slice_, start, end, run, near):
    """Check whether a row of `chords` allows a run from one place to another."""
    boundary, wall = chords.boundary, np.arange(len(chords.boundary.length))
    arcs = [((at - boundary.begin) * boundary.tangent).sum(axis=1) for at in (start, end)]
    off = [
        np.linalg.norm(at - boundary.point(wall, np.clip(arc, 0, boundary.length)), axis=1)
        for at, arc in zip((start, end), arcs, strict=True)
    ]
    rows = np.flatnonzero((chords.slice == slice_) & (off[0][chords.wall] <= near))
    rows = rows[off[1][chords.hit[rows]] <= near]
    at, reach = arcs[0][chords.wall[rows]], chords.reach[rows]
    allowed = (chords.begin[rows] - near <= at) & (at <= chords.end[rows] + near)
    far = chords.clearance[0, rows] + chords.clearance[1, rows] * at
    gentle, steep = chords.sine[:, rows]
    allowed &= (run * gentle - reach <= far) & (far <= run * steep + reach)
    shortest, longest = chords.run[:, rows]
    allowed &= (shortest - near <= run) & (run <= longest + near)
    ends, spread = chords.arc[:, 0, rows] + chords.arc[:, 1, rows] * at, chords.spread[:, rows]
    arc = arcs[1][chords.hit[rows]]
    allowed &= (ends - spread).min(axis=0) - near <= arc
    return (allowed & (arc <= (ends + spread).max(axis=0) + near)).any()
