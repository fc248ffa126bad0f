"""Arguments as people have them: matrices and graphs of other libraries, and poses as numbers."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pandas as pd
import pytest
import scipy.sparse
import shapely

from jaxcell import automata, bundled, mapping, markov, optimize, patrol, space, study
from jaxcell.study.map_study import cell_at


# A walk on a line, which stays at its right end, and its times to this end.
P = np.array([[0.5, 0.5, 0], [0.25, 0.5, 0.25], [0, 0, 1]])
TIMES = [8, 6, 0]


def digraph():
    graph = nx.DiGraph()
    graph.add_nodes_from(range(3))
    graph.add_weighted_edges_from((i, j, P[i, j]) for i, j in np.argwhere(P).tolist())
    return graph


def named(attribute):
    graph = nx.DiGraph()
    for tail, head, share in (("a", "b", 0.5), ("a", "c", 0.5), ("b", "a", 1.0), ("c", "a", 1.0)):
        graph.add_edge(tail, head, **{attribute: share})
    return graph


FRAME = pd.DataFrame(P, list("abc"), list("abc"))
MATRICES = [P, P.tolist(), jnp.asarray(P), scipy.sparse.coo_matrix(P), scipy.sparse.csc_array(P)]


@pytest.mark.parametrize(
    "matrix", [*MATRICES, FRAME[list("cab")], digraph()], ids=lambda one: type(one).__name__
)
def test_a_matrix_is_a_chain(matrix):
    np.testing.assert_allclose(markov.hitting_times(matrix, 2).value, TIMES, rtol=1e-12)
    np.testing.assert_allclose(markov.absorption_times(matrix).value, TIMES, rtol=1e-12)
    np.testing.assert_allclose(markov.limiting_distribution(matrix).value, [0, 0, 1])
    np.testing.assert_allclose(markov.first_arrival([matrix], [2], 2, 1), [1, 0])
    assert mapping.persistent_groups(matrix).group.tolist() == [-1, -1, 0]


def test_a_traced_matrix_is_a_chain():
    def time(p):
        return markov.hitting_times(p, 2).value[0]

    # By elimination, the time from cell 0 is 1 / a + (1 + b / a) / c.
    a, b, c = P[0, 1], P[1, 0], P[1, 2]
    by_hand = -1 / c**2 * (1 + b / a)
    slope = jax.jit(jax.grad(time))(jnp.asarray(P))
    # Probability moves from staying in cell 1 to leaving it for cell 2.
    assert slope[1, 2] - slope[1, 1] == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            "lab",
            r"chain: expected a Chain, got str; a square matrix \(.*sequence.unrolled are chains",
        ),
        (P[:2], r"matrix: expected as many rows as columns, got \(2, 3\)"),
        (2 * P, "sum"),
        (nx.path_graph(3), "the edge 0, 1 has no attribute `weight`; expected its probability"),
        (
            named("probability"),
            "edge 'a', 'b' has no attribute `weight`, but probability; expected",
        ),
        (nx.Graph(), "chain: expected a graph with vertices, got one without"),
        (pd.DataFrame(P, list("abc")), r"columns \[0, 1, 2\] of the DataFrame are not the labels"),
        (pd.DataFrame(P, list("aab"), list("aab")), "each once; P.to_numpy"),
        (None, "chain: expected a Chain, got NoneType"),
    ],
)
def test_other_chains_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said) as caught:
        markov.hitting_times(wrong, 2)
    assert "\n" not in str(caught.value)


def test_a_vertex_with_a_name_is_refused_with_its_number():
    for target in ("c", ["c"]):
        with pytest.raises(ValueError, match=r"got <U1; .* is list\(graph\).index\(name\)"):
            markov.hitting_times(named("weight"), target)


def test_a_program_without_checks_of_types():
    program = """if True:
        import networkx, numpy
        from jaxcell import study
        print(study.PatrolGraph(networkx.cycle_graph(4), emphasis=(1, 2)).vertices("0123", "", 2))
        study.Drift(file=numpy.eye(3))
    """
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stdout == "[2]\n"
    assert "file: expected files or an xarray.Dataset, got ndarray" in ran.stderr


def test_lists_are_arrays():
    line = automata.subset_construction([1, 2, 0], [False, False, True])
    ring = automata.subset_construction(np.array([1, 2, 0]), np.array([False, False, True]))
    np.testing.assert_array_equal(line.transition, ring.transition)


def test_a_networkx_graph_is_a_graph():
    grid = nx.grid_2d_graph(3, 3)
    own = optimize.Graph(grid)
    walk = patrol.random_walk(grid)
    # A vertex is visited in proportion to its edges.
    share = [degree / 24 for _, degree in grid.degree]
    np.testing.assert_allclose(markov.limiting_distribution(walk).value, share, rtol=1e-12)
    found = optimize.minimum_commute(grid), optimize.minimum_commute(own)
    np.testing.assert_array_equal(found[0].weights, found[1].weights)
    with pytest.raises(ValueError, match="graph: expected a Graph, got str"):
        patrol.random_walk("eight")


def test_poses_are_texts_or_numbers():
    lab = space.CellSpace.load(bundled("lab_a"), cell=1.0, directions=8)
    cell = int(lab.index(0.5, 0.5, 0.0))
    for pose in ("0.5,0.5,0", (0.5, 0.5, 0), [0.5, 0.5, 0.0], str(cell), cell):
        assert cell_at(lab, pose, "start") == cell


def test_a_box_without_cells_is_refused_with_an_example():
    with pytest.raises(ValueError, match=r"a number of cells along each axis, as in Box\("):
        space.Box([-2, -2], [2, 2])


ROOM = [(0, 0), (6, 0), (6, 4), (0, 4)]


@pytest.mark.parametrize(
    "room",
    [
        space.Workspace(ROOM),
        shapely.Polygon(ROOM),
        ROOM,
        np.ones((4, 6), bool),
        space.CellSpace.of(space.Workspace(ROOM), 2.0, 4),
    ],
    ids=lambda room: type(room).__name__,
)
def test_a_room_is_a_map(room):
    question = study.Groups(map=room, cell=1.0, directions=4, bounce=(180.0,))
    result = question.run()
    assert question.spec(result)["map"] == "a room of the program"
    assert result.cells.positions == 24
    # A robot that turns back at walls: one group in each row and column.
    assert result.count.tolist() == [4 + 6]
    assert result.longest_period.tolist() == [2 * 6]


def test_holes_of_a_polygon_are_obstacles():
    pillar = [(2, 1), (3, 1), (3, 2), (2, 2)]
    cells = space.CellSpace.of(shapely.Polygon(ROOM, [pillar]), 1.0, 4)
    assert cells.positions == 23


def test_other_rooms_are_refused():
    for room in (7, {"a": 1}, None):
        with pytest.raises(ValueError, match="map: expected a file, a Workspace, a shapely"):
            study.Groups(map=room, bounce=(90.0,))
    with pytest.raises(FileNotFoundError, match=r"none\.json"):
        study.Groups(map="none.json", bounce=(90.0,)).run()


def test_a_networkx_graph_is_patrolled():
    star = nx.star_graph(3)
    result = study.PatrolGraph(file=nx.relabel_nodes(star, {0: "hall"})).run()
    assert result.names[0] == "hall"
    with pytest.raises(ValueError, match="a Polygon is a room, not a graph; use study"):
        study.PatrolGraph(shapely.box(0, 0, 2, 2)).run()
    # Half of all steps end in the hall of a star.
    assert result.shares[0][0] == pytest.approx(0.5)
