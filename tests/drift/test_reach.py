import dataclasses

import jax
import networkx as nx
import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, strategies as st
from random_chains import matrices, reachable as closure
from small_seas import random_layers, random_sea

from jaxcell.drift.layered_cells import Sea
from jaxcell.drift.reachability import reachable, reachable_at_depth, reachable_by_layer
from jaxcell.examples import water
from jaxcell.mapping import Chain, ChainSequence


seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_layers_are_combined_in_order(seed):
    waters, chains = random_layers(seed)
    sea = Sea.of(waters, chains)
    place = [
        (layer, row, column)
        for layer, here in enumerate(waters)
        for row, column in np.argwhere(here.number >= 0).tolist()
    ]
    number = {at: z for z, at in enumerate(place)}
    assert sea.cells == sea.drift.cells == len(place)
    for z, (layer, row, column) in enumerate(place):
        assert sea.layer[z] == layer
        assert sea.above[z] == number.get((layer - 1, row, column), -1)
        assert sea.below[z] == number.get((layer + 1, row, column), -1)
    blocks = scipy.sparse.block_diag([chain.to_scipy() for chain in chains])
    np.testing.assert_array_equal(sea.drift.to_scipy().toarray(), blocks.toarray())


def test_reachable_in_a_program_is_the_closure():
    random = np.random.default_rng(3)
    P = np.triu(random.random((3, 6, 6)) < 0.3) / 6.0
    starts = random.random((3, 6)) < 0.3
    starts[:, 0] = True
    found = jax.jit(jax.vmap(lambda P, start: reachable(Chain.from_scipy(P), start)))(P, starts)
    for one, matrix, start in zip(found, P, starts, strict=True):
        np.testing.assert_array_equal(one, closure(matrix)[start].any(axis=0))


@given(matrices(), st.data())
def test_reachable_is_the_closure(matrix, data):
    start = data.draw(st.integers(0, len(matrix) - 1))
    np.testing.assert_array_equal(
        reachable(Chain.from_scipy(matrix), start), closure(matrix)[start]
    )


def graph_of(sea, vertical):
    graph = nx.DiGraph()
    graph.add_nodes_from(range(sea.cells))
    graph.add_edges_from(zip(*sea.drift.to_scipy().nonzero(), strict=True))
    if vertical:
        for to in (sea.above, sea.below):
            graph.add_edges_from((z, to[z]) for z in np.flatnonzero(to >= 0))
    return graph


@given(seeds)
def test_reachable_cells_are_those_of_a_graph_search(seed):
    sea = random_sea(seed, leak=0.1)
    start = int(np.random.default_rng(seed).integers(np.count_nonzero(sea.layer == 0)))
    column, at = [], start
    while at >= 0:
        column.append(at)
        at = int(sea.below[at])
    drift = graph_of(sea, vertical=False)
    expected = set(column).union(*(nx.descendants(drift, z) for z in column))
    assert set(np.flatnonzero(reachable_by_layer(sea, start))) == expected
    free = {start} | nx.descendants(graph_of(sea, vertical=True), start)
    assert set(np.flatnonzero(reachable_at_depth(sea, start))) == free
    assert expected <= free


@pytest.mark.parametrize("search", [reachable_by_layer, reachable_at_depth])
@pytest.mark.parametrize("off", [-1, 0])
def test_starts_that_are_not_at_the_surface_are_refused(search, off):
    sea = random_sea(0)
    start = off if off < 0 else int(np.count_nonzero(sea.layer == 0))
    with pytest.raises(ValueError, match=f"cell {start} is not at the surface, which has"):
        search(sea, start)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        (lambda w, c: (w, c[:2]), "got 2 for 3 layers"),
        (lambda w, c: (w, [c[0], c[0], c[2]]), "that of layer 1 has"),
        (lambda w, c: ([w[0], water(np.ones((2, 2), bool))], c[:2]), "layer 1 has"),
        (lambda w, c: ([w[0], dataclasses.replace(w[1], wraps=True)], c[:2]),
         "layers 0 and 1: only one of them goes round the Earth"),
        (lambda w, c: (w[:2], [c[0], ChainSequence.of([c[1], c[1]])]),
         r"as many phases in each layer, got \[1, 2\]"),
    ],
)  # fmt: skip
def test_layers_of_different_seas_are_refused(layers, message):
    with pytest.raises(ValueError, match=message):
        Sea.of(*layers(*random_layers(0)))
