"""Robots that slip, and that bumps turn, compared with the emulator and with plain Python."""

import dataclasses
import functools
import itertools
import math

import jax
import numpy as np
import pytest
from wheels import walker_in

from jaxcell import bounce, space
from jaxcell.automata import Belief
from jaxcell.robot import BeliefFollower, Particles, run_follower
from jaxcell.robot.emulation.body import Noise
from jaxcell.robot.emulation.direct import DirectBody


ROOM = space.Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(2, 1), (3, 1), (3, 2), (2, 2)]])
CELLS = space.CellSpace.of(ROOM, 1.0, 8)
TURN = math.radians(135)
SLIP = space.Slip.of(0.02, give=0.02)
# Numbers of the tests of bumps that turn a robot.
FINE_HEADINGS = space.CellSpace.of(ROOM, 1.0, 24)
ERROR, BUMP_TURN, BUMP_SKID = 0.005, math.radians(3), 0.02


@pytest.fixture(scope="module")
def fine():
    return bounce.FineCells.of(CELLS, squares=3, directions=4, reach=3)


@pytest.fixture(scope="module")
def hidden(fine):
    return bounce.slip_map(fine, [TURN], space.Slip.of(0.03, give=0.02))


def emulated(cell, error, rng, *, cells=CELLS, give=0.02, **bumps):
    """Return an emulated robot in a cell, and its body."""
    noise = Noise(distance=error, rotation=error, veer=error, **bumps)
    return walker_in(cells, cell, robot=DirectBody, give=give, noise=noise, rng=rng)


def emulated_run(cell, error, steps, rng, **options):
    """Yield each observation of an emulated robot, and its pose."""
    walker, body = emulated(cell, error, rng, **options)
    for _ in range(steps):
        bumped = walker.step()
        if bumped:
            walker.rotate(TURN)
        yield int(bumped), body.pose


def run_of_the_emulator(cell, error, steps, seed):
    run = emulated_run(cell, error, steps, np.random.default_rng(seed))
    observed, poses = zip(*run, strict=True)
    return observed, poses[-1]


@pytest.mark.parametrize("directions", [8, 24])
def test_a_robot_without_slip_moves_as_the_bounce_map(directions):
    cells = space.CellSpace.of(ROOM, 1.0, directions)
    simple = jax.device_get(bounce.bounce_map(cells, TURN))
    pose = np.stack(cells.centre(np.arange(cells.size)), axis=1)
    legs = space.stride_legs(directions, 1.0, 1.0)[np.arange(cells.size) // cells.positions]
    walls = space.felt_walls(ROOM, 0.02)
    after, bumped = space.slipping_step(
        pose, legs, TURN, np.zeros((cells.size, 9)), walls, space.Slip()
    )
    # A second stretch, to the centre of a cell, may meet a wall that the step does not.
    straight = legs[:, 2] == 0
    np.testing.assert_array_equal(bumped[straight], simple.bumped[straight])
    assert (bumped >= simple.bumped).all()
    same = bumped == simple.bumped
    np.testing.assert_array_equal(cells.index(*after[same].T), simple.image[same])


@pytest.mark.parametrize("direction", [0, 3])
def test_ends_of_steps_and_bumps_spread_as_in_the_emulator(direction):
    noise, count = 0.05, 250
    rng = np.random.default_rng(0)
    for place in (0, 4):
        cell = direction * CELLS.positions + place
        runs = [run_of_the_emulator(cell, noise, 1, seed) for seed in range(count)]
        emulated = np.array([pose for _, pose in runs])
        legs = np.tile(space.stride_legs(8, 1.0, 1.0)[direction], (4000, 1))
        pose = np.tile(np.stack(CELLS.centre(cell)), (4000, 1))
        walls = space.felt_walls(ROOM, 0.02)
        ends, bumped = space.slipping_step(
            pose, legs, TURN, rng.standard_normal((4000, 9)), walls, space.Slip.of(noise)
        )
        assert abs(bumped.mean() - np.mean([observed for observed, _ in runs])) < 0.1
        if 0.02 < bumped.mean() < 0.98:
            continue
        np.testing.assert_allclose(ends.mean(axis=0), emulated.mean(axis=0), atol=0.02)
        # The standard error of these standard deviations is 5 %.
        np.testing.assert_allclose(ends.std(axis=0), emulated.std(axis=0), rtol=0.25, atol=0.004)


def test_rows_are_distributions_and_the_start_is_at_the_centres(fine, hidden):
    both = hidden.moves + hidden.bumps[0]
    np.testing.assert_allclose(both.sum(axis=1), 1)
    assert np.count_nonzero(fine.centres) == CELLS.size
    np.testing.assert_array_equal(np.sort(fine.coarse[fine.centres > 0]), np.arange(CELLS.size))
    assert fine.poses.shape == (fine.size, 3)
    again = fine.index(fine.poses, fine.believed)
    np.testing.assert_array_equal(again, np.arange(fine.size))


def test_a_heading_spreads_among_fine_directions_as_it_drifts():
    fine = bounce.FineCells.of(CELLS, squares=1, directions=8, reach=4)
    after = bounce.slip_map(fine, [TURN], space.Slip.of(0.03, give=0.02)).after(0, fine.at(0))
    off = np.arange(fine.size) // fine.fine.positions % 9 - 4
    variance = after @ off**2 / after.sum() * (2 * math.pi / 64) ** 2
    # With few samples, one more or less goes to the next direction.
    assert variance == pytest.approx(0.03**2, rel=0.1)


def test_the_credible_set_holds_the_emulated_robot(fine, hidden):
    belief, held = Belief(hidden), []
    rng = np.random.default_rng(5)
    for seed in range(60):
        cell = int(rng.integers(CELLS.size))
        observed, pose = run_of_the_emulator(cell, 0.03, 15, seed)
        state = functools.reduce(belief.observe, observed, belief.start())
        held.append(int(space.nearest_cell(CELLS, *pose)) in belief.estimate(state).cells)
        assert state.nowhere < 0.5
    assert np.mean(held) > 0.85


def test_a_robot_that_chooses_its_angle_is_localized_sooner(fine):
    bounces = np.radians([90, 135]).tolist()
    both = bounce.slip_map(fine, bounces, space.Slip.of(0.03, give=0.02))
    bumps, held = {1: 0, 2: 0}, []
    for angles in ([1], [0, 1]):
        belief = Belief(dataclasses.replace(both, bumps=tuple(both.bumps[i] for i in angles)))
        for seed in range(1, 9):
            rng = np.random.default_rng(seed)
            walker, body = emulated((37 * seed) % CELLS.size, 0.03, rng)
            outcome = run_follower(
                walker, BeliefFollower(belief, confirm=0), [bounces[i] for i in angles], limit=40
            )
            bumps[len(angles)] += outcome.observations.count("1")
            held.append(int(space.nearest_cell(CELLS, *body.pose)) in outcome.cells)
    assert np.mean(held) > 0.85
    assert bumps[2] < 0.8 * bumps[1]


def test_particles_find_the_emulated_robot():
    cloud, held = Particles(CELLS, TURN, space.Slip.of(0.03, give=0.02), count=2000), []
    for seed in range(12):
        observed, pose = run_of_the_emulator(seed * 6, 0.03, 12, seed)
        state = functools.reduce(cloud.observe, observed, cloud.start())
        held.append(int(space.nearest_cell(CELLS, *pose)) in cloud.estimate(state).cells)
    assert np.mean(held) > 0.8


def test_equal_seeds_give_equal_particles():
    clouds = [Particles(CELLS, TURN, space.Slip.of(0.03), count=50, seed=s) for s in (1, 1, 2)]
    states = [cloud.observe(cloud.start(), 0) for cloud in clouds]
    np.testing.assert_array_equal(states[0].pose, states[1].pose)
    assert (states[0].pose != states[2].pose).any()


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("step", 1.5, "slip: step: expected a number from 0 to 1, got 1.5"),
        ("turn", -0.1, "slip: turn: expected a number from 0 to 1, got -0.1"),
        ("heading", float("nan"), "slip: heading: expected a number from 0 to 1"),
        ("bumper", -1.0, "slip: bumper: expected a length of 0 m or more"),
        ("give", float("inf"), "slip: give: expected a length of 0 m or more"),
        ("bump_skid", -0.01, "slip: bump_skid: expected a length of 0 m or more"),
        ("bump_turn", 2.0, "slip: bump_turn: expected -1 to 1 radians"),
        ("bump_turn", float("nan"), "slip: bump_turn: expected -1 to 1 radians"),
    ],
)
def test_a_slip_out_of_range_is_refused(field, value, match):
    with pytest.raises(ValueError, match=match):
        space.Slip(**{field: value})


@pytest.mark.parametrize(
    ("squares", "directions", "reach", "match"),
    [
        (2, 1, 0, "squares: expected an odd number"),
        (0, 1, 0, "squares: expected an odd number"),
        (1, 0, 0, "directions: expected at least 1"),
        (1, 1, -1, "reach: expected a number from 0"),
    ],
)
def test_fine_cells_with_numbers_out_of_range_are_refused(squares, directions, reach, match):
    with pytest.raises(ValueError, match=match):
        bounce.FineCells.of(CELLS, squares=squares, directions=directions, reach=reach)


def test_fine_cells_are_at_most_the_given_number():
    sizes = [bounce.FineCells.within(CELLS, space.Slip.of(0.02), n).size for n in (1, 5000, 20_000)]
    assert sizes[0] == CELLS.size
    assert all(a < b for a, b in itertools.pairwise(sizes))
    assert sizes[2] <= 20_000


@pytest.mark.parametrize("error", [0.02, 0.1])
def test_headings_drift_no_further_than_fine_cells_reach(error):
    slip = space.Slip.of(error, give=0.02)
    fine = bounce.FineCells.within(CELLS, slip)
    walls, legs = space.felt_walls(ROOM, slip.give), space.stride_legs(8, 1.0, 1.0)
    rng, cell = np.random.default_rng(4), np.arange(1000) % CELLS.size
    pose, believed = np.stack(CELLS.centre(cell), axis=1), cell // CELLS.positions
    for _ in range(40):
        noise = rng.standard_normal((cell.size, 9))
        pose, bumped = space.slipping_step(pose, legs[believed], TURN, noise, walls, slip)
        believed = (believed + 3 * bumped) % 8
    off = np.abs((pose[:, 2] - believed * math.pi / 4 + math.pi) % (2 * math.pi) - math.pi)
    assert np.mean(off < (fine.reach + 0.5) * 2 * math.pi / fine.fine.directions) > 0.97


@pytest.mark.parametrize("degrees", [-60, -45, -15, 0, 30, 45, 60])
@pytest.mark.parametrize("slip", [space.Slip(bump_turn=0.05), space.Slip(bump_skid=BUMP_SKID)])
def test_a_bump_turns_a_robot_toward_the_wall_or_leaves_it_behind_its_start(slip, degrees):
    heading = math.radians(degrees)
    pose, leg = np.array([[3.5, 1.5, heading]]), np.array([[2.0, 0, 0]])
    walls = space.felt_walls(ROOM, 0.0)
    after, bumped = space.slipping_step(pose, leg, 0.0, np.zeros((1, 9)), walls, slip)
    assert bumped.all()
    # A robot that heads to the left of East turns right, toward the wall.
    turned = heading - slip.bump_turn * math.sin(2 * heading)
    assert after[0, 2] == pytest.approx(turned, abs=1e-9)
    if slip.bump_skid:
        ahead = np.array([math.cos(heading), math.sin(heading)])
        behind = pose[0, :2] - BUMP_SKID * math.cos(heading) ** 2 * ahead
        assert after[0, :2] == pytest.approx(behind, abs=1e-9)


def test_the_emulated_robot_is_turned_and_skids_as_the_model_says():
    cells, give, rng = FINE_HEADINGS, 1e-6, np.random.default_rng(0)
    bumps = {"bump_turn": BUMP_TURN, "bump_skid": BUMP_SKID}
    slip = space.Slip(**bumps)
    walls = space.felt_walls(ROOM, give)
    pose = np.stack(cells.centre(np.arange(cells.size)), axis=1)
    legs = np.repeat(space.stride_legs(24, 1.0, 1.0), cells.positions, axis=0)
    after, bumped = space.slipping_step(pose, legs, 0.0, np.zeros((cells.size, 9)), walls, slip)
    ahead = space.free_ahead(walls, pose[:, :2], pose[:, 2])
    met = pose[:, :2] + ahead[:, None] * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    to_corner = np.hypot(*(met[:, None] - walls.reshape(-1, 2)).T).min(axis=0)
    # The model simplifies bumps in the second of two stretches, and near corners.
    compared = np.flatnonzero(bumped & (ahead < legs[:, 0]) & (to_corner >= 0.01)).tolist()
    assert len(compared) > 20
    for cell in compared:
        walker, body = emulated(cell, 0.0, rng, cells=cells, give=give, **bumps)
        assert walker.step()
        turned = math.remainder(body.theta - after[cell, 2], 2 * math.pi)
        assert turned == pytest.approx(0.0, abs=1e-5)
        assert math.dist(body.pose[:2], after[cell, :2]) < 0.005


def test_a_belief_has_to_know_the_turn_at_bumps_to_hold_the_robot():
    cells, held = FINE_HEADINGS, []
    for known in (BUMP_TURN, 0.0):
        slip = space.Slip.of(ERROR, give=0.02, bump_turn=known)
        belief = Belief(bounce.slip_map(bounce.FineCells.within(cells, slip), [TURN], slip))
        rng, right = np.random.default_rng(0), []
        for cell in rng.integers(cells.size, size=30).tolist():
            state = belief.start()
            run = emulated_run(cell, ERROR, 20, rng, cells=cells, bump_turn=BUMP_TURN)
            for observed, pose in run:
                state = belief.observe(state, observed)
                right.append(int(cells.index(*pose)) in belief.estimate(state).cells)
        held.append(np.mean(right))
    assert held[0] > 0.98
    assert held[1] < 0.97
