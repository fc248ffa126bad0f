"""Graph files with positions in degrees, such as those of street networks."""

import json
import math

import networkx as nx
import numpy as np
import pytest

from jaxcell.base.doubts import Doubt
from jaxcell.cli import main
from jaxcell.patrol import Graph, load_graph


# Four crossings in San Francisco.
STREETS = {"a": (-122.4194, 37.7749), "b": (-122.418, 37.7752)}
STREETS |= {"c": (-122.4172, 37.7761), "d": (-122.419, 37.7765)}
EDGES = [("a", "b"), ("b", "c"), ("c", "d"), ("a", "d")]


def on_ellipsoid(a, b):
    """The length in metres of a short line on the ellipsoid WGS 84, by its radii of curvature."""
    squared, middle = 0.00669438, math.radians((a[1] + b[1]) / 2)
    root = 1 - squared * math.sin(middle) ** 2
    meridian, normal = 6378137 * (1 - squared) / root**1.5, 6378137 / math.sqrt(root)
    east, north = (math.radians(b[k] - a[k]) for k in (0, 1))
    return math.hypot(east * normal * math.cos(middle), north * meridian)


def streets(names=("x", "y"), **about):
    graph = nx.Graph(**about)
    for name, place in STREETS.items():
        graph.add_node(name, **dict(zip(names, place, strict=True)))
    graph.add_edges_from(EDGES)
    return graph


def write(folder, graph, suffix=".graphml"):
    path = folder / f"streets{suffix}"
    if suffix == ".json":
        path.write_text(json.dumps(nx.node_link_data(graph, edges="edges")))
    else:
        {".graphml": nx.write_graphml, ".gml": nx.write_gml}[suffix](graph, path)
    return path


@pytest.mark.parametrize("suffix", [".graphml", ".gml", ".json"])
@pytest.mark.parametrize(
    "graph",
    [
        streets(crs="epsg:4326"),
        streets(crs="EPSG:4326"),
        streets(crs="WGS84"),
        streets(crs="urn:ogc:def:crs:OGC:1.3:CRS84"),
        streets(("lon", "lat")),
        streets(("Longitude", "Latitude")),
    ],
)
def test_degrees_become_metres_and_edges_have_lengths_on_the_earth(tmp_path, graph, suffix):
    found, names = load_graph(write(tmp_path, graph, suffix))
    expected = [on_ellipsoid(*(STREETS[names[end]] for end in edge)) for edge in found.edges]
    assert 100 < min(expected) < 200
    np.testing.assert_allclose(found.lengths, expected, rtol=6e-3)
    # Positions are East and North of the middle, and as far apart as the streets are long.
    np.testing.assert_allclose(found.xy.min(axis=0), -found.xy.max(axis=0))
    straight = np.hypot(*(found.xy[found.edges[:, 0]] - found.xy[found.edges[:, 1]]).T)
    np.testing.assert_allclose(straight, expected, rtol=6e-3)
    east, north = found.xy[names.index("c")] - found.xy[names.index("a")]
    assert east > 0
    assert north > 0


def test_lengths_of_a_file_are_kept(tmp_path):
    graph = streets(crs="EPSG:4326")
    nx.set_edge_attributes(graph, dict(zip(graph.edges, [127.0, 130.5, 170.0, 180.0], strict=True)),
                           "length")  # fmt: skip
    found, _ = load_graph(write(tmp_path, graph))
    assert sorted(found.lengths.tolist()) == [127.0, 130.5, 170.0, 180.0]


def test_positions_across_the_antimeridian_are_side_by_side(tmp_path):
    graph = nx.Graph([("west", "east")])
    nx.set_node_attributes(graph, {"west": 179.99, "east": -179.99}, "lon")
    nx.set_node_attributes(graph, 0.0, "lat")
    found, _ = load_graph(write(tmp_path, graph))
    np.testing.assert_allclose(found.lengths, [math.radians(0.02) * 6378137], rtol=6e-3)
    np.testing.assert_allclose(abs(found.xy[0, 0] - found.xy[1, 0]), found.lengths[0], rtol=1e-6)


@pytest.mark.parametrize("graph", [streets(crs="EPSG:4326"), streets(("lon", "lat"))])
def test_degrees_of_a_networkx_graph_become_metres(graph):
    expected = [on_ellipsoid(STREETS[tail], STREETS[head]) for tail, head in graph.edges]
    made = Graph(graph)
    np.testing.assert_allclose(made.lengths, expected, rtol=6e-3)
    apart = np.hypot(*(made.xy[made.edges[:, 0]] - made.xy[made.edges[:, 1]]).T)
    np.testing.assert_allclose(apart, expected, rtol=6e-3)
    nx.set_edge_attributes(graph, 7.0, "length")
    assert Graph(graph).lengths.tolist() == [7.0] * 4


def test_networkx_graphs_without_edges_or_with_wrong_degrees_are_refused_in_a_sentence():
    with pytest.raises(ValueError, match="edges: the networkx graph has no edges"):
        Graph(nx.empty_graph(3))
    graph = streets(("lon", "lat"))
    graph.nodes["b"]["lat"] = 91.0
    with pytest.raises(ValueError, match="latitudes to 90"):
        Graph(graph)
    del graph.nodes["b"]["lat"]
    with pytest.raises(ValueError, match="'b' has no longitude and latitude"):
        Graph(graph)


def test_degrees_that_are_called_metres_are_refused_unless_edges_have_lengths(tmp_path):
    """A projected system, and none: streets of 100 m would be as long as a finger."""
    for graph in (streets(crs="EPSG:32610"), streets(crs="WGS 84 / UTM zone 10N"), streets()):
        with pytest.raises(ValueError, match=r"streets.graphml: x, y: expected metres, but the lo"):
            load_graph(write(tmp_path, graph))
        nx.set_edge_attributes(graph, 100.0, "length")
        with pytest.warns(Doubt, match="x and y are taken as degrees"):
            found, _ = load_graph(write(tmp_path, graph))
        # Streets of 100 m are not far apart.
        assert 100 < np.ptp(found.xy, axis=0).max() < 1000
        assert set(found.lengths.tolist()) == {100.0}


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ({"lon": 1.0, "lat": 91.0}, "lat: expected a finite number of at most 90 degrees, got 91"),
        ({"lon": "x", "lat": 1.0}, "lon: expected a finite number of at most 360 degrees"),
        ({"x": 1.0, "y": 1.0}, "it has no longitude and latitude, but other vertices have"),
        ({}, "it has no longitude and latitude, but other vertices have"),
    ],
)
def test_bad_positions_are_refused(tmp_path, place, message):
    graph = streets(("lon", "lat"))
    graph.add_node("e", **place)
    graph.add_edge("a", "e")
    with pytest.raises(ValueError, match=f"streets.json: nodes.4.*{message}"):
        load_graph(write(tmp_path, graph, ".json"))


def test_a_command_refuses_degrees_in_one_line(tmp_path, capsys):
    path = write(tmp_path, streets())
    assert main(["patrol", "graph", str(path), "--json"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "if x and y are degrees, name them lon and lat" in err
