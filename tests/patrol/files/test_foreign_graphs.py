"""Graphs as other programs save them; each file is written here."""

import json

import numpy as np
import pytest

from jaxcell.base.doubts import Doubt
from jaxcell.cli import main
from jaxcell.patrol.files import load_graph, load_problem, load_ways


HEAD = (
    '<graphml xmlns="http://graphml.graphdrawing.org/xmlns">'
    '<key id="y" for="node" attr.name="y" attr.type="double"/>'
    '<key id="x" for="node" attr.name="x" attr.type="double"/>'
    '<key id="l" for="edge" attr.name="length" attr.type="double"/>'
    '<key id="t" for="edge" attr.name="seconds" attr.type="double"/>'
)


def streets(folder, edges, kind="directed", places=((4.0, 60.0), (4.002, 60.0), (4.0, 60.001))):
    """Write streets as OSMnx does, with places in degrees; an edge has ends and a length."""
    nodes = [
        f'<node id="{v}"><data key="x">{x}</data><data key="y">{y}</data></node>'
        for v, (x, y) in enumerate(places)
    ]
    lines = [
        f'<edge source="{tail}" target="{head}"><data key="l">{length}</data>'
        f'<data key="t">{length / 5}</data></edge>'
        for tail, head, length in edges
    ]
    text = f'{HEAD}<graph edgedefault="{kind}">{"".join(nodes + lines)}</graph></graphml>'
    (folder / "streets.graphml").write_text(text)
    return folder / "streets.graphml"


BOTH = [(0, 1, 115.0), (1, 0, 115.0), (0, 2, 130.0), (2, 0, 130.0)]


def test_streets_given_once_each_way_are_undirected(tmp_path):
    with pytest.warns(Doubt, match="x and y are taken as degrees, because edges are 10,000 times"):
        graph, names = load_graph(streets(tmp_path, BOTH))
    assert (names, graph.edges.tolist(), graph.lengths.tolist()) == (
        ("0", "1", "2"),
        [[0, 1], [0, 2]],
        [115, 130],
    )
    # 0.002 degrees of longitude at 60 N, and 0.001 of latitude, on a sphere of 6,371 km.
    np.testing.assert_allclose(np.ptp(graph.xy, axis=0), [111.2, 111.2], rtol=1e-3)


def test_loops_and_parallel_streets_are_left_out_and_said(tmp_path):
    path = streets(tmp_path, [(0, 1, 300), (1, 0, 260), (0, 2, 130), (2, 2, 50)], "undirected")
    with pytest.warns(Doubt) as doubts:
        graph, _ = load_graph(path)
    assert sorted(map(tuple, np.sort(graph.edges).tolist())) == [(0, 1), (0, 2)]
    assert sorted(graph.lengths.tolist()) == [130, 260]
    said = "\n".join(str(doubt.message) for doubt in doubts)
    assert f"{path}: 1 loop is left out: a robot can wait" in said
    assert f"{path}: 1 parallel edge is left out: the shortest of them is used" in said


@pytest.mark.filterwarnings("ignore::jaxcell.base.doubts.Doubt")
def test_one_way_streets_are_refused_with_the_command_that_takes_them(tmp_path, capsys):
    one_way = streets(tmp_path, BOTH[:3])
    with pytest.raises(ValueError, match=r"edgedefault: 1 of its 3 ways have no way back.*guard"):
        load_graph(one_way)
    differs = streets(tmp_path, [*BOTH[:3], (2, 0, 131.0)])
    with pytest.raises(ValueError, match=r"edgedefault: ways back have other lengths; .* guard"):
        load_graph(differs)
    options = ["--attack-time", "120", "--speed", "5"]
    assert main(["patrol", "guard", str(differs), *options, "--json"]) == 0


@pytest.mark.filterwarnings("ignore::jaxcell.base.doubts.Doubt")
def test_the_option_names_the_attribute_that_is_the_length(tmp_path, capsys):
    path = streets(tmp_path, BOTH)
    assert load_graph(path, "seconds")[0].lengths.tolist() == [23, 26]
    with pytest.raises(ValueError, match="`weight`: no edge has 'minutes'"):
        load_graph(path, "minutes")
    assert main(["patrol", "graph", str(path), "--weight", "minutes"]) == 2
    assert "--weight: no edge has 'minutes'" in capsys.readouterr().err


def test_lists_of_weighted_edges_are_read_with_the_option(tmp_path):
    path = tmp_path / "out.edges"
    path.write_text("% sym weighted\n1 2 5.5\n2 3 7 1082040961\n3 1 2\n")
    with pytest.raises(ValueError, match=r"expected a vertex|has no edges.* set `weight`"):
        load_graph(path)
    graph, names = load_graph(path, "weight")
    assert (names, graph.lengths.tolist()) == (("1", "2", "3"), [5.5, 7, 2])
    ways = load_ways(path, "weight", directed=True)
    assert ways.ends.tolist() == [[0, 1], [1, 2], [2, 0]]
    path.write_text("1 2 5.5\n2 3 7\n")
    with pytest.raises(ValueError, match=r"it has no edges: a line of three words is a vertex, .*"):
        load_graph(path)


def route(start, end, **more):
    line = {"type": "MultiLineString", "coordinates": []}
    return {"properties": {"id": 9, "startid": start, "endid": end, **more}, "geometry": line}


def test_route_graphs_of_nav2_are_read(tmp_path):
    points = [
        {"properties": {"id": v, "frame": "map"}, "geometry": {"type": "Point", "coordinates": at}}
        for v, at in enumerate([[0.0, 0.0], [3.0, 4.0, 0.1], [3.0, 0.0]])
    ]
    lines = [route(0, 1, cost=2.0), route(1, 0, cost=2.0), route(1, 2, cost=1.0)]
    path = tmp_path / "routes.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [*points, *lines]}))
    ways = load_ways(path)
    assert (ways.ends.tolist(), ways.lengths.tolist()) == ([[0, 1], [1, 0], [1, 2]], [5, 5, 4])
    assert load_ways(path, "cost").lengths.tolist() == [2, 2, 1]
    with pytest.raises(ValueError, match="startid: 1 of its 3 ways have no way back"):
        load_graph(path)
    path.write_text(json.dumps({"features": [*points, *lines, route(2, 1)]}))
    assert load_graph(path)[0].edges.tolist() == [[0, 1], [1, 2]]


def test_problems_of_rosso_are_read_as_ways_with_times(tmp_path, capsys):
    matrix = [[1, 3, 4], [2, 1, 5], [4, 6, 1]]
    about = {"weight_matrix": matrix, "tau": 10, "stationary_distribution": [0.5, 0.3, 0.2]}
    path = tmp_path / "problem.json"
    path.write_text(json.dumps({"problem_params": about}))
    with pytest.warns(Doubt, match="stationary_distribution and tau are not used; give"):
        ways = load_ways(path)
    expected = [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]]
    assert (ways.ends.tolist(), ways.lengths.tolist()) == (expected, [3, 4, 2, 5, 4, 6])
    problem = load_problem(path)
    assert (problem.travel_times.tolist(), problem.attack_time) == (matrix, 10)
    assert problem.graph.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert problem.stationary.tolist() == [0.5, 0.3, 0.2]
    for wrong, said in [
        ([1], "problem_params"),
        ({"problem_params": about | {"tau": 0}}, "tau: expected a whole number"),
        ({"problem_params": about | {"weight_matrix": [[1, 2]]}}, "whole numbers, 1 x 1"),
        ({"problem_params": about | {"weight_matrix": [[1, -2], [1, 1]]}}, "expected"),
        ({"problem_params": about | {"stationary_distribution": [1, 0]}}, "3"),
    ]:
        (tmp_path / "wrong.json").write_text(json.dumps(wrong))
        with pytest.raises(ValueError, match=said):
            load_problem(tmp_path / "wrong.json")
    words = ["patrol", "guard", str(path), "--attack-time", "10", "--speed", "1", "--json"]
    assert main(words) == 0
    assert "not used; give --attack-time" in capsys.readouterr().err


def test_doctor_knows_them(tmp_path, capsys):
    assert main(["doctor", str(streets(tmp_path, [*BOTH, (1, 1, 5)])), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert (report["what"], report["vertices"], report["edges"]) == ("a graph", 3, 2)
    degrees, loop = report["doubts"]
    assert "taken as degrees" in degrees
    assert "1 loop is left out" in loop


def saved(folder, links, directed=False):
    """Write a graph of three vertices in a row, and links with attributes."""
    nodes = [{"id": name, "x": 3.0 * k, "y": 0.0} for k, name in enumerate("abc")]
    path = folder / "row.json"
    path.write_text(json.dumps({"directed": directed, "nodes": nodes, "links": links}))
    return path


def joined(**attributes):
    return [{"source": tail, "target": head, **attributes} for tail, head in ("ab", "bc")]


@pytest.mark.parametrize("name", ["distance", "travel_time", "weight", "cost"])
def test_lengths_under_another_name_are_doubted_until_named(tmp_path, capsys, name):
    path = saved(tmp_path, joined(**{name: 10.0}))
    guard = ["patrol", "guard", str(path), "--attack-time", "90", "--speed", "1"]
    for line in (["doctor", str(path), "--json"], guard, ["patrol", "graph", str(path)]):
        main(line)
        said = "".join(capsys.readouterr())
        assert "edges have no attribute length" in said
        assert f"to read another attribute as length, set --weight {name}" in said
    assert main([*guard, "--weight", name]) == 0
    assert "no attribute length" not in capsys.readouterr().err
    assert main([*guard, "--weight", "wait"]) == 2
    assert f"--weight: no edge has 'wait'; they have {name}" in capsys.readouterr().err


def test_streets_marked_oneway_in_an_undirected_graph_are_doubted(tmp_path):
    path = saved(tmp_path, joined(oneway="yes", length=3.0))
    for read in (load_graph, load_ways):
        with pytest.warns(Doubt, match=r"2 of 2 edges of an undirected graph are marked oneway"):
            read(path)
    assert load_ways(path, directed=True).ends.tolist() == [[0, 1], [1, 2]]


def test_vertices_without_a_way_back_are_said_above_the_answer(tmp_path, capsys):
    path = saved(tmp_path, joined(), directed=True)
    assert main(["patrol", "guard", str(path), "--attack-time", "6"]) == 0
    out, err = capsys.readouterr()
    assert "2 of 3 vertices are no targets, because no way leads there and back: a, b" in err
    assert "At the targets that can be guarded, no intruder escapes" in out
    assert main(["doctor", str(path), "--json"]) == 1
    [doubt] = json.loads(capsys.readouterr().out)["doubts"]
    assert doubt.endswith("to choose, set --targets")
