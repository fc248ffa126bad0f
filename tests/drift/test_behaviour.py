import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from seas import double_gyre, sea, seas

from jaxcell import examples
from jaxcell.base import memory
from jaxcell.base.certificate import Outcome
from jaxcell.drift.behaviour import long_term_behaviour
from jaxcell.drift.flow import Flow, crossing_time
from jaxcell.drift.maps import drift_map, drift_maps, flow_map
from jaxcell.drift.results.ends import LayerEnds
from jaxcell.drift.step import METHODS, DriftStep
from jaxcell.drift.validation.diagnosis import diagnose, group_counts
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain, persistent_groups


OFF = "off the grid"


class Loops:
    """A drift map by the definition, one cell after the other, with dictionaries."""

    def __init__(self, currents):
        self.wet = currents["water"].values[0]
        self.dx, self.dy = currents["dx"].values, currents["dy"].values
        self.rate = currents["u"].values[0, 0] / self.dx, currents["v"].values[0, 0] / self.dy
        self.rows, self.columns = self.wet.shape
        graph = nx.Graph()
        squares = [(r, c) for r in range(self.rows) for c in range(self.columns) if self.wet[r, c]]
        self.number = {square: k for k, square in enumerate(squares)}
        graph.add_nodes_from(squares)
        graph.add_edges_from((s, n) for s in squares for n in self.around(s) if n in self.number)
        self.piece = {s: k for k, part in enumerate(nx.connected_components(graph)) for s in part}

    def around(self, square):
        r, c = square
        return [(r + i, c + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]

    def on_grid(self, square):
        return 0 <= square[0] < self.rows and 0 <= square[1] < self.columns

    def land(self, origin, x, y, exits):
        square = math.floor(round(y + 0.5, 9)), math.floor(round(x + 0.5, 9))
        if exits and not self.on_grid(square):
            return OFF
        piece = self.piece[origin]
        if self.piece.get(square) == piece:
            return square
        dx, dy = self.dx[origin], self.dy[origin]
        own = [s for s in self.number if self.piece[s] == piece]
        return min(own, key=lambda s: (round(math.hypot((s[1] - x) * dx, (s[0] - y) * dy), 6), s))

    def spread(self, origin, spread, exits, samples):
        """The images with their weights, the first that of the centre."""
        r, c = origin
        right, up = self.rate[0][origin], self.rate[1][origin]
        if spread == "turned":
            dx, dy = self.dx[origin], self.dy[origin]
            for angle in (0, math.pi / 4, -math.pi / 4):
                turned = complex(right * dx, up * dy) * complex(math.cos(angle), math.sin(angle))
                yield self.land(origin, c + turned.real / dx, r + turned.imag / dy, exits)
        else:
            image = self.land(origin, c + right, r + up, exits)
            yield image
            if image == OFF:
                image = math.floor(round(r + up + 0.5, 9)), math.floor(round(c + right + 0.5, 9))
            for other in self.around(image):
                if not self.on_grid(other):
                    if exits:
                        yield OFF
                elif self.piece.get(other) == self.piece[origin]:
                    yield other

    def matrix(self, spread, rho, edge, samples=0):
        exits = edge == "exit"
        matrix = np.zeros((len(self.number), len(self.number) + 1))
        number = {**self.number, OFF: len(self.number)}
        for origin, cell in self.number.items():
            near = [s for s in self.around(origin) if s in self.number]
            if not exits and len(near) < 8:
                for image in [origin, *near]:
                    matrix[cell, number[image]] = 1 / (1 + len(near))
                continue
            images = list(self.spread(origin, spread, exits, samples))
            others = set(images) - {images[0]}
            matrix[cell, number[images[0]]] = rho if others else 1
            for image in others:
                matrix[cell, number[image]] = (1 - rho) / len(others)
        return matrix


@given(seas(), st.sampled_from(["turned", "all"]), st.sampled_from(["uniform", "exit"]), st.data())
def test_equals_the_definition(currents, spread, edge, data):
    rho = data.draw(st.sampled_from([0.0, 0.3, 0.8, 1.0]))
    water, flow = Water.of(currents), Flow.of(currents)
    chain = drift_map(water, flow, DriftStep(1.0, rho=rho, spread=spread, edge=edge))
    expected = Loops(currents).matrix(spread, rho, edge)
    np.testing.assert_allclose(chain.to_scipy().toarray(), expected[:, :-1], atol=1e-12)
    np.testing.assert_allclose(chain.leaving, expected[:, -1], atol=1e-12)
    total = np.asarray(chain.probability).sum(axis=0) + np.asarray(chain.leaving)
    np.testing.assert_allclose(total, 1, atol=1e-12)


@given(seas(), st.sampled_from(["uniform", "exit"]), st.integers(1, 3))
def test_sampled_counts_points(currents, edge, samples):
    water, flow = Water.of(currents), Flow.of(currents)
    chain = drift_map(water, flow, DriftStep(1.0, spread="sampled", samples=samples, edge=edge))
    expected = np.zeros((water.cells, water.cells + 1))
    places = (np.arange(samples) + 0.5) / samples - 0.5
    along = [np.asarray(axis) for axis in flow.rate[0]]

    def rate(x, y):
        """Between centres, from the four around; off the grid that of its edge."""
        x, y = np.clip(x, 0, along[0].shape[1] - 1), np.clip(y, 0, along[0].shape[0] - 1)
        column, row = math.floor(x), math.floor(y)
        total = np.zeros(2)
        for i in (0, 1):
            for j in (0, 1):
                share = abs(1 - j - (x - column)) * abs(1 - i - (y - row))
                if share:
                    total += share * np.array([a[row + i, column + j] for a in along])
        return total

    for cell in range(water.cells):
        near = water.neighbor[:, cell][water.neighbor[:, cell] >= 0]
        if edge == "uniform" and near.size < 8:
            expected[cell, [cell, *near]] = 1 / (1 + near.size)
            continue
        for up in places:
            for right in places:
                x, y = water.column[cell] + right, water.row[cell] + up
                end = np.array([x, y]) + rate(x, y)
                origin = np.array([cell])
                image = water.landing(
                    end[:1, None], end[1:, None], origin=origin, exits=edge == "exit"
                )
                expected[cell, image[0, 0]] += 1 / samples**2
    found = chain.to_scipy().toarray()
    np.testing.assert_allclose(found, expected[:, :-1], atol=1e-12)
    np.testing.assert_allclose(chain.leaving, expected[:, -1], atol=1e-12)


def test_uniform_current_with_an_exit():
    # Two cells a step to the East: the third step is off a grid of five columns at the latest.
    currents = sea(np.full((3, 5), 2.0), np.zeros((3, 5)), dx=1.0, dy=1.0)
    chain = drift_map(Water.of(currents), Flow.of(currents), DriftStep(1.0, rho=1.0, edge="exit"))
    found = long_term_behaviour(chain, 3600)
    assert found.groups.count == 0
    assert found.transient.domiciles == ((-1,),)
    assert found.hours.tolist() == [3, 2, 2, 1, 1] * 3
    assert found.basin.tolist() == [-1] * 15
    assert found.probability.leaving.tolist() == [1] * 15


def test_a_turned_current_reaches_three_cells():
    currents = sea(np.full((5, 5), 2.0), np.zeros((5, 5)), dx=1.0, dy=1.0)
    chain = drift_map(Water.of(currents), Flow.of(currents), DriftStep(1.0, rho=0.6, edge="exit"))
    # From the middle: two to the East, or sqrt(2) to the East and as far to either side.
    row = chain.to_scipy().toarray()[12]
    assert {int(cell): round(row[cell], 12) for cell in np.flatnonzero(row)} == {
        14: 0.6,
        8: 0.2,
        18: 0.2,
    }


@given(seas(), st.sampled_from(["turned", "all"]), st.sampled_from(["uniform", "exit"]))
def test_behaviour_equals_the_definition(currents, spread, edge):
    water, flow = Water.of(currents), Flow.of(currents)
    chain = drift_map(water, flow, DriftStep(1.0, spread=spread, edge=edge))
    found = long_term_behaviour(chain, 1800)
    matrix = chain.to_scipy().toarray()
    graph = nx.from_numpy_array(matrix, create_using=nx.DiGraph)
    graph.add_edges_from((int(c), -1) for c in np.flatnonzero(np.asarray(chain.leaving) > 0))
    ends = [s for s in nx.strongly_connected_components(graph) if not nx.node_boundary(graph, s)]
    groups = sorted((s for s in ends if -1 not in s), key=min)
    group = np.asarray(found.groups.group)
    assert found.groups.count == len(groups)
    reach = nx.transitive_closure(graph, reflexive=True)
    for cell in range(water.cells):
        homes = [k for k, cells in enumerate(groups) if reach.has_edge(cell, min(cells))]
        if reach.has_edge(cell, -1):
            homes.insert(0, -1)
        if group[cell] >= 0:
            assert homes == [group[cell]]
            assert found.transient.group[cell] == -1
            assert found.basin[cell] == group[cell]
        else:
            assert found.transient.domiciles[int(found.transient.group[cell])] == tuple(homes)
            assert found.basin[cell] == (homes[0] if len(homes) == 1 else -1)
    q = matrix[group < 0][:, group < 0]
    times = np.linalg.solve(np.eye(len(q)) - q, np.ones(len(q)))
    np.testing.assert_allclose(np.asarray(found.hours)[group < 0], times / 2, rtol=1e-8)
    np.testing.assert_allclose(
        np.asarray(found.probability.value).sum(axis=0) + np.asarray(found.probability.leaving), 1
    )
    assert float(found.limiting.value.sum()) + found.limiting.leaving == pytest.approx(1)


def test_the_double_gyre_has_a_group_in_each_gyre_and_a_border_between_them():
    currents = double_gyre(21, 42, inward=1.0)
    water, flow = Water.of(currents), Flow.of(currents)
    duration = 3 * crossing_time(water, flow)
    options = {"method": "rk4", "substeps": 4}
    found = long_term_behaviour(drift_map(water, flow, DriftStep(duration, **options)), duration)
    group = water.on_grid(np.asarray(found.groups.group), -1)
    # The middles of the gyres, to which the water goes.
    assert np.argwhere(group >= 0).tolist() == [[10, 10], [10, 31]]
    # As in section 5.5: two persistent groups, and transient groups of one and of both.
    assert found.transient.domiciles == ((0,), (1,), (0, 1))
    assert found.transient.single.tolist() == [True, True, False]
    column = water.column
    kind, hours = np.asarray(found.transient.group), np.asarray(found.hours)
    assert column[kind == 0].max() < 21 <= column[kind == 1].min()
    # As in Figure 5.8, from between the domains it takes longest.
    assert hours[kind == 2].mean() > max(hours[kind == k].mean() for k in (0, 1))
    # The two gyres are alike.
    np.testing.assert_allclose(found.limiting.weights, 0.5, atol=1e-9)
    check = diagnose(water, flow, found.groups, DriftStep(duration, **options))
    assert check.warning is None
    shift = np.hypot(*np.asarray(flow_map(water, flow, DriftStep(duration, **options))))
    assert check.mean_shift == pytest.approx(shift.mean())


def test_a_short_step_is_warned_of():
    currents = double_gyre()
    water, flow = Water.of(currents), Flow.of(currents)
    duration = crossing_time(water, flow) / 3
    groups = persistent_groups(drift_map(water, flow, DriftStep(duration, rho=1.0)))
    check = diagnose(water, flow, groups, DriftStep(duration))
    assert check.self_image > 0.5
    assert check.locked > 50
    assert check.warning is not None
    assert "are mapped to themselves: the grid, and not the water" in check.warning
    shift = np.hypot(*np.asarray(flow_map(water, flow, DriftStep(duration))))
    assert check.mean_shift == pytest.approx(shift.mean())


def test_many_groups_of_one_cell_are_warned_of():
    currents = double_gyre(inward=0.0)
    water, flow = Water.of(currents), Flow.of(currents)
    step = DriftStep(1.2 * crossing_time(water, flow))
    check = diagnose(water, flow, persistent_groups(drift_map(water, flow, step)), step)
    assert check.self_image < 0.5
    assert check.warning is not None
    assert "persistent groups are cells that water flows out of" in check.warning


def test_groups_of_one_cell_may_be_where_the_current_runs_ashore():
    """All drifters end in the cell of their row that is nearest to the land."""
    wet = np.arange(8) < np.full((5, 1), 7)
    currents = sea(0.5 * wet, np.zeros(wet.shape), wet, dx=1.0, dy=1.0)
    water, flow = Water.of(currents), Flow.of(currents)
    options = {"method": "rk4", "substeps": 4}
    groups = persistent_groups(
        drift_map(water, flow, DriftStep(4.0, spread="sampled", edge="exit", **options))
    )
    assert water.column[np.asarray(groups.group) >= 0].tolist() == [6] * 5
    check = diagnose(water, flow, groups, DriftStep(4.0, **options))
    assert (check.locked, check.ashore, check.warning) == (0, 5, None)


def test_pieces_of_water_are_told_apart():
    wet = np.ones((6, 9), bool)
    wet[:, 4] = False
    wet[0, 5] = True
    wet[0:2, 6:] = wet[1, 5] = False
    nothing = np.full((6, 9), 0.1)
    currents = sea(nothing, nothing, wet, dx=1.0, dy=1.0)
    water, flow = Water.of(currents), Flow.of(currents)
    groups = persistent_groups(drift_map(water, flow, DriftStep(1.0, spread="all")))
    check = diagnose(water, flow, groups, DriftStep(1.0))
    assert check.pieces.tolist() == [24, 1, 16]
    # With all neighbours, every connected piece is one group, and says nothing of the flow.
    assert (check.groups, check.whole_pieces, check.locked) == (3, 3, 0)


def test_groups_depend_on_rho_only_at_its_ends():
    currents = double_gyre()
    water, flow = Water.of(currents), Flow.of(currents)
    duration = crossing_time(water, flow)
    counts = np.stack(
        [
            group_counts(water, flow, [DriftStep(k * duration, rho=rho) for k in (1, 2)])
            for rho in (1.0, 0.9, 0.2)
        ],
        axis=1,
    )
    assert (counts[:, 1] == counts[:, 2]).all()
    assert (counts[:, 0] > counts[:, 1]).all()
    alone = persistent_groups(drift_map(water, flow, DriftStep(2 * duration, rho=0.2))).count
    assert counts[1, 2] == alone


def test_a_period_is_the_product_of_its_records():
    random = np.random.default_rng(3)
    east, north = random.normal(size=(2, 3, 6, 7))
    currents = sea(east, north, random.random((6, 7)) < 0.9, dx=1800.0, dy=1800.0)
    water, flow = Water.of(currents), Flow.of(currents)
    for edge in ("uniform", "exit"):
        found = drift_maps(water, flow.repeated(), DriftStep(3600.0, edge=edge, method="euler"))
        product = np.eye(water.cells)
        for record in range(3):
            steady = Flow.of(currents, record=record)
            product = (
                product
                @ drift_map(water, steady, DriftStep(3600.0, edge=edge)).to_scipy().toarray()
            )
        for value in np.eye(water.cells)[::5]:
            np.testing.assert_allclose(found.push(value, 3), value @ product, atol=1e-12)
            np.testing.assert_allclose(found.pull(value, 3), product @ value, atol=1e-12)


def test_a_tide_brings_a_drifter_back():
    # Two cells to the East in one half of the day, and back in the other.
    east = np.array([2.0, -2.0])[:, None, None] * np.ones((2, 5, 9))
    currents = sea(east, 0 * east, dx=1.0, dy=1.0, hours=1 / 3600)
    water, flow = Water.of(currents), Flow.of(currents)
    tide = drift_maps(water, flow.repeated(), DriftStep(1.0, rho=1.0))
    matrix = np.stack([tide.push(value, 2) for value in np.eye(water.cells)])
    inner = np.flatnonzero((water.column > 0) & (water.column < 6) & ~water.boundary)
    np.testing.assert_array_equal(matrix[inner], np.eye(water.cells)[inner])


def test_an_eddy_that_lets_go_of_drifters_almost_never_has_a_finite_time():
    currents = double_gyre(21, 42)
    water, flow = Water.of(currents), Flow.of(currents)
    duration = 2 * crossing_time(water, flow)
    chain = drift_map(
        water, flow, DriftStep(duration, spread="sampled", edge="exit", method="rk4", substeps=4)
    )
    found = long_term_behaviour(chain, duration)
    # Nothing is persistent, and yet it takes about 3 10^12 steps to leave.
    assert found.transient.domiciles == ((-1,),)
    steps = np.asarray(found.absorption.value)
    assert 2e12 < steps.max() < 4e12
    assert steps.min() >= 1
    assert found.absorption.certificate.outcome is Outcome.STALLED
    np.testing.assert_allclose(found.probability.leaving, 1, atol=1e-12)
    with pytest.raises(RuntimeError, match="absorption_times: the residual stayed above"):
        long_term_behaviour(chain, duration, throw=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rho": 1.1}, "rho: expected a probability from 0 to 1, got 1.1"),
        ({"rho": math.nan}, "rho: expected"),
        ({"spread": "some"}, "spread: expected 'turned', 'all' or 'sampled', got 'some'"),
        ({"spread": "sampled", "samples": 0}, "samples: expected 1 or more, got 0"),
        ({"edge": "wall"}, "edge: expected 'uniform' or 'exit', got 'wall'"),
        ({"duration": 0.0}, "duration: expected a number of seconds other than 0"),
    ],
)
def test_bad_options_are_refused(options, message):
    currents = double_gyre(4, 8)
    with pytest.raises(ValueError, match=message):
        drift_map(Water.of(currents), Flow.of(currents), DriftStep(**options))


def test_bad_periods_and_durations_are_refused():
    currents = double_gyre(4, 8)
    water, flow = Water.of(currents), Flow.of(currents)
    assert flow.repeated() is flow
    east = np.ones((3, 4, 8))
    several = Flow.of(sea(east, east))
    with pytest.raises(ValueError, match="more than the 7200 s from the first record to the last"):
        several.repeated(7200)
    with pytest.raises(ValueError, match="multiple of the period, 10800 s, such as 3600 s, got 40"):
        drift_maps(water, several.repeated(), DriftStep(4000))
    with pytest.raises(ValueError, match="a positive number of seconds, got -1"):
        long_term_behaviour(Chain(np.array([[0]]), np.ones((1, 1))), -1)
    other = persistent_groups(Chain(np.array([[0]]), np.ones((1, 1))))
    with pytest.raises(ValueError, match="a map of 32 cells, got those of one of 1"):
        diagnose(water, flow, other, DriftStep())


def eddy(leak):
    """Two cells that drifters go between, and leave for either of two groups almost never."""
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, [0, 1]] = 1, (0.3, 0.7)
    matrix[1] *= 1 - leak
    matrix[1, 2:4] = leak / 3, leak * 2 / 3
    matrix[2, 2] = matrix[3, 3] = 1
    matrix[4, [0, 2]] = 0.5
    return Chain.from_scipy(matrix)


def test_probabilities_of_an_eddy_that_holds_almost_for_ever():
    for leak in (1e-7, 1e-9):
        found = long_term_behaviour(eddy(leak), 3600, throw=True).probability
        np.testing.assert_allclose(found.value[0], [1 / 3, 1 / 3, 1, 0, 2 / 3], atol=1e-12)


def test_what_is_not_good_enough_raises_only_if_asked_to(monkeypatch):
    monkeypatch.setattr("jaxcell.markov.hitting.PROBABILITY_TOLERANCE", -1.0)
    monkeypatch.setattr("jaxcell.markov.limiting._TOLERANCE", -1.0)
    found = long_term_behaviour(eddy(0.1), 3600)
    assert found.probability.certificate.outcome is Outcome.STALLED
    assert found.limiting.certificate.outcome is Outcome.STALLED
    strict = long_term_behaviour(eddy(0.1), 3600, throw=True)
    with pytest.raises(RuntimeError, match="absorption_probabilities: the residual stayed above"):
        strict.probability  # noqa: B018
    with pytest.raises(RuntimeError, match="limiting_distribution: the residual stayed above"):
        strict.limiting  # noqa: B018


def test_who_surely_leaves_is_known_without_a_solve(monkeypatch):
    # From 0 to 1, from there off the grid; 2 stays; from 3 to 0 or 2; from 4 to 2.
    chain = Chain(
        np.int32([[1, 1, 2, 0, 2], [1, 1, 2, 2, 2]]),
        np.array([[1, 0, 1, 0.5, 1], [0, 0, 0, 0.5, 0]]),
    )
    behaviour = long_term_behaviour(chain, 3600)
    np.testing.assert_array_equal(behaviour.sure_to_leave, [1, 1, 0, np.nan, 0])
    # Of a layer it is told where a table of all ends would be too large, too.
    water = Water.of(sea(*np.zeros((2, 1, 5))))
    np.testing.assert_allclose(LayerEnds(water, behaviour).leaving, [1, 1, 0, 0.5, 0])
    monkeypatch.setattr("jaxcell.drift.results.ends.LARGEST_TABLE", -1)
    np.testing.assert_array_equal(LayerEnds(water, behaviour).leaving, [1, 1, 0, np.nan, 0])


def test_remedies_are_none_that_are_taken():
    currents = double_gyre()
    water, flow = Water.of(currents), Flow.of(currents)
    short, good = (
        diagnose(water, flow, persistent_groups(drift_map(water, flow, step)), step)
        for step in map(DriftStep, (10.0, 4 * crossing_time(water, flow)))
    )
    assert short.remedies("turned") == short.remedies("all") == ("duration", "spread")
    assert short.remedies("sampled") == ("duration",)
    assert good.warning is None
    assert good.remedies("turned") == ()


def test_a_map_of_ten_million_cells_is_refused_with_what_it_needs(monkeypatch):
    water, flow = examples.gyres()
    monkeypatch.setattr(memory, "free", lambda: 4_000_000_000)
    monkeypatch.setattr(Water, "cells", 10_000_000)
    needs = "drift map of 10,000,000 cells of water needs about 9.0 GB of memory, and 4.0 GB"
    with pytest.raises(MemoryError, match=needs):
        drift_map(water, flow, METHODS["drifters"])
