import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.space import Box


KINDS = st.sampled_from(["sink", "periodic", "clamp"])


@st.composite
def boxes(draw):
    axes = draw(st.integers(1, 4))
    lower = draw(st.lists(st.floats(-100, 100), min_size=axes, max_size=axes))
    size = draw(st.lists(st.floats(0.1, 50), min_size=axes, max_size=axes))
    cells = draw(st.lists(st.integers(1, 7), min_size=axes, max_size=axes))
    kinds = draw(st.lists(KINDS, min_size=axes, max_size=axes))
    return lower, np.add(lower, size), cells, kinds


@given(boxes())
def test_centre_of_a_cell_is_in_the_cell(corners):
    box = Box(*corners)
    cells = np.arange(box.size, dtype=np.int32)
    assert (box.index(box.centre(cells)) == cells).all()
    assert (np.ravel_multi_index(box.coordinates(cells).T, box.cells) == cells).all()


@given(boxes(), st.data())
def test_cells_of_points_equal_numpy(corners, data):
    box = Box(*corners)
    place = np.array(
        data.draw(st.lists(st.floats(-3, 9), min_size=box.dimensions, max_size=box.dimensions))
    )
    point = np.array(box.lower) + place * box.width
    expected, inside = [], True
    for at, count, kind in zip(np.floor(place + 1e-9), box.cells, box.axes, strict=True):
        if kind == "periodic":
            at = at % count
        elif kind == "clamp":
            at = min(max(at, 0), count - 1)
        inside &= 0 <= at < count
        expected.append(int(at))
    # Rounding decides the cell of a place at an edge.
    if (np.abs(place - np.round(place) + 1e-9) < 1e-10).any():
        return
    found = int(box.index(point))
    assert found == (np.ravel_multi_index(expected, box.cells) if inside else box.outside)


def test_edge_belongs_to_the_upper_cell_and_the_last_edge_is_outside():
    box = Box([0], [1], [10])
    edges = np.linspace(0, 1, 11)[:, None]
    assert box.index(edges).tolist() == list(range(11))
    assert box.index(edges - 1e-11).tolist() == list(range(11))
    assert box.index(np.array([[-1e-11], [-1e-3], [np.inf], [np.nan]])).tolist() == [0, 10, 11, 11]


def test_numpy_and_jax_agree_under_jit_and_vmap():
    box = Box([-1, 0], [1, 5], [3, 4], ["periodic", "clamp"])
    points = np.random.default_rng(0).uniform(-9, 9, (50, 2))
    for index in (box.index, jax.vmap(box.index)):
        np.testing.assert_array_equal(jax.jit(index)(points), box.index(points))
    cells = np.arange(12, dtype=np.int32)
    centres = jax.jit(jax.vmap(box.centre))(cells)
    np.testing.assert_array_equal(centres, box.centre(cells))
    assert jax.eval_shape(lambda at: box.centre(at, jnp.float32), cells).dtype == jnp.float32


def test_distance_on_periodic_axes_is_the_shorter_one():
    box = Box([0, 0], [1, 5], [10, 10], ["periodic", "sink"])
    assert box.apart(np.array([[7, 7], [-12, -9], [5, 0]])).tolist() == [[3, 7], [2, 9], [5, 0]]
    np.testing.assert_allclose(jax.jit(box.apart)(np.array([9.5, 9.5])), [0.5, 9.5])


def test_far_points_do_not_overflow():
    box = Box([0, 0], [1, 1], [4, 4], ["clamp", "sink"])
    assert box.index(np.array([[1e300, 0.5], [-1e300, 0.5], [0.5, -1e300]])).tolist() == [14, 2, 16]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0], [1, 0], [2, 2]), "axis 1 goes from 0 to 0: no volume"),
        (([0], [np.inf], [2]), "no volume"),
        (([0, 0], [1, 1], [2]), "got 2, 2, 1 and 2"),
        (([0], [1], [0]), "axis 0 has 0"),
        (([0] * 4, [1] * 4, [1000] * 4), "more than the 2,147,483,646"),
    ],
)
def test_bad_boxes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message) as refused:
        Box(*arguments)
    assert "\n" not in str(refused.value)
