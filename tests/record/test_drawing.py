import itertools

import networkx as nx
import numpy as np
from hypothesis import given, strategies as st

from jaxcell.automata import Filter, subset_construction
from jaxcell.record.bounce.filter_drawing import draw_filter


def distances(points):
    return np.linalg.norm(points[:, None] - points[None], axis=-1)


def check(drawing, filter):
    assert len(set(drawing.state.tolist())) == len(drawing.state)
    apart = distances(drawing.position)
    np.fill_diagonal(apart, np.inf)
    assert apart.min(initial=np.inf) > 20, "dots of radius 10 overlap"
    drawn = set(drawing.state.tolist())
    edges = {
        (state, int(target))
        for state, targets in enumerate(filter.transition)
        for target in targets
        if state in drawn and int(target) in drawn
    }
    assert {tuple(edge) for edge in drawing.edge.tolist()} == edges
    assert len(drawing.edge) == len(edges)


def test_a_small_filter_is_drawn_whole(lab):
    run = lab.localize(100)
    drawing = draw_filter(lab.filter, run.states)
    assert drawing.whole
    assert drawing.cycles_left_out == 0
    assert set(drawing.state) == set(range(129))
    check(drawing, lab.filter)
    again = draw_filter(lab.filter, run.states)
    np.testing.assert_array_equal(again.position, drawing.position)


def test_states_stand_in_columns_by_distance(lab):
    drawing = draw_filter(lab.filter, np.array([0]))
    x = dict(zip(drawing.state.tolist(), drawing.position[:, 0].tolist(), strict=True))
    edges = [(s, t) for s, row in enumerate(lab.filter.transition.tolist()) for t in row if t >= 0]
    distance = nx.single_source_shortest_path_length(nx.DiGraph(edges), 0)
    outside = [s for s in x if lab.filter.color[s] == 1]
    column = {(distance[s], x[s]) for s in outside}
    assert len(column) == len({d for d, _ in column})
    assert all(one[1] < other[1] for one, other in itertools.pairwise(sorted(column)))


def test_the_trap_is_drawn_where_it_was_entered(lab):
    filter = lab.filter.with_trap()
    never = draw_filter(filter, np.array([0, 1]))
    assert filter.trap not in never.state
    check(never, filter)
    entered = draw_filter(filter, np.array([0, 1, filter.trap]))
    assert filter.trap in entered.state
    check(entered, filter)


def test_of_a_large_filter_the_run_and_some_cycles(hall):
    assert len(hall.filter.transition) > 300
    run = hall.localize(7)
    drawing = draw_filter(hall.filter, run.states)
    assert not drawing.whole
    assert set(run.states[-100:].tolist()) <= set(drawing.state.tolist())
    drawn = [c for c in hall.filter.cycles if c.states[0] in drawing.state]
    for cycle in drawn:
        assert set(cycle.states.tolist()) <= set(drawing.state.tolist()), "half a cycle"
    assert run.states[-1] in np.concatenate([c.states for c in drawn])
    assert drawing.cycles_left_out == len(hall.filter.cycles) - len(drawn) > 0
    assert len(drawing.state) < 500
    check(drawing, hall.filter)


@given(st.data())
def test_any_filter_is_drawn(data):
    cells = data.draw(st.integers(1, 60))
    image = data.draw(st.lists(st.integers(0, cells - 1), min_size=cells, max_size=cells))
    bits = data.draw(st.lists(st.booleans(), min_size=cells, max_size=cells))
    automaton = subset_construction(np.array(image, np.int32), np.array(bits))
    filter = Filter.of(automaton, open_world=data.draw(st.booleans()))
    walk = [0]
    for _ in range(data.draw(st.integers(0, 50))):
        possible = [t for t in filter.transition[walk[-1]].tolist() if t >= 0]
        walk.append(data.draw(st.sampled_from(possible)))
    check(draw_filter(filter, np.array(walk)), filter)
