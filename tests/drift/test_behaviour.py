import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from seas import double_gyre, sea, seas, water_and_flow

from jaxcell import markov
from jaxcell.drift.drift_step import METHODS, DriftStep
from jaxcell.drift.flow import Flow, crossing_time
from jaxcell.drift.long_term import long_term_behaviour
from jaxcell.drift.maps import drift_map, flow_map
from jaxcell.drift.results.layer_ends import LayerEnds
from jaxcell.drift.validation.diagnosis import diagnose, group_counts
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain, persistent_groups


@given(seas(), st.sampled_from(["turned", "all"]), st.sampled_from(["uniform", "exit"]))
def test_behaviour_equals_the_definition(currents, spread, edge):
    water, flow = Water.of(currents), Flow.of(currents)
    chain = drift_map(water, flow, DriftStep(1.0, spread=spread, edge=edge))
    behaviour = long_term_behaviour(chain, 1800)
    matrix = chain.to_scipy().toarray()
    graph = nx.from_numpy_array(matrix, create_using=nx.DiGraph)
    graph.add_edges_from((int(c), -1) for c in np.flatnonzero(np.asarray(chain.leaving) > 0))
    ends = [s for s in nx.strongly_connected_components(graph) if not nx.node_boundary(graph, s)]
    groups = sorted((s for s in ends if -1 not in s), key=min)
    group = np.asarray(behaviour.groups.group)
    assert behaviour.groups.count == len(groups)
    reach = nx.transitive_closure(graph, reflexive=True)
    for cell in range(water.cells):
        homes = [k for k, cells in enumerate(groups) if reach.has_edge(cell, min(cells))]
        if reach.has_edge(cell, -1):
            homes.insert(0, -1)
        if group[cell] >= 0:
            assert homes == [group[cell]]
            assert behaviour.transient.group[cell] == -1
            assert behaviour.basin[cell] == group[cell]
        else:
            assert behaviour.transient.domiciles[int(behaviour.transient.group[cell])] == tuple(
                homes
            )
            assert behaviour.basin[cell] == (homes[0] if len(homes) == 1 else -1)
    q = matrix[group < 0][:, group < 0]
    times = np.linalg.solve(np.eye(len(q)) - q, np.ones(len(q)))
    np.testing.assert_allclose(np.asarray(behaviour.hours)[group < 0], times / 2, rtol=1e-8)
    np.testing.assert_allclose(
        np.asarray(behaviour.probability.value).sum(axis=0)
        + np.asarray(behaviour.probability.leaving),
        1,
    )
    assert float(behaviour.limiting.value.sum()) + behaviour.limiting.leaving == pytest.approx(1)


def test_the_double_gyre_has_a_group_in_each_gyre_and_a_border_between_them():
    water, flow = water_and_flow(double_gyre(21, 42, inward=1.0))
    duration = 3 * crossing_time(water, flow)
    step = DriftStep(duration, method="rk4", substeps=4)
    behaviour = long_term_behaviour(drift_map(water, flow, step), duration)
    group = water.on_grid(np.asarray(behaviour.groups.group), -1)
    # The middles of the gyres, to which the water goes.
    assert np.argwhere(group >= 0).tolist() == [[10, 10], [10, 31]]
    # As in section 5.5: two persistent groups, and transient groups of one and of both.
    assert behaviour.transient.domiciles == ((0,), (1,), (0, 1))
    assert behaviour.transient.single.tolist() == [True, True, False]
    column = water.column
    kind, hours = np.asarray(behaviour.transient.group), np.asarray(behaviour.hours)
    assert column[kind == 0].max() < 21 <= column[kind == 1].min()
    # As in Figure 5.8, from between the domains it takes longest.
    assert hours[kind == 2].mean() > max(hours[kind == k].mean() for k in (0, 1))
    # The two gyres are alike.
    np.testing.assert_allclose(behaviour.limiting.weights, 0.5, atol=1e-9)
    check = diagnose(water, flow, behaviour.groups, step)
    assert check.warning is None
    shift = np.hypot(*np.asarray(flow_map(water, flow, step)))
    assert check.mean_shift == pytest.approx(shift.mean())


@pytest.mark.parametrize(
    ("inward", "crossings", "locked", "warning"),
    [
        (0.1, 1 / 3, 50, "are mapped to themselves: the grid, and not the water"),
        (0.0, 1.2, 40, "persistent groups are cells that water flows out of"),
    ],
)
def test_a_step_that_is_too_short_is_warned_of(inward, crossings, locked, warning):
    water, flow = water_and_flow(double_gyre(inward=inward))
    step = DriftStep(crossings * crossing_time(water, flow), rho=1.0)
    check = diagnose(water, flow, persistent_groups(drift_map(water, flow, step)), step)
    assert (check.self_image > 0.5) == (crossings < 1)
    assert check.locked > locked
    assert warning in (check.warning or "")
    shift = np.hypot(*np.asarray(flow_map(water, flow, step)))
    assert check.mean_shift == pytest.approx(shift.mean())


def test_groups_of_one_cell_may_be_where_the_current_runs_ashore():
    """All drifters end in the cell of their row that is nearest to the land."""
    wet = np.arange(8) < np.full((5, 1), 7)
    water, flow = water_and_flow(sea(0.5 * wet, np.zeros(wet.shape), wet, dx=1.0, dy=1.0))
    step = METHODS["drifters"].lasting(4.0)
    groups = persistent_groups(drift_map(water, flow, step))
    assert water.column[np.asarray(groups.group) >= 0].tolist() == [6] * 5
    check = diagnose(water, flow, groups, step)
    assert (check.locked, check.ashore, check.warning) == (0, 5, None)


def test_groups_that_are_whole_pieces_of_water_are_counted_apart():
    wet = np.ones((6, 9), bool)
    wet[:, 4] = False
    wet[0, 5] = True
    wet[0:2, 6:] = wet[1, 5] = False
    nothing = np.full((6, 9), 0.1)
    water, flow = water_and_flow(sea(nothing, nothing, wet, dx=1.0, dy=1.0))
    groups = persistent_groups(drift_map(water, flow, DriftStep(1.0, spread="all")))
    check = diagnose(water, flow, groups, DriftStep(1.0))
    assert check.pieces.tolist() == [24, 1, 16]
    # With all neighbours, every connected piece is one group, and says nothing of the flow.
    assert (check.groups, check.whole_pieces, check.locked) == (3, 3, 0)


def test_groups_depend_on_rho_only_at_its_ends():
    water, flow = water_and_flow(double_gyre())
    duration = crossing_time(water, flow)
    known, most, few = (
        group_counts(water, flow, [DriftStep(k * duration, rho=rho) for k in (1, 2)])
        for rho in (1.0, 0.9, 0.2)
    )
    assert (known > most).all()
    assert (most == few).all()
    alone = persistent_groups(drift_map(water, flow, DriftStep(2 * duration, rho=0.2))).count
    assert few[1] == alone


def test_an_eddy_that_almost_traps_drifters_has_finite_times():
    water, flow = water_and_flow(double_gyre(21, 42))
    duration = 2 * crossing_time(water, flow)
    chain = drift_map(water, flow, METHODS["drifters"].lasting(duration))
    behaviour = long_term_behaviour(chain, duration)
    # Nothing is persistent, and yet it takes about 3 10^12 steps to leave.
    assert behaviour.transient.domiciles == ((-1,),)
    steps = np.asarray(behaviour.absorption.value)
    assert 2e12 < steps.max() < 4e12
    assert steps.min() >= 1
    assert behaviour.absorption.certificate.residual < 1e-8
    np.testing.assert_allclose(behaviour.probability.leaving, 1, atol=1e-12)
    long_term_behaviour(chain, duration, throw=True)


def test_bad_durations_and_groups_are_refused():
    water, flow = water_and_flow(double_gyre(4, 8))
    assert flow.repeated() is flow
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


def test_probabilities_of_an_eddy_that_almost_traps_drifters():
    for leak in (1e-7, 1e-9):
        found = long_term_behaviour(eddy(leak), 3600, throw=True).probability
        np.testing.assert_allclose(found.value[0], [1 / 3, 1 / 3, 1, 0, 2 / 3], atol=1e-12)


@pytest.mark.parametrize("throw", [False, True])
def test_inaccurate_solves_raise_only_with_throw(throw, monkeypatch):
    passed = []

    def noted(solve):
        return lambda *arguments, throw: passed.append(throw) or solve(*arguments, throw=throw)

    for name in ("absorption_probabilities", "limiting_distribution"):
        monkeypatch.setattr(markov, name, noted(getattr(markov, name)))
    behaviour = long_term_behaviour(eddy(0.1), 3600, throw=throw)
    assert np.isfinite(behaviour.probability.value).all()
    assert np.isfinite(behaviour.limiting.value).all()
    assert passed == [throw, throw]


def test_sure_leaving_is_known_without_a_solve(monkeypatch):
    # From 0 to 1, from there off the grid; 2 stays; from 3 to 0 or 2; from 4 to 2.
    chain = Chain(
        np.int32([[1, 1, 2, 0, 2], [1, 1, 2, 2, 2]]),
        np.array([[1, 0, 1, 0.5, 1], [0, 0, 0, 0.5, 0]]),
    )
    behaviour = long_term_behaviour(chain, 3600)
    np.testing.assert_array_equal(behaviour.sure_to_leave, [1, 1, 0, np.nan, 0])
    # A layer knows it even if a table of all ends would be too large.
    water = Water.of(sea(*np.zeros((2, 1, 5))))
    np.testing.assert_allclose(LayerEnds(water, behaviour).leaving, [1, 1, 0, 0.5, 0])
    monkeypatch.setattr("jaxcell.drift.results.layer_ends.LARGEST_TABLE", -1)
    np.testing.assert_allclose(LayerEnds(water, behaviour).leaving, [1, 1, 0, 0.5, 0])


def test_remedies_do_not_repeat_the_rules_of_the_map():
    water, flow = water_and_flow(double_gyre())
    short, good = (
        diagnose(water, flow, persistent_groups(drift_map(water, flow, step)), step)
        for step in map(DriftStep, (10.0, 4 * crossing_time(water, flow)))
    )
    assert short.remedies("turned") == short.remedies("all") == ("duration", "spread")
    assert short.remedies("sampled") == ("duration",)
    assert good.warning is None
    assert good.remedies("turned") == ()
