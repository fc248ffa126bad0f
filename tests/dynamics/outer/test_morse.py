"""Morse sets equal the published counts of CMGDB, and sets by brute force."""

import itertools

import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.space import Box


GROWTH = [19.6, 23.68, 19.6]


def leslie(x, p):
    first = sum(rate * y for rate, y in zip(GROWTH, x, strict=False)) * jnp.exp(-0.1 * sum(x))
    return jnp.stack([first, *(0.7 * x[:-1])])


def product(x, p):
    return x / (2 - x)


def logistic(x, p):
    return 1.4 * x * (1 - x)


def cube(axes, cells):
    return Box([0] * axes, [1.2] * axes, [cells] * axes)


LESLIE_2 = Box([-0.001] * 2, [90, 70], [1, 1])
LESLIE_3 = Box([-0.001] * 3, [90, 65, 45], [1, 1, 1])
CORNERS, UNPADDED = dynamics.Corners(leslie), dynamics.Corners(product)
PADDED, LINE = dynamics.Corners(logistic, padding=1.0), Box([-1], [1], [1024])
# The depth and the check of each search, the sizes of the sets and the number of pairs in their
# order, from benchmarks/references.json and Examples.ipynb of CMGDB.
CMGDB = {
    "intervals": (dynamics.Intervals(leslie, False), LESLIE_2, 20, 6, [1, 236, 1608, 55100], 5),
    "corners": (CORNERS, LESLIE_2, 20, 4, [1, 45372], 1),
    "3-D": (CORNERS, LESLIE_3, 21, 3, [1, 16724], 1),
    "product": (UNPADDED, cube(2, 64), 0, 0, [1] * 25, 119),
    "3-D product": (UNPADDED, cube(3, 32), 0, 0, [1] * 125, 1603),
    "adaptive": (UNPADDED, cube(2, 16), 6, 4, [1] * 4, 5),
    "padded": (PADDED, LINE, 0, 0, [1] * 8 + [6, 6], None),
}


@pytest.mark.parametrize("name", CMGDB)
def test_morse_sets_equal_those_of_cmgdb(name):
    images, box, depth, check, sizes, pairs = CMGDB[name]
    sets = dynamics.morse_sets(images, box, depth=depth, check=check)
    assert sorted(sets.boxes.tolist()) == sizes
    assert pairs is None or sets.leads.sum() == pairs
    assert sets.proved == isinstance(images, dynamics.Intervals)


def drift(x, p):
    """A map of an angle and a speed that shifts most points by several turns."""
    return jnp.stack([x[0] + 3 * x[1] + 0.5 * jnp.sin(x[0]), 0.8 * x[1] + 0.3 * jnp.cos(x[0])])


def brute(box, depth, images):
    """Find Morse sets and their order by every pair of boxes, shifted by whole turns."""
    box = Box(box.lower, box.upper, [n << depth for n in box.cells], box.axes)
    width, low = box.width, np.array(box.lower)
    cells = np.arange(box.size)
    lower = low + box.coordinates(cells) * width
    first, last = images.images(lower, lower + width)
    graph = nx.DiGraph()
    graph.add_nodes_from(cells.tolist())
    for k in cells.tolist():
        touched = np.ones(box.size, bool)
        for axis, kind in enumerate(box.axes):
            a, b = first[k, axis], last[k, axis]
            if kind == "clamp":
                a, b = np.clip([a, b], box.lower[axis], box.upper[axis])
            shifts = range(-60, 61) if kind == "periodic" else [0]
            period = box.upper[axis] - box.lower[axis]
            # Faces and images may differ by rounding, which 1e-9 of a cell exceeds.
            edge = 1e-9 * width[axis]
            starts = [lower[:, axis] + shift * period for shift in shifts]
            touched &= np.any(
                [(at <= b + edge) & (a - edge <= at + width[axis]) for at in starts], axis=0
            )
        graph.add_edges_from((k, int(j)) for j in np.flatnonzero(touched))
    sets = [
        sorted(part)
        for part in nx.strongly_connected_components(graph)
        if len(part) > 1 or graph.has_edge(*[next(iter(part))] * 2)
    ]
    pairs = {
        (a[0], b[0])
        for a, b in itertools.permutations(sets, 2)
        if b[0] in nx.descendants(graph, a[0])
    }
    centre = [tuple(place) for place in (lower + width / 2).round(9)]
    parts = {tuple(centre[k] for k in part) for part in sets}
    return parts, {tuple(centre[k] for k in pair) for pair in pairs}


@pytest.mark.parametrize("axes", ["sink", "clamp", ["periodic", "sink"], ["clamp", "periodic"]])
@pytest.mark.parametrize("depth", [0, 2])
def test_morse_sets_equal_brute_force(axes, depth):
    """Subdivision drops no box that brute force on all small boxes finds recurrent."""
    cells = [12, 10] if depth == 0 else [6, 5]
    box = Box([-np.pi, -1.5], [np.pi, 1.5], cells, axes)
    images = dynamics.Intervals(drift)
    sets = dynamics.morse_sets(images, box, depth=depth)
    wanted, pairs = brute(box, depth // 2, images)
    centre = ((sets.lower + sets.upper) / 2).round(9)
    ours = [tuple(map(tuple, centre[sets.member == k])) for k in range(sets.sets)]
    assert {tuple(sorted(part)) for part in ours} == {tuple(sorted(part)) for part in wanted}
    first = [min(part) for part in ours]
    known = {(first[a], first[b]) for a, b in np.argwhere(sets.leads)}
    # The order of subdivision has every pair, and may have more.
    named = {min(part): part for part in wanted}
    assert {tuple(min(p for p in named if k in named[p]) for k in pair) for pair in pairs} <= known
    assert depth or len(known) == len(pairs)


def test_order_is_transitive_and_sets_that_end_orbits_come_first():
    sets = dynamics.morse_sets(UNPADDED, cube(2, 16), depth=6)
    leads = sets.leads.astype(int)
    assert not ((leads @ leads > 0) & (leads == 0)).any()
    assert (np.triu(leads) == 0).all()
    # The order is the transitive closure of the sets that follow directly.
    graph = nx.DiGraph((a, b) for a, row in enumerate(sets.leads_to) for b in row if b >= 0)
    assert {*nx.transitive_closure(graph).edges} == {*map(tuple, np.argwhere(leads).tolist())}


def henon(x, p):
    return jnp.stack([1 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]])


HENON = Box([-2, -2], [2, 2], [4, 4])


def members(sets, points):
    """The set of each point, -1 for none; a face belongs to both sides."""
    inside = (sets.lower <= points[:, None]) & (points[:, None] <= sets.upper)
    box = inside.all(axis=-1)
    return np.where(box.any(axis=1), sets.member[box.argmax(axis=1)], -1)


def test_sets_contain_periodic_points_and_the_attractor():
    sets = dynamics.morse_sets(henon, HENON, depth=16)
    fixed = np.array([(-0.7 + s * np.sqrt(0.49 + 5.6)) / 2.8 for s in (1, -1)])
    found = members(sets, np.stack([fixed, 0.3 * fixed], axis=1))
    assert (found >= 0).all()
    # The second one is a saddle outside the attractor, whose unstable set leads to it.
    assert sets.leads[found[1], found[0]]
    x, orbit = np.array([0.1, 0.1]), []
    for k in range(2000):
        x = np.array([1 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]])
        orbit += [x] if k > 100 else []
    assert (members(sets, np.array(orbit)) == found[0]).all()
    assert sets.leads_to[found[0]].max() == -1
    assert sets.share.sum() < 0.01


def test_images_of_samples_contain_images_of_boxes():
    """The bound of slopes holds on the box, and the samples are enough for the same sets."""
    axis = np.linspace(-2, 2, 161)
    points = np.array(list(itertools.product(axis, axis)))
    values = np.stack([1 - 1.4 * points[:, 0] ** 2 + points[:, 1], 0.3 * points[:, 0]], axis=1)
    samples = dynamics.Samples(points, values, np.array([[5.6, 1.0], [0.3, 0.0]]))
    rng = np.random.default_rng(0)
    lower = rng.uniform(-2, 1.9, (200, 2))
    images, wanted = (
        outer.images(lower, lower + 0.1) for outer in (samples, dynamics.Intervals(henon))
    )
    inner = dynamics.Corners(henon, points=5).images(lower, lower + 0.1)
    assert (images[0] <= inner[0]).all()
    assert (inner[1] <= images[1]).all()
    assert np.median(images[1] - images[0]) < 8 * np.median(wanted[1] - wanted[0])
    sets = dynamics.morse_sets(samples, HENON, depth=6)
    exact = dynamics.morse_sets(henon, HENON, depth=6)
    assert (members(sets, (exact.lower + exact.upper) / 2) >= 0).all()
    assert sets.proved
    assert "lipschitz" in sets.remarks[0]


@pytest.mark.parametrize(
    ("arguments", "depth", "message"),
    [
        ((henon, HENON), -1, "depth: expected a whole number from 0"),
        ((henon, Box([0], [1], [4])), 0, "map: "),
        ((lambda x, p: p * x, HENON, np.float64(np.inf)), 0, "expected finite numbers"),
        ((lambda x, p: x, Box([1], [1 + 1e-15], [1])), 4, "bisections leave cells without width"),
    ],
)
def test_wrong_input_is_refused(arguments, depth, message):
    with pytest.raises(ValueError, match=message):
        dynamics.morse_sets(*arguments, depth=depth)


def test_samples_that_contradict_the_bound_are_refused():
    with pytest.raises(ValueError, match="finite"):
        dynamics.Samples(np.zeros((1, 1)), np.full((1, 1), np.nan), 1.0)
    message = "samples 0 and 1 contradict the bound: along axis 0 images differ by 0.5 more"
    with pytest.raises(ValueError, match=message):
        dynamics.Samples(np.array([[0.0], [1.0]]), np.array([[0.0], [2.0]]), 1.5)


def test_graph_that_exceeds_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr("jaxcell.base.memory.free", lambda: 10**8)
    box = Box([-1] * 2, [1] * 2, [64] * 2)
    with pytest.raises(MemoryError, match="the graph of images needs about"):
        dynamics.morse_sets(lambda x, p: jnp.sin(200 * x), box, depth=2)


def test_map_that_leaves_the_box_has_no_sets():
    sets = dynamics.morse_sets(lambda x, p: x + 3, Box([0], [1], [8]), depth=2)
    assert (sets.sets, sets.boxes.size, sets.leads_to.shape) == (0, 0, (0, 1))
    assert sets.drawn.max() == -1


def test_spurious_sets_are_left_out_by_a_test():
    """A slow passage through a gap looks recurrent to coarse boxes."""

    def passage(x, p):
        return x + 0.02 + x * x / 2

    box = Box([-1], [1], [8])
    assert dynamics.morse_sets(passage, box).sets > 0
    assert dynamics.morse_sets(passage, box, check=8).sets == 0
    assert dynamics.morse_sets(passage, box, check=8, limit=1).sets > 0
