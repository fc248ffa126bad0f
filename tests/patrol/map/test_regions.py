import networkx
import numpy as np
import pytest
from graphs import network_of
from hypothesis import assume, given, strategies as st

from jaxcell.optimize import Graph
from jaxcell.patrol.map.regions import angular_regions, base_station


def drawn(picture):
    """A grid graph of the squares that are not `#`, 4-connected, and the squares of each letter.

    Row 0 of the picture is the highest, and cells are counted from the lowest.
    """
    rows = picture.split()[::-1]
    squares = [(x, y) for y, row in enumerate(rows) for x, mark in enumerate(row) if mark != "#"]
    number = {square: i for i, square in enumerate(squares)}
    edges = [
        (i, number[near])
        for (x, y), i in number.items()
        for near in ((x + 1, y), (x, y + 1))
        if near in number
    ]
    marks = np.array([rows[y][x] for x, y in squares])
    return Graph(edges, xy=np.array(squares, float)), marks


def watched(picture):
    """A drawn graph with its squares, the base station `B`, and its view, which are `v` and `B`."""
    graph, marks = drawn(picture)
    return graph, marks, int(np.flatnonzero(marks == "B")[0]), np.isin(marks, ["v", "B"])


def rim(graph, base, view):
    """The cells in view next to one that is not, where robots report."""
    net = network_of(graph)
    return {
        z
        for z in np.flatnonzero(view).tolist()
        if z != base and any(not view[n] and n != base for n in net[z])
    }


def check_partition(graph, regions):
    outside = ~regions.view
    outside[regions.base] = False
    net = network_of(graph)
    assert regions.region[regions.base] == -1
    assert (regions.region[outside] >= 0).all()
    assert all(regions.region[z] >= 0 for z in rim(graph, regions.base, regions.view))
    assert set(np.unique(regions.region)) - {-1} == set(range(regions.count))
    for k in range(regions.count):
        cells = regions.cells(k)
        assert networkx.is_connected(net.subgraph(cells.tolist()))
        assert outside[cells].any()
        assert regions.view[cells].any()


@given(st.integers(0, 10_000), st.floats(0.0, 0.35), st.integers(1, 5))
def test_regions_of_random_rooms(seed, share, robots):
    random = np.random.default_rng(seed)
    blocked = random.random((11, 12)) < share
    picture = "\n".join("".join("#" if b else "." for b in row) for row in blocked)
    graph, _ = drawn(picture)
    largest = np.array(sorted(max(networkx.connected_components(network_of(graph)), key=len)))
    net = networkx.convert_node_labels_to_integers(network_of(graph).subgraph(largest.tolist()))
    graph = Graph(np.array(net.edges), xy=graph.xy[largest])
    base = int(random.integers(graph.vertices))
    # The cells within some steps, which is a view that is connected but of no simple shape.
    steps = networkx.single_source_shortest_path_length(net, base)
    view = np.array([steps[z] <= 4 for z in range(graph.vertices)])
    assume(not view.all())
    try:
        regions = angular_regions(graph, base, view, robots)
    except ValueError as error:
        assert str(error).startswith(("regions: ", "robots: "))
        return
    check_partition(graph, regions)


def test_equal_sectors_open_counter_clockwise():
    graph, _ = drawn("\n".join(["." * 9] * 9))
    base = 40
    away = graph.xy - graph.xy[base]
    view = np.abs(away).max(axis=1) <= 2
    regions = angular_regions(graph, base, view, 4)
    x, y = away.T
    quadrant = np.select([(x > 0) & (y >= 0), (x <= 0) & (y > 0), (x < 0) & (y <= 0)], [0, 1, 2], 3)
    patrolled = np.abs(away).max(axis=1) >= 2
    assert regions.region.tolist() == np.where(patrolled, quadrant, -1).tolist()


def test_a_piece_goes_to_the_region_that_it_touches():
    # The room in the upper left corner is in the upper sector of two, its door in the lower one.
    graph, marks, base, view = watched(
        """
        aaa#.......
        aaa#.......
        a###..vvv..
        .......vBv.
        ......vvv..
        ...........
        """
    )
    regions = angular_regions(graph, base, view, 2)
    check_partition(graph, regions)
    assert (graph.xy[marks == "a", 1] > graph.xy[base, 1]).all()
    assert set(regions.region[marks == "a"]) == {1}


def test_a_piece_that_touches_no_region_is_joined_through_the_view():
    graph, _, base, view = watched(
        """
        #..#
        #v##
        vBv.
        vvv.
        ####
        """
    )
    # Upwards there are two cells behind a door in view, whose way down leads past the base.
    with pytest.raises(ValueError, match=r"regions: cells 8, 9, 10 would be in region 0 of 1, but"):
        angular_regions(graph, base, view, 1)
    graph, _, base, view = watched(
        """
        #..#
        #v##
        vvv.
        vBv.
        ####
        """
    )
    regions = angular_regions(graph, base, view, 1)
    check_partition(graph, regions)
    # Around the corner from the rim at the door to that on the right.
    place = graph.xy.astype(int).tolist()
    assert regions.region[place.index([1, 2])] == 0
    assert regions.region[place.index([0, 2])] == -1


@given(st.integers(0, 10_000))
def test_base_station_is_the_central_cell_that_sees_most(seed):
    random = np.random.default_rng(seed)
    net = networkx.connected_watts_strogatz_graph(20, 4, 0.3, seed=seed)
    graph = Graph(np.array(net.edges), xy=random.random((20, 2)))
    visible = random.random((20, 20)) < 0.3
    closeness = networkx.closeness_centrality(network_of(graph), distance="length")
    central = sorted(closeness, key=closeness.get, reverse=True)[:5]
    seen = visible.sum(axis=1)
    base = base_station(graph, visible, central=0.25)
    assert base in central
    assert seen[base] == seen[central].max()


LINE = Graph([[0, 1], [1, 2], [2, 3]], xy=np.arange(8.0).reshape(4, 2))
ALL = np.ones(4, bool)
SOME = np.array([True, True, False, False])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((LINE, 4, SOME, 1), "base: expected a vertex, 0 to 3, got 4"),
        ((LINE, 0, SOME[:3], 1), r"view: expected an array \[4\]"),
        ((LINE, 0, ~ALL, 1), "view: the base station at cell 0 sees no other cell"),
        ((LINE, 0, ALL, 1), "view: the base station at cell 0 sees all cells"),
        ((LINE, 0, SOME, 0), "robots: expected 1 to 2, .* got 0"),
        ((LINE, 0, SOME, 3), "robots: expected 1 to 2, .* got 3"),
        ((LINE, 0, SOME, 2), "regions: region 1 of 2 has no cell to patrol"),
        ((Graph(LINE.edges), 0, SOME, 1), "graph: expected positions"),
    ],
)
def test_wrong_arguments_of_regions_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        angular_regions(*arguments)


def test_a_region_that_cannot_report_is_refused():
    # The lower sector is behind the upper one: no cell of it is in view.
    graph, _, base, view = watched(
        """
        .v..
        #Bv.
        ###.
        ....
        """
    )
    with pytest.raises(ValueError, match="region 1 of 2 has no cell in view from which its robot"):
        angular_regions(graph, base, view, 2)


@pytest.mark.parametrize(
    ("graph", "visible", "central", "message"),
    [
        (LINE, np.ones((3, 3), bool), 0.5, r"visible: expected an array \[4, 4\]"),
        (LINE, np.ones((4, 4), bool), 0.0, "central: expected a share"),
        (LINE, np.eye(4, dtype=bool), 0.5, "view: the base station at cell 1 sees no other cell"),
        (
            Graph([[0, 1], [2, 3]]),
            np.ones((4, 4), bool),
            0.5,
            "graph: expected all vertices connected, but vertices 2, 3",
        ),
    ],
)
def test_wrong_arguments_of_base_stations_are_refused(graph, visible, central, message):
    with pytest.raises(ValueError, match=message):
        base_station(graph, visible, central)


def test_a_piece_without_a_path_waits_until_another_piece_has_joined_a_region():
    graph, _, base, view = watched(
        """
        .v#
        vB.
        vvv
        v#v
        v.v
        """
    )
    check_partition(graph, angular_regions(graph, base, view, 2))
