import numpy as np
import pytest
import shapely

from jaxcell import space, walls
from jaxcell.base.bundled import bundled


@pytest.fixture(scope="module", params=["lab_a", "complex", "cafe"])
def boundary(request):
    return walls.Boundary.of(space.Workspace.load(bundled(request.param)))


def test_walls_enclose_the_free_space():
    room = space.Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    boundary = walls.Boundary.of(room)
    ends = boundary.point(np.arange(8), boundary.length)
    assert np.allclose(ends, boundary.begin[boundary.following])
    middle = boundary.point(np.arange(8), boundary.length / 2)
    inside = middle + 1e-3 * boundary.normal
    assert shapely.contains_xy(room.free_space, inside).all()


@pytest.mark.parametrize(
    ("slices", "known", "displacement"), [(16, True, 0.0), (90, False, 0.0), (90, False, 0.03)]
)
def test_every_run_is_within_the_bounds_of_a_chord(boundary, slices, known, displacement):
    rng = np.random.default_rng(1)
    chords = walls.Chords.of(boundary, slices, known=known, displacement=displacement)
    wall = rng.integers(len(boundary.length), size=3000)
    arc = rng.uniform(0, boundary.length[wall])
    slice_ = rng.integers(slices, size=wall.size)
    heading = (slice_ + (0.0 if known else rng.uniform(size=wall.size))) * 2 * np.pi / slices
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    leaves = (ahead * boundary.normal[wall]).sum(axis=1) > 1e-9
    wall, arc, slice_, heading = (part[leaves] for part in (wall, arc, slice_, heading))
    place = boundary.point(wall, arc) + 1e-9 * boundary.normal[wall]
    hit, end, run = walls.run_to_wall(boundary, place, heading)
    group = slice_ * len(boundary.length) + wall
    first, last = np.searchsorted(chords.group, [group, group + 1])
    held = np.zeros(wall.size, bool)
    for robot in range(wall.size):
        rows = slice(first[robot], last[robot])
        at = arc[robot]
        here = (chords.begin[rows] <= at + 1e-9) & (at <= chords.end[rows] + 1e-9)
        here &= chords.hit[rows] == hit[robot]
        far = chords.clearance[0, rows] + chords.clearance[1, rows] * at
        near, most = chords.stretch[:, rows]
        here &= (far - displacement) * near <= run[robot] + 1e-7
        with np.errstate(invalid="ignore"):
            here &= ~(run[robot] > (far + displacement) * most + 1e-7)
        ends = chords.arc[:, 0, rows] + chords.arc[:, 1, rows] * at
        here &= ends.min(axis=0) - 1e-7 <= end[robot]
        here &= end[robot] <= ends.max(axis=0) + 1e-7
        held[robot] = here.any()
    assert held.all()
