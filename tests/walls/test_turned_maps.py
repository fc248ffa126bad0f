"""Sets on walls of maps that are turned, mirrored and far from the origin, by rays of the file."""

import math

import numpy as np
import pytest

from experiments.chapter_2.file_rays import FileRays, holds, moved, rings_of
from jaxcell import space, walls
from jaxcell.base.bundled import bundled


MAPS = ("lab_a", "lab_b", "complex", "slanted", "arena", "depot", "harbour", "room_200x125", "cafe")
# Turns of the map, and numbers of headings with which robots drive along its walls. By 0.1 radian
# no wall is parallel to a heading.
TURNS = ((0, 8), (math.radians(15), 24), (math.radians(30), 12), (math.radians(45), 8), (0.1, 8))
UTM = (448211.37, 4411876.91)
# Arcs of a disc robot are replaced by chords, to less than this share of its radius.
SAGITTA = 0.003


def lost(rings, radius, headings, errors, *, robots, bumps, constant=False, slices=360):
    """Count the robots that are outside of their sets after a bump.

    Half of the robots slide along walls that are parallel to their headings, and past corners that
    they touch. The others stop there now and then.
    """
    workspace = space.Workspace(rings[0], rings[1:], robot_radius=radius)
    filter = walls.WallFilter.of(workspace, headings=headings, errors=errors, slices=slices)
    room, rng = FileRays(rings, radius), np.random.default_rng(5)
    place = room.anywhere(robots, rng)
    heading = rng.uniform(0, math.tau, robots)
    if headings is not None:
        heading = rng.integers(headings, size=robots) * math.tau / headings
    step = math.tau / headings if headings and filter.chords.width == 0 else math.pi / 4
    turns = step * np.arange(math.ceil(0.7 / step), math.floor(3 / step) + 1)
    always = rng.choice([-1, 1], (3, robots))
    stopping = rng.uniform(size=robots) < 0.5
    out, state = np.zeros(robots, bool), None
    for _ in range(bumps):
        sign = always if constant else rng.choice([-1, 1], (3, robots))
        run, place = room.run(place, heading, stopping & (rng.uniform(size=robots) < 0.5))
        measured = run * (1 + errors.run * sign[0]) + errors.distance * sign[1]
        state = filter.observe(state, np.maximum(measured, 0.0))
        within = 1e-7 + 10 * np.spacing(np.abs(place).max()) * 1e3 + SAGITTA * radius
        out |= ~holds(filter, state, place, heading, within)
        turn = rng.choice(turns, robots)
        state = filter.turn(state, turn)
        heading = heading + turn + errors.turn * sign[2]
    return int(out.sum())


EXACT = walls.Errors()
BOUNDED = walls.Errors(run=0.01, distance=0.02)
TURNING = walls.Errors(run=0.01, distance=0.02, turn=math.radians(1))


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize(("turn", "headings"), TURNS)
def test_no_robot_of_known_heading_is_lost_on_a_turned_map(name, turn, headings):
    rings, radius = rings_of(bundled(name))
    rings = moved(rings, turn)
    assert lost(rings, radius, headings, EXACT, robots=40, bumps=15) == 0


@pytest.mark.parametrize(("turn", "headings"), TURNS)
@pytest.mark.parametrize("name", ["complex", "slanted"])
@pytest.mark.parametrize("shift", [(0, 0), UTM])
def test_no_robot_is_lost_on_a_mirrored_map_far_from_the_origin(name, turn, headings, shift):
    rings, radius = rings_of(bundled(name))
    rings = moved(rings, turn, shift, mirror=True)
    assert lost(rings, radius, headings, BOUNDED, robots=80, bumps=15, constant=True) == 0


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize(("name", "turn"), [("complex", math.pi / 4), ("lab_b", math.pi / 6)])
@pytest.mark.parametrize("headings", [8, None])
def test_no_robot_with_errors_of_turns_is_lost_on_a_turned_map(name, turn, headings, constant):
    rings, radius = rings_of(bundled(name))
    rings = moved(rings, turn)
    assert lost(rings, radius, headings, TURNING, robots=30, bumps=12, constant=constant) == 0


@pytest.mark.parametrize("errors", [EXACT, BOUNDED])
@pytest.mark.parametrize(
    ("name", "radius", "turn", "headings"),
    [
        ("cafe", 0.17, 0.0, 16),
        ("cafe", 0.02, math.pi / 4, 8),
        ("lab_b", 0.35, 0.0, 8),
        ("slanted", 0.17, 0.1, 8),
        ("arena", 0.1, math.pi / 6, 12),
    ],
)
def test_no_disc_robot_is_lost_among_exact_arcs(name, radius, turn, headings, errors):
    rings, _ = rings_of(bundled(name))
    rings = moved(rings, turn)
    assert lost(rings, radius, headings, errors, robots=60, bumps=20) == 0


@pytest.mark.parametrize("errors", [EXACT, TURNING])
def test_no_disc_robot_of_unknown_heading_is_lost_among_exact_arcs(errors):
    rings, radius = rings_of(bundled("cafe"))
    assert lost(rings, radius, None, errors, robots=10, bumps=10, slices=120) == 0


@pytest.mark.parametrize("slices", [4, 6, 8])
def test_few_slices_of_headings_lose_no_robot(slices):
    rings, radius = rings_of(bundled("lab_b"))
    errors = walls.Errors(run=0.01)
    turned = moved(rings, math.tau / slices / 2)
    for room in (rings, turned):
        assert lost_of_few_slices(room, radius, errors, slices) == 0


def lost_of_few_slices(rings, radius, errors, slices):
    workspace = space.Workspace(rings[0], rings[1:], robot_radius=radius)
    filter = walls.WallFilter.of(workspace, errors=errors, slices=slices)
    room, rng = FileRays(rings, radius), np.random.default_rng(6)
    place, heading = room.anywhere(60, rng), rng.uniform(0, math.tau, 60)
    out, state, turn = np.zeros(60, bool), None, math.tau / slices
    for _ in range(8):
        run, place = room.run(place, heading, np.zeros(60, bool))
        state = filter.observe(state, run)
        out |= ~holds(filter, state, place, heading, 1e-7)
        state, heading = filter.turn(state, turn), heading + turn
    return int(out.sum())


@pytest.mark.parametrize(("turn", "headings"), TURNS)
@pytest.mark.parametrize("name", ["maze", "office"])
def test_no_robot_is_lost_on_a_turned_grid(name, turn, headings):
    workspace = space.Workspace.load(bundled(name))
    turned = moved([workspace.boundary, *workspace.obstacles], turn)
    filter = walls.WallFilter.of(space.Workspace(turned[0], turned[1:]), headings=headings)
    room = FileRays(moved(rings_of(bundled(name))[0], turn))
    rng = np.random.default_rng(7)
    place = room.anywhere(20, rng)
    heading = rng.integers(headings, size=20) * math.tau / headings
    out, state = np.zeros(20, bool), None
    for _ in range(10):
        run, place = room.run(place, heading, rng.uniform(size=20) < 0.3)
        state = filter.observe(state, run)
        out |= ~holds(filter, state, place, heading, 1e-7)
        turns = rng.integers(1, headings, size=20) * math.tau / headings
        state, heading = filter.turn(state, turns), heading + turns
    assert not out.any()


def test_bounces_between_two_slices_are_refused_before_the_chords_are_computed(monkeypatch):
    rings, _ = rings_of(bundled("complex"))
    monkeypatch.setattr(walls.Chords, "of", None)
    with pytest.raises(ValueError, match=r"multiple of 3\.6 degrees"):
        walls.WallFilter.of(space.Workspace(rings[0]), slices=100, turns=[math.radians(45)])
