import math

import jax
import jax.numpy as jnp
import jax.test_util
import numpy as np
import pytest
import scipy.optimize
from flint import fmpq
from hypothesis import given, strategies as st
from random_rooms import grids

from jaxcell import bundled
from jaxcell.bounce import bounce_groups, bounce_map, coverage_policy, noisy_bounce_map
from jaxcell.bounce.coverage import coverage_target
from jaxcell.mapping.classes import persistent_groups
from jaxcell.space import CELL_BY_CELL, ENDPOINT, CellSpace, Workspace

from ..oracles import exact_chains


GRIDS = grids(9, (3, 4))
ROUND = CellSpace.of(
    Workspace([(0, 0), (3, 0), (3.5, 1), (3, 2.2), (0, 2)], robot_radius=0.1), 0.5, 8
)
DEGREE = math.pi / 180


def room(directions=8):
    free = np.ones((3, 5), bool)
    free[1, 2] = free[0, 4] = False
    return CellSpace.of_grid(free, directions)


@given(
    GRIDS.map(lambda free: CellSpace.of_grid(free, 8)) | st.just(ROUND),
    st.integers(0, 7),
    st.integers(0, 3),
    st.sampled_from([0.25, 0.8, 1.0]),
    st.sampled_from([CELL_BY_CELL, ENDPOINT]),
)
def test_a_noisy_map_turns_by_all_angles_near_the_bouncing_angle(
    cells, shift, bins, reliability, motion
):
    if bins == 0:
        reliability = 1.0
    bounce, error = 45 * shift * DEGREE, 45 * bins * DEGREE
    chain = noisy_bounce_map(cells, bounce, error, reliability, motion=motion)
    exact = bounce_map(cells, bounce, motion=motion)
    expected = np.zeros((cells.size, cells.size))
    pairs = zip(np.asarray(exact.image), np.asarray(exact.bumped), strict=True)
    for z, (image, bumped) in enumerate(pairs):
        if not bumped:
            expected[z, image] = 1
            continue
        direction, position = divmod(z, cells.positions)
        for error in range(-bins, bins + 1):
            turned = (direction + shift + error) % 8
            share = reliability if error == 0 else (1 - reliability) / (2 * bins)
            expected[z, turned * cells.positions + position] += share
    np.testing.assert_allclose(chain.to_scipy().toarray(), expected, rtol=1e-15, atol=0)
    assert chain.image.shape[0] == 2 * bins + 1
    assert not np.asarray(chain.leaving).any()


@given(GRIDS, st.integers(1, 7))
def test_without_error_persistent_groups_are_the_periodic_groups(free, shift):
    cells = CellSpace.of_grid(free, 8)
    groups = persistent_groups(noisy_bounce_map(cells, 45 * shift * DEGREE, 0.0, 1.0))
    exact = bounce_groups(cells, 45 * shift * DEGREE)
    assert groups.count == int(exact.count)
    np.testing.assert_array_equal(groups.group, np.where(exact.periodic, exact.group, -1))


def time_average(matrix):
    """The distribution of time from a uniform start, by powers of a dense matrix."""
    matrix = (matrix + np.eye(len(matrix))) / 2
    for _ in range(80):
        matrix = matrix @ matrix
        matrix /= matrix.sum(axis=1, keepdims=True)
    return matrix.mean(axis=0)


@pytest.mark.parametrize("motion", [CELL_BY_CELL, ENDPOINT])
def test_policies_agree_with_dense_linear_algebra(motion):
    cells = room()
    bounces = np.radians([45, 90, 225])
    wanted = np.arange(1.0, cells.positions + 1)
    columns, done = [], []
    policy = coverage_policy(
        cells, bounces, math.pi / 4, 0.7, wanted, motion=motion, progress=done.append
    )
    assert done == [1, 2, 3]
    for bounce, got in zip(bounces, policy.limiting, strict=True):
        chain = noisy_bounce_map(cells, float(bounce), math.pi / 4, 0.7, motion=motion)
        average = time_average(chain.to_scipy().toarray())
        np.testing.assert_allclose(got.value, average, atol=1e-12)
        columns.append(average.reshape(8, -1).sum(axis=0))
    A, b = np.stack(columns, axis=1), wanted / wanted.sum()
    np.testing.assert_allclose(policy.coverage, A.T, atol=1e-12)
    np.testing.assert_allclose(policy.target, b, rtol=1e-14)
    least = scipy.optimize.minimize(
        lambda x: 1e3 * np.sum((A @ x - b) ** 2),
        np.full(3, 1 / 3),
        bounds=[(0, 1)] * 3,
        constraints={"type": "eq", "fun": lambda x: x.sum() - 1},
        tol=1e-14,
    )
    assert policy.distance == pytest.approx(np.linalg.norm(A @ least.x - b), rel=1e-7)
    np.testing.assert_allclose(policy.alpha, least.x, atol=1e-4)
    np.testing.assert_allclose(policy.mixture, A @ np.asarray(policy.alpha), rtol=1e-13)
    assert policy.total_variation == pytest.approx(
        np.abs(A @ np.asarray(policy.alpha) - b).sum() / 2
    )


def test_groups_of_an_angle_are_weighted_by_basin_or_by_size():
    # Two rooms without a door.
    free = np.ones((2, 5), bool)
    free[:, 1] = False
    cells = CellSpace.of_grid(free, 8)
    by_basin = coverage_policy(cells, [math.pi / 2], math.pi / 4, 0.5)
    assert by_basin.groups[0].count > 1
    x, _, _ = cells.centre(np.arange(cells.positions))
    assert float(by_basin.mixture[x < 1].sum()) == pytest.approx(2 / 8)
    by_size = coverage_policy(cells, [math.pi / 2], math.pi / 4, 0.5, weights="size")
    group = np.asarray(by_size.groups[0].group).reshape(8, -1)
    share = (group[:, x < 1] >= 0).sum() / (group >= 0).sum()
    assert float(by_size.mixture[x < 1].sum()) == pytest.approx(share)


def test_targets_of_all_kinds_are_normalised():
    cells = room()
    n = cells.positions
    x, y, _ = cells.centre(np.arange(n))
    np.testing.assert_allclose(coverage_target(cells), np.full(n, 1 / n), rtol=1e-14)
    worth = x + 10 * y
    expected = worth / worth.sum()
    np.testing.assert_allclose(coverage_target(cells, worth), expected, rtol=1e-14)
    np.testing.assert_allclose(coverage_target(cells, jnp.asarray(worth)), expected, rtol=1e-14)
    traced = jax.jit(lambda worth: coverage_target(cells, worth))(worth)
    np.testing.assert_allclose(traced, expected, rtol=1e-14)
    np.testing.assert_allclose(coverage_target(cells, lambda x, y: x + 10 * y), expected)
    assert coverage_target(cells, np.full(n, 1e308)).sum() == pytest.approx(1)


def test_an_image_as_a_target_has_its_first_row_at_the_top():
    cells = room()
    image = np.arange(15.0).reshape(3, 5)[::-1]
    worth = np.arange(15.0)[cells.free.ravel()]
    np.testing.assert_allclose(coverage_target(cells, image), worth / worth.sum())
    fine = np.kron(image, np.ones((4, 3)))
    np.testing.assert_allclose(coverage_target(cells, fine), worth / worth.sum())
    coarse = np.array([[1.0, 0.0]])
    x, _, _ = cells.centre(np.arange(cells.positions))
    np.testing.assert_array_equal(coverage_target(cells, coarse) > 0, x < 2.5)


def bad(n, index, value):
    worth = np.ones(n)
    worth[index] = value
    return worth


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (np.ones(4), r"expected 13 numbers, one per position, or an image, got shape \(4,\)"),
        (np.ones((2, 2, 3)), r"got shape \(2, 2, 3\)"),
        (np.ones((0, 3)), r"got shape \(0, 3\)"),
        (np.zeros(13), "0 at all positions"),
        (lambda x, y: 0 * x, "0 at all positions"),
        (lambda x, y: 1.0, r"got shape \(\)"),
        (bad(13, 5, np.nan), r"nan at position 5 \(1.5 m, 1.5 m\)"),
        (bad(13, 0, -1.0), r"-1 at position 0 \(0.5 m, 0.5 m\); expected a finite number from 0"),
        (bad(13, 2, np.inf), "inf at position 2"),
    ],
)
def test_bad_targets_are_refused(target, message):
    with pytest.raises(ValueError, match=f"^target: .*{message}"):
        coverage_target(room(), target)


@pytest.mark.parametrize(
    ("bounce", "error", "reliability", "message"),
    [
        (30, 45, 0.8, "bounce: 30 deg is not a whole number"),
        (45, 30, 0.8, "error: 30 deg is not a whole number of the 8 directions, .* 45 deg apart"),
        (45, -45, 0.8, "error: expected 0 to 135 deg, .* got -45 deg"),
        (45, np.nan, 0.8, "error: nan deg is not"),
        (45, 180, 0.8, "error: expected 0 to 135 deg, so that all turns differ, got 180 deg"),
        (45, 45, 0.0, "reliability: expected more than 0 and at most 1, got 0"),
        (45, 45, -0.5, "reliability: .* got -0.5"),
        (45, 45, 1.01, "reliability: .* got 1.01"),
        (45, 45, np.nan, "reliability: .* got nan"),
        (45, 0, 0.8, "reliability: 0.8 leaves a chance of an error, but the error is 0 deg"),
    ],
)
def test_bad_noise_is_refused(bounce, error, reliability, message):
    with pytest.raises(ValueError, match=message):
        noisy_bounce_map(room(), bounce * DEGREE, float(error * DEGREE), reliability)


def test_bad_angles_are_refused():
    with pytest.raises(ValueError, match="bounces: expected at least one angle, got none"):
        coverage_policy(room(), [], math.pi / 4, 0.5)
    with pytest.raises(ValueError, match="bounces: 405 deg comes twice, as angles 2 and 0"):
        coverage_policy(room(), np.radians([45, 90, 405]), math.pi / 4, 0.5)


def test_the_stand_in_for_the_complex_room_has_its_cells_and_one_group_per_angle():
    room = Workspace.load(bundled("complex"))
    assert CellSpace.of(room, room.cell, room.directions).size == 1464
    cells = CellSpace.of(room, 1.0, 360)
    assert (cells.positions, cells.size) == (183, 65880)
    policy = coverage_policy(cells, np.radians([30, 75, 315]), 5 * DEGREE, 0.8)
    assert [groups.count for groups in policy.groups] == [1, 1, 1]
    assert float(policy.alpha.min()) > 0.1
    for one in policy.limiting:
        assert one.certificate.residual < 1e-10
        assert float(one.value.sum()) == pytest.approx(1, abs=1e-12)


def test_traced_angles_and_probabilities_make_the_chain_of_each():
    cells, error = room(), 90 * DEGREE
    turns = np.array([[0.8, 0.05, 0.05, 0.05, 0.05], [0.4, 0.3, 0.0, 0.2, 0.1]])

    def chain(bounce, reliability):
        return noisy_bounce_map(cells, bounce, error, reliability)

    angles, numbers = jnp.array([45.0, 270.0]) * DEGREE, jnp.array([0.8, 1.0])
    for probability in (numbers, jnp.asarray(turns)):
        found = jax.jit(jax.vmap(chain))(angles, probability)
        for k in range(2):
            one = chain(float(angles[k]), probability[k])
            np.testing.assert_array_equal(found.image[k], one.image)
            np.testing.assert_array_equal(found.probability[k], one.probability)
    same = chain(angles[0], turns[0]), chain(angles[0], 0.8)
    np.testing.assert_allclose(same[0].probability, same[1].probability, rtol=1e-14)


def test_expected_values_have_derivatives_by_the_probabilities_of_turns():
    cells = room()
    worth = np.random.default_rng(0).random(cells.size)

    def mean_square(probability):
        chain = noisy_bounce_map(cells, 135 * DEGREE, 45 * DEGREE, probability)
        return jnp.mean(chain.pull(worth) ** 2)

    jax.test_util.check_grads(mean_square, (0.7,), order=1, modes=["rev", "fwd"], rtol=1e-7)
    step = 1e-5 * np.array([0.0, 1.0, -1.0])
    by_turn = jax.grad(mean_square)(jnp.array([0.6, 0.3, 0.1]))
    more, less = (mean_square(np.array([0.6, 0.3, 0.1]) + sign * step) for sign in (1, -1))
    np.testing.assert_allclose(by_turn @ step, (more - less) / 2, rtol=1e-7)


@pytest.mark.parametrize("turns", [[0.5, 0.5], [0.5, 0.6, -0.1], [0.5, 0.2, 0.2], [0.0, 0.5, 0.5]])
def test_wrong_probabilities_of_turns_are_refused(turns):
    with pytest.raises(ValueError, match="reliability: expected"):
        noisy_bounce_map(room(), 45 * DEGREE, 45 * DEGREE, np.array(turns))


def test_the_distance_from_a_target_has_the_derivative_of_rational_numbers():
    """All turns by one or two right angles are possible, so that all cells are in one group."""
    cells = CellSpace.of_grid(np.array([[1, 1, 1], [1, 0, 1]], bool), directions=4)
    target, small = np.array([1.0, 2.0, 3.0, 4.0, 5.0]), 2.0**-30

    def square(reliability):
        policy = coverage_policy(cells, [math.pi], math.pi / 2, reliability, target)
        return policy.distance**2

    def exact(reliability):
        chain = noisy_bounce_map(cells, math.pi, math.pi / 2, reliability)
        P = chain.to_scipy().toarray()
        inside = np.flatnonzero(np.asarray(persistent_groups(chain).group) == 0)
        size = inside.size
        P = [[exact_chains.rational(p) for p in row] for row in P[np.ix_(inside, inside)]]
        system = [[P[j][i] - int(i == j) for j in range(size)] for i in range(size - 1)]
        system.append([fmpq(1)] * size)
        share = exact_chains.solve(system, [[fmpq(0)]] * (size - 1) + [[fmpq(1)]])
        covered = [fmpq(0)] * 5
        for cell, (x,) in zip(inside.tolist(), share, strict=True):
            covered[cell % 5] += x
        return sum(((x - fmpq(k + 1, 15)) ** 2 for k, x in enumerate(covered)), fmpq(0))

    value, slope = jax.jit(jax.value_and_grad(square))(0.75)
    assert value == pytest.approx(float(exact(0.75)), rel=1e-12)
    difference = exact(0.75 + small) - exact(0.75 - small)
    assert slope == pytest.approx(float(difference) / (2 * small), rel=1e-7)
    bend = exact(0.75 + small) - 2 * exact(0.75) + exact(0.75 - small)
    assert jax.jit(jax.hessian(square))(0.75) == pytest.approx(float(bend) / small**2, rel=1e-7)
    batch = jax.jit(jax.vmap(square))(jnp.array([0.5, 0.75]))
    np.testing.assert_allclose(batch, [float(exact(0.5)), float(exact(0.75))], rtol=1e-12)
