import dataclasses
import itertools

import numpy as np
import pytest
from changed_results import changed
from recordings import packed, read_back
from scipy.spatial.distance import cdist
from walks import times_by_solves, walk_on

from jaxcell import bundled
from jaxcell.mapping import Chain
from jaxcell.optimize import Graph, minimum_commute
from jaxcell.patrol import GraphPatrol, random_walk
from jaxcell.patrol.files.graph_files import load_graph
from jaxcell.patrol.team import age_of_news, charged
from jaxcell.patrol.walks import memory_patrol
from jaxcell.patrol.walks.game import strategy_game
from jaxcell.record import dataset
from jaxcell.record.canvas.palette import ramp


@pytest.fixture(scope="module")
def eight():
    return load_graph(bundled("eight"))


@pytest.fixture(scope="module")
def weights(eight):
    return minimum_commute(eight[0]).weights


def patrol_of(graph, weights=None, names=None, **more):
    weights = np.ones(len(graph.edges)) if weights is None else weights
    return GraphPatrol.of(graph, random_walk(graph, weights), names=names, **more)


@pytest.fixture(scope="module")
def patrol(eight, weights):
    return patrol_of(eight[0], weights, eight[1], robots=2, seed=3)


@pytest.fixture(scope="module")
def game(eight):
    return strategy_game(eight[0], [1, 4, 7], names=eight[1])


@pytest.fixture(scope="module")
def with_game(patrol, game):
    return dataclasses.replace(patrol, game=game)


def nearest(graph, places):
    """The vertex nearest to each place."""
    return cdist(places, graph.xy).argmin(axis=1)


def test_the_text_names_strategy_attack_and_capture(eight):
    patrol_with_capture = patrol_of(eight[0], names=eight[1], attack_time=4)
    text = read_back(patrol_with_capture, {"strategy": "capture", "attack_time": 4}).text()
    place = int(np.argmin(patrol_with_capture.captured))
    assert "The strategy is **capture**." in text
    assert "An attack takes **4 steps**." in text
    assert f"**{patrol_with_capture.captured[place]:.3f}**, at vertex {eight[1][place]}." in text


def test_the_dataset_holds_the_walk(eight, weights, patrol):
    graph, names = eight
    times = times_by_solves(walk_on(graph, weights))
    data = dataset(patrol)
    np.testing.assert_allclose(data.hitting_time, times, rtol=1e-9)
    np.testing.assert_allclose(data.commute_time, times + times.T, rtol=1e-9)
    np.testing.assert_allclose(data.mean_time_to, times.sum(axis=0) / 7)
    np.testing.assert_allclose(data.weight, weights, atol=1e-12)
    assert data.edges_used == (weights > 1e-6).sum()
    assert data.ends.values.tolist() == [[names[i], names[j]] for i, j in graph.edges.tolist()]
    np.testing.assert_allclose(
        data.probabilities[:, 0],
        data.transition.sel(start=data.ends[:, 0], target=data.ends[:, 1]),
    )
    np.testing.assert_array_equal(np.stack([data.x, data.y], axis=1), graph.xy)


def test_names_are_numbers_and_positions_may_be_missing():
    graph = Graph([[0, 1], [1, 2]])
    data = dataset(patrol_of(graph))
    assert data.vertex.values.tolist() == ["0", "1", "2"]
    assert "x" not in data.coords
    assert data.slem == 1


@pytest.mark.parametrize(
    ("field", "wrong", "check"),
    [
        ("transition", lambda P: P / 2, "transition_sums_to_1"),
        ("stationary", lambda share: share[::-1], "stationarity_residual"),
        ("hitting_time", lambda times: 1.01 * times, "hitting_time_residual"),
        ("hitting_time", lambda times: -times, "hitting_time_below_0"),
        ("game.commitment.weights", lambda weights: weights / 2, "game_share_sums_to_1"),
    ],
)
def test_a_walk_that_contradicts_itself_is_refused(with_game, field, wrong, check):
    with pytest.raises(RuntimeError, match=check):
        dataset(changed(with_game, field, wrong))


def test_the_recording_shows_the_walk(eight, weights, patrol):
    graph, names = eight
    recording = read_back(patrol, {"graph": "a|b"})
    np.testing.assert_allclose(recording.static("/graph/idle", "Points2D:positions"), graph.xy)
    assert recording.static("/graph/names", "Points2D:labels") == list(names)

    # The edges by their weights.
    ends = np.array(recording.static("/graph/shares", "LineStrips2D:strips"))
    np.testing.assert_allclose(ends, graph.xy[graph.edges])
    radii = np.array(recording.static("/graph/shares", "LineStrips2D:radii"))
    np.testing.assert_array_equal(
        np.argsort(np.round(radii, 6), kind="stable"),
        np.argsort(np.round(weights, 6), kind="stable"),
    )

    # The halves of the edges by the probabilities.
    halves = np.array(recording.static("/graph/next", "LineStrips2D:strips"))
    labels = recording.static("/graph/chances", "Points2D:labels")
    begin, middle = halves.swapaxes(0, 1)
    tails, heads = nearest(graph, begin), nearest(graph, begin + (middle - begin) / 0.48)
    chances = patrol.transition[tails, heads]
    np.testing.assert_allclose(np.array(labels, float), chances, atol=6e-4)

    # Patrollers walk along edges, and vertices turn yellow as they are there.
    neighbours = {frozenset(edge) for edge in graph.edges.tolist()}
    walks = []
    for robot in range(2):
        places = recording.over("step", f"/graph/patrollers/{robot}/here", "Points2D:positions")
        here = nearest(graph, np.concatenate([*places.values()])).tolist()
        assert all(frozenset(step) in neighbours for step in itertools.pairwise(here))
        walks.append(here)
    assert walks[0] != walks[1]
    colors = recording.over("step", "/graph/idle", "Points2D:colors")
    longest = recording.over("step", "/walk/longest", "Scalars:scalars")
    assert len(colors) == len(longest) == len(walks[0]) == 1001
    yellow = packed(ramp(np.ones(1))[0].tolist())
    last = np.zeros(graph.vertices, int) - 1
    for time, shown in colors.items():
        last[[walks[0][time], walks[1][time]]] = time
        assert {v for v in range(8) if shown[v] == yellow} == {walks[0][time], walks[1][time]}
        assert longest[time] == [(time - last).max()]

    # The heat map, with the means below.
    shown = recording.picture("/times/matrix/heat")
    times = patrol.hitting_time
    assert (np.diag(shown) == 1).all()
    off = ~np.eye(8, dtype=bool)
    order = np.argsort(times[off])
    assert (np.diff(shown[:8][off][order].astype(int)) >= 0).all()
    assert shown[:8][off].min() == 2
    assert shown[:8][off].max() == 33

    text = recording.text()
    assert "| mean commute time over pairs of vertices | 18.6" in text
    assert "| 7 | 19.5 % | 4.9" in text
    assert "| graph | a&#124;b |" in text
    assert not any(one.startswith("/game/") for one in recording.entities)


def test_the_recording_shows_who_waits_how_long(eight):
    graph, names = eight
    patrol = patrol_of(graph, names=names)
    news = age_of_news(graph, patrol.matrices, 1, names=names)
    kept = charged(graph, patrol.matrices, 1, 8, names=names)
    recording = read_back(dataclasses.replace(patrol, news=news, charged=kept))
    times = [1 / patrol.stationary, news.mean_age, kept.idleness]
    most = np.max(times)
    for number, shown in enumerate(times):
        labels = recording.static(f"/graph/waits/{number}", "Points2D:labels")
        assert labels == [f"{one:.3g} steps" for one in shown]
        colors = recording.static(f"/graph/waits/{number}", "Points2D:colors")
        assert colors == [packed(color) for color in ramp(1 - shown / most).tolist()]
    # The curve of each vertex rises with the age, in a plane whose y points down.
    for vertex in range(graph.vertices):
        (curve,) = recording.static(f"/waits/news/{vertex}", "LineStrips2D:strips")
        height = -np.array(curve)[:, 1] / 90
        np.testing.assert_allclose(height, news.known[: len(height), vertex], atol=1e-6)
    bars = recording.picture("/waits/charges/interval")
    assert np.argmax(bars.sum(axis=0)) == kept.interval.argmax()
    assert "/waits/news/0" not in read_back(patrol).entities


def test_recorded_patrollers_walk_with_their_memory():
    """To and fro between the ends of a line, which no walk without memory does."""
    line = Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
    plain = random_walk(line, np.ones(2))
    there = np.zeros((6, 6))
    # State 0 of the memory leads right, and state 1 left.
    there[[0, 1, 2, 3, 4, 5], [1, 2, 4, 1, 3, 4]] = 1
    matrices = plain.to_scipy().toarray()[None]
    walks_with_memory = dataclasses.replace(
        memory_patrol(line, 4, 1, matrices, names="abc"), memory=2, chance=there[None]
    )
    patrol = GraphPatrol.of(line, plain, names="abc", walks_with_memory=walks_with_memory)
    recording = read_back(patrol)
    assert "| memory 1 | 75 %" in recording.text()
    shares = recording.static("/graph/vertices", "Points2D:labels")
    assert shares == [f"{share} % of the time" for share in (25, 50, 25)]
    idle = recording.over("step", "/graph/idle", "Points2D:colors")
    assert len({tuple(idle[step]) for step in range(100, 200)}) == 4


def test_the_recording_shows_the_game(with_game, game):
    recording = read_back(with_game)
    text = recording.text("/game/text")
    assert "| vertex that it attacks | 2 |" in text
    assert "| payoff of the patroller | 7.69" in text
    assert "| all vertices |" in text
    assert "| 7, 2, 5, 3, 8, 1, 4, 6 |" in text
    payoffs = {"patroller": game.patroller_payoff, "adversary": game.adversary_payoff}
    for who, payoff in payoffs.items():
        labels = recording.static(f"/game/{who}/labels", "Points2D:labels")
        assert labels[:10] == game.strategy
        numbers = recording.static(f"/game/{who}/numbers", "Points2D:labels")
        assert numbers == [f"{one:.3g}" for one in payoff.ravel()]


def test_a_walk_that_turns_one_way_and_waits():
    """Probabilities differ by direction, some are 0, and a patroller may stay."""
    graph = Graph([[0, 1], [1, 2], [2, 0]], xy=[[0, 0], [1, 0], [0, 1]])
    chain = Chain.from_scipy(np.array([[0.5, 0.5, 0], [0, 0, 1.0], [1.0, 0, 0]]))
    patrol = GraphPatrol.of(graph, chain)
    recording = read_back(patrol)
    labels = recording.static("/graph/chances", "Points2D:labels")
    assert labels == ["0.500", "1.000", "1.000", "0.000", "0.000", "0.000"]
    assert recording.static("/graph/stay", "Points2D:labels")[0] == "stays with probability 0.5"
    np.testing.assert_allclose(dataset(patrol).weight, [0.25, 0.25, 0.25])


def test_a_large_graph_makes_a_small_file():
    side = 20
    at = np.arange(side * side).reshape(side, side)
    ends = (at[:, :-1], at[:, 1:]), (at[:-1], at[1:])
    edges = np.concatenate([np.stack([one.ravel() for one in pair], axis=1) for pair in ends])
    graph = Graph(edges, xy=np.argwhere(at >= 0))
    recording = read_back(patrol_of(graph))
    assert recording.size < 5_000_000
    text = recording.text()
    assert "| 340 more |  |  |" in text
    assert "| steps until within 1/4 of the shares of time | never |" in text
    assert not {"/times/matrix/labels", "/times/matrix/numbers"} & recording.entities


@pytest.mark.parametrize("xy", [None, [[1, 1], [1, 1]]])
def test_vertices_without_a_place_or_in_one_place_have_a_recording(xy):
    assert read_back(patrol_of(Graph([[0, 1]], xy=xy))).entities


def test_parts_of_different_patrols_are_refused(eight, weights, game):
    graph, names = eight
    other = Graph(graph.edges[:-1], xy=graph.xy)
    chain = random_walk(graph, weights)
    for on, more, message in (
        (other, {}, "from vertex 1 to 6, between which there is no edge"),
        (Graph([[0, 1]]), {}, "chain: expected 2 vertices, got 8"),
        (graph, {"names": names[:3]}, "names: expected 8, one per vertex, got 3"),
        (graph, {"robots": 0}, "robots: expected a whole number of at least 1, got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            GraphPatrol.of(on, chain, **more)
    path = Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
    with pytest.raises(ValueError, match="game: expected walks on 2 edges, got 13"):
        patrol_of(path, game=game)
