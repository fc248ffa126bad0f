"""Morse sets are compared with CMGDB's published counts, and with brute force."""

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


LESLIE_2 = Box([-0.001] * 2, [90, 70], [1, 1])
LESLIE_3 = Box([-0.001] * 3, [90, 65, 45], [1, 1, 1])
UNPADDED = dynamics.Corners(product)


# CMGDB's benchmarks/references.json and Examples.ipynb: sizes of the sets, and pairs in the order.
@pytest.mark.parametrize(
    ("images", "box", "options", "sizes", "pairs"),
    [
        (
            dynamics.Intervals(leslie, mean_value=False),
            LESLIE_2,
            {"depth": 20, "check": 6},
            [1, 236, 1608, 55100],
            5,
        ),
        (dynamics.Corners(leslie), LESLIE_2, {"depth": 20, "check": 4}, [1, 45372], 1),
        (dynamics.Corners(leslie), LESLIE_3, {"depth": 21, "check": 3}, [1, 16724], 1),
        (UNPADDED, Box([0] * 2, [1.2] * 2, [64] * 2), {}, [1] * 25, 119),
        (UNPADDED, Box([0] * 3, [1.2] * 3, [32] * 3), {}, [1] * 125, 1603),
        (UNPADDED, Box([0] * 2, [1.2] * 2, [16] * 2), {"depth": 6, "check": 4}, [1] * 4, 5),
        (
            dynamics.Corners(logistic, padding=1.0),
            Box([-1], [1], [1024]),
            {},
            [1] * 8 + [6, 6],
            None,
        ),
    ],
    ids=["intervals", "corners", "3-D", "product", "3-D product", "adaptive", "padded"],
)
def test_morse_sets_equal_those_of_cmgdb(images, box, options, sizes, pairs):
    sets = dynamics.morse_sets(images, box, **options)
    assert sorted(sets.boxes.tolist()) == sizes
    assert pairs is None or sets.leads.sum() == pairs
    assert sets.proved == isinstance(images, dynamics.Intervals)


def drift(x, p):
    """A map of an angle and a speed that shifts most points by several turns."""
    return jnp.stack([x[0] + 3 * x[1] + 0.5 * jnp.sin(x[0]), 0.8 * x[1] + 0.3 * jnp.cos(x[0])])


def brute(box, depth, images):
    """Morse sets and their order, by every pair of boxes, in real numbers of turns."""
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
            touched &= np.any(
                [
                    (lower[:, axis] + s * period <= b + edge)
                    & (a - edge <= lower[:, axis] + s * period + width[axis])
                    for s in shifts
                ],
                axis=0,
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
    centre = lower + width / 2
    return {tuple(map(tuple, centre[part].round(9))) for part in sets}, {
        tuple(tuple(centre[k].round(9)) for k in pair) for pair in pairs
    }


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
    sets = dynamics.morse_sets(UNPADDED, Box([0] * 2, [1.2] * 2, [16] * 2), depth=6)
    leads = sets.leads.astype(int)
    assert not ((leads @ leads > 0) & (leads == 0)).any()
    assert (np.triu(leads) == 0).all()
    # The order is the transitive closure of the sets that follow directly.
    graph = nx.DiGraph((a, b) for a, row in enumerate(sets.leads_to) for b in row if b >= 0)
    assert {*nx.transitive_closure(graph).edges} == {*map(tuple, np.argwhere(leads).tolist())}


def test_sets_cover_cycles_and_fixed_points():
    """Every periodic point of Henon's map with a period up to 6 lies in a box of a set."""
    sets = dynamics.morse_sets(dynamics.systems.henon.map, Box([-2, -2], [2, 2], [4, 4]), {"a": 1.4, "b": 0.3}, depth=10)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (2000, 2))
