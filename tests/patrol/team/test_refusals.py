import numpy as np
import pytest

from jaxcell.optimize import Graph
from jaxcell.patrol.team import (
    age_of_news,
    charged,
    part_of_graph,
    simulate_idleness,
    timed,
    walk_in_part,
    whole_times,
)


LINE = Graph([[0, 1], [1, 2], [2, 3]])
APART = Graph([[0, 1], [2, 3]])
WALK = np.array([[0, 1, 0, 0], [0.5, 0, 0.5, 0], [0, 0.5, 0, 0.5], [0, 0, 1, 0]])[None]
SHARES = np.array([[1, 2, 2, 1]]) / 6
TURN = np.array([[0.0, 1.0], [1.0, 0.0]])
NONE = np.empty(0, np.int64)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: walk_in_part(APART, [0, 1], TURN), "no path leads from vertex 2 to the part"),
        (lambda: walk_in_part(LINE, [0, 9], TURN), "vertices: expected numbers from 0 to 3, got 9"),
        (lambda: walk_in_part(LINE, [0, -1], TURN), "vertices: expected numbers from 0 to 3, got"),
        (lambda: walk_in_part(LINE, [0, 0], TURN), "vertices: expected different vertices"),
        (lambda: walk_in_part(LINE, [0, 1], np.eye(3)), r"matrix: expected an array \[2, 2\]"),
        (lambda: walk_in_part(LINE, [0, 1], [[0, 0.5], [1, 0]]), "matrix: expected rows .* sum to"),
        (lambda: walk_in_part(LINE, [0, 1], [[0, np.nan], [1, 0]]), "matrix: expected rows of num"),
        (lambda: walk_in_part(LINE, [0, 3], TURN), "matrix: robot 0 goes from vertex 0 to 3, betw"),
        (lambda: age_of_news(LINE, WALK, 0, unit=0), "unit: expected a positive finite number"),
        (lambda: age_of_news(LINE, WALK, 0, unit=-1.0), "unit: expected a positive finite number"),
        (
            lambda: age_of_news(LINE, WALK, 0, names="ab"),
            "names: expected 4, one per vertex, got 2",
        ),
        (lambda: age_of_news(LINE, WALK, 0, times=10**10), "times: expected at most 2,147,483,647"),
        (lambda: part_of_graph(LINE, NONE), "vertices: expected one or more vertices"),
        (lambda: part_of_graph(LINE, [0, 2]), "vertices: no edge joins two of them"),
        (lambda: age_of_news(LINE, WALK, 0, times=[1, 2, 0]), "times: expected at least 1, got 0"),
        (lambda: age_of_news(LINE, WALK, 0, times=[1, 2]), "times: expected a whole number, or 3"),
        (lambda: age_of_news(LINE, WALK, 0, times=[1, 2, 1.5]), "times: expected a whole number"),
        (lambda: age_of_news(LINE, WALK[0], 0), r"matrices: expected an array \[robots, 4, 4\]"),
        (lambda: age_of_news(LINE, 2 * WALK, 0), "matrices: expected rows .* that sum to 1"),
        (
            lambda: age_of_news(LINE, np.roll(WALK, 1, axis=2), 0),
            "matrices: robot 0 goes from vertex 0 to 2, between which there is no edge",
        ),
        (lambda: timed(LINE, WALK, SHARES, [1, 2, 0], 1.0), r"times\[2\] is 0.0; expected a posi"),
        (lambda: timed(LINE, WALK, SHARES, [1, 2], 1.0), "times: expected 3 numbers, one per edge"),
        (lambda: timed(LINE, WALK, SHARES, [1, 2, 1], -1.0), "wait: expected a positive finite"),
        (
            lambda: timed(LINE, np.eye(4)[None], SHARES, [1, 2, 1], 1.0),
            "matrices: robot 0 visits different vertices in the long run",
        ),
        (lambda: simulate_idleness(LINE, WALK, times=[1, 0, 1]), r"times\[1\] is 0.0; expected a"),
        (lambda: simulate_idleness(LINE, WALK, times=[1, 1]), "times: expected 3 numbers"),
        (lambda: simulate_idleness(LINE, np.eye(3)[None]), "matrices: expected an array"),
        (lambda: charged(LINE, np.eye(3)[None], 0, 8), "matrices: expected an array"),
        (lambda: charged(APART, np.eye(4)[None], 0, 8), "graph: expected all vertices connected"),
        (lambda: whole_times(LINE, 0.0, 1.0), "speed: expected a positive finite number, got 0"),
        (lambda: whole_times(LINE, 1.0, np.inf), "unit: expected a positive finite number, got i"),
    ],
)
def test_wrong_parts_times_and_walks_are_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refused:
        call()
    assert "\n" not in str(refused.value)


@pytest.mark.usefixtures("unchecked")
def test_times_that_need_more_memory_than_is_free_are_refused_with_a_way_on():
    with pytest.raises(MemoryError, match=r"units of travel time needs .* in a longer unit"):
        age_of_news(LINE, WALK, 0, times=10**9)


@pytest.mark.usefixtures("unchecked")
def test_whole_floats_are_whole_times():
    known = age_of_news(LINE, WALK, 0, times=[1, 2, 1]).mean_age
    assert age_of_news(LINE, WALK, 0, times=[1.0, 2.0, 1.0]).mean_age.tolist() == known.tolist()
