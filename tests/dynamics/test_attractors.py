"""Attractors of maps that have many groups, or keep volumes and have none."""

import itertools

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.dynamics import attractors
from jaxcell.dynamics.basin import basins_of_each
from jaxcell.dynamics.merging import merged
from jaxcell.space import Box


def quarter_turn(x, p):
    return jnp.stack([-x[1], x[0]])


def standard(x, p):
    speed = x[1] + 0.9 * jnp.sin(x[0])
    return jnp.stack([x[0] + speed, speed])


def cat(x, p):
    return jnp.stack([2 * x[0] + x[1], x[0] + x[1]])


TORUS = Box([0, 0], [1, 1], [30, 30], "periodic")
KEEPING = {
    "quarter turn": (quarter_turn, Box([-1, -1], [1, 1], [20, 20])),
    "standard": (standard, Box([0, 0], [2 * np.pi, 2 * np.pi], [24, 24], "periodic")),
    "cat": (cat, TORUS),
}


@pytest.mark.parametrize("name", KEEPING)
def test_groups_of_volume_preserving_maps_equal_brute_force(name):
    map, box = KEEPING[name]
    basins = dynamics.basins(map, box)
    image = []
    points = jax.jit(jax.vmap(lambda x: map(x, None)))(box.centre(np.arange(box.size)))
    for point in np.asarray(points):
        place = np.floor((point - box.lower) / box.width + 1e-9).astype(int) % box.cells
        image.append(int(np.ravel_multi_index(place, box.cells)))
    assert basins.image.tolist() == image
    graph = nx.DiGraph(enumerate(image))
    cycles = sorted(nx.simple_cycles(graph), key=min)
    assert basins.group_period.tolist() == [len(cycle) for cycle in cycles]
    assert set(np.flatnonzero(basins.step == 0)) == set(itertools.chain(*cycles))
    for number, cycle in enumerate(cycles):
        assert set(np.flatnonzero(basins.group == number)) == nx.ancestors(graph, cycle[0]) | {
            *cycle
        }
    keeps = any("preserve volumes" in remark for remark in basins.remarks)
    assert keeps == (name != "standard")


def test_orbits_on_a_torus_keep_their_fractions():
    # Coordinates that are not wrapped would have 130 digits after the first mappings.
    basins = dynamics.basins(cat, TORUS)
    assert basins.attractors == 1
    assert basins.outside_share == basins.nowhere_share == 0
    assert (basins.orbit >= 0).all()
    assert (basins.orbit <= 1).all()
    assert np.unique(np.floor(4 * basins.orbit[0]), axis=0).shape[0] == 16
    # Basins by orbits wrap coordinates, too.
    by_orbits = dynamics.basins(cat, TORUS, by="orbits")
    assert (by_orbits.basin == 0).all()


def test_merged_orbits_equal_merging_of_all_pairs():
    box = Box([0, 0], [1, 1], [9, 9], ["periodic", "sink"])
    orbit = np.random.default_rng(0).uniform([-1, 0], [2, 1], (15, 2, 2))
    meet = nx.Graph()
    meet.add_nodes_from(range(15))
    for shift in itertools.product((0, 0.5), repeat=2):
        part = np.floor(orbit * 18 + shift) % [18, 100]
        for one, other in itertools.combinations(range(15), 2):
            if (part[one][:, None] == part[other]).all(axis=-1).any():
                meet.add_edge(one, other)
    expected = sorted(map(sorted, nx.connected_components(meet)))
    assert 1 < len(expected) < 15
    label = merged(box, orbit, 0)
    assert sorted(np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)) == expected


def test_groups_without_orbits_get_the_attractors_of_their_cells(monkeypatch):
    # A step is shorter than half a cell around the middle, where each cell is a group.
    box = Box([-1], [1], [40])
    slow = dynamics.flow(lambda x, p: -x, 0.1, 1)
    all_of_them = dynamics.basins(slow, box)
    monkeypatch.setattr(attractors, "MAX_GROUPS", 3)
    few = dynamics.basins(slow, box)
    assert few.groups == all_of_them.groups > 6
    assert all_of_them.basin.tolist() == few.basin.tolist() == [0] * 40


def test_groups_that_reach_no_known_attractor_are_reported(monkeypatch):
    # Only two of eight wells are followed, and one orbit starts elsewhere.
    box = Box([0], [8], [80])

    def wells(x, p):
        return jnp.floor(x) + 0.5 + 0.3 * (x - jnp.floor(x) - 0.5)

    assert dynamics.basins(wells, box).attractors == 8
    monkeypatch.setattr(attractors, "MAX_GROUPS", 2)
    (few,) = basins_of_each(wells, box, [None], scattered=1, seed=1)
    assert few.attractors < 8
    assert few.nowhere_share == 1 - few.attractors / 8
    assert few.outside_share == 0
    assert any("reach none of these attractors" in remark for remark in few.remarks)


def test_remarks_on_single_attractors_are_limited():
    box = Box([-1, -1], [1, 1], [40, 40])
    turn = dynamics.basins(quarter_turn, box)
    assert turn.attractors > 400
    assert len(turn.remarks) < 10


def test_orbits_that_diverge_lead_nowhere():

    def fades(x, p):
        return jnp.where(jnp.abs(x) > 1e-3, x / 2, jnp.nan)

    def grows(x, p):
        return 1.5 * x

    box = Box([-1], [1], [21])
    for map, shares in ((fades, (0, 1)), (grows, (1, 0))):
        basins = dynamics.basins(map, box, {})
        assert (basins.attractors, basins.outside_share, basins.nowhere_share) == (0, *shares)


def test_transient_chaos_is_followed_to_its_cycle():
    def ikeda(x, p):
        turn = 0.4 - 6 / (1 + x @ x)
        cosine, sine = jnp.cos(turn), jnp.sin(turn)
        return jnp.stack(
            [1 + 0.85 * (x[0] * cosine - x[1] * sine), 0.85 * (x[0] * sine + x[1] * cosine)]
        )

    basins = dynamics.basins(ikeda, Box([-2, -4], [6, 4], [201, 201]))
    assert basins.settled
    assert basins.period.tolist() == [1, 10]


def test_remark_names_cells_that_agree_with_orbits():
    # The boundary is in the middle of a cell, and cells of half the width end there.
    def edge(x, p):
        return jnp.where(x > 0.3, 0.9, 0.1)

    coarse = dynamics.basins(edge, Box([0], [1], [5]))
    assert coarse.trial.wrong[0] == pytest.approx(0.1, abs=0.03)
    assert coarse.trial.cells == (10,)
    (remark,) = (each for each in coarse.remarks if "random starts end elsewhere" in each)
    assert "with cells of half and a quarter of the width, 0% and 0% of 1,024" in remark
    assert "take basins by orbits, which agree, or about 10 cells, which would leave 2%." in remark
    fine = dynamics.basins(edge, Box([0], [1], [10]))
    assert (fine.disagreement, fine.trial) == (0, None)


def test_disagreement_of_finer_cells_is_that_of_a_finer_box():
    def pendulum(x, p):
        return jnp.stack([x[1], 0.5 - 0.3 * x[1] - jnp.sin(x[0])])

    flow, axes = dynamics.flow(pendulum, 0.1, 5), ["periodic", "sink"]

    def of(cells, by="cells"):
        box = Box([-np.pi, -3], [np.pi, 5], [cells, cells], axes)
        return dynamics.basins(flow, box, by=by)

    coarse, truth = of(16), of(64, "orbits")
    centres = truth.box.centre(np.arange(truth.box.size))
    wrong = [
        np.mean(b.basin[b.box.index(centres)] != truth.basin) for b in (coarse, of(32), of(64))
    ]
    assert wrong[0] > 0.06
    # 1,024 points are drawn.
    np.testing.assert_allclose(coarse.trial.wrong, wrong, atol=0.03)


def test_a_cycle_begins_with_its_lowest_point_from_any_starts():
    x = 0.3
    for _ in range(10_000):
        x = 3.5 * x * (1 - x)
    orbit = [x := 3.5 * x * (1 - x) for _ in range(4)]
    lowest = orbit.index(min(orbit))
    for seed in range(8):
        basins = dynamics.basins(lambda x, p: 3.5 * x * (1 - x), Box([0], [1], [64]), seed=seed)
        begun = basins.orbit[0, :4, 0]
        np.testing.assert_allclose(begun, orbit[lowest:] + orbit[:lowest], rtol=1e-12)
