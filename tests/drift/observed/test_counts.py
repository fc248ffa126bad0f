"""Counts of moves between cells of any shape, against SciPy, a heap and published values."""

import heapq
import shutil

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg

from jaxcell import bundled, drift, markov, record, study
from jaxcell.mapping import Chain


# Van Sebille, England and Froyland 2012: five patches of garbage, as (West, East, North).
PATCHES = [(-148, -140, 31), (-100, -100, -30), (-15, -15, -30), (-44, -44, 29), (59, 59, -29)]
# The example of driftmlp, and the days there and back that are reported for it. Of several ways to
# compute a route, only that without moves that stay gives them.
MEXICO, PORTUGAL, DAYS = "90.90W,23.88N", "9.88W,35.80N", (288, 537)


@pytest.fixture(scope="module")
def table():
    """The file, read without the library: cells from which drifters move, and shares."""
    with np.load(bundled("gdp")) as file:
        arrays = {name: file[name] for name in file}
    begin = np.repeat(np.arange(arrays["lon"].size), np.diff(arrays["indptr"]))
    end, count = arrays["indices"].astype(int), arrays["data"].astype(float)
    total = np.bincount(begin, count, arrays["lon"].size) + arrays["lost"]
    kept = np.flatnonzero(total)
    number = np.full(total.size, -1)
    number[kept] = np.arange(kept.size)
    known = number[end] >= 0
    share = (count / total[begin])[known]
    return arrays["lon"][kept], arrays["lat"][kept], number[begin[known]], number[end[known]], share


@pytest.fixture(scope="module")
def found():
    return study.Drifters(file=(bundled("gdp"),), from_=MEXICO, to=PORTUGAL).run()


def test_the_file_has_the_moves_of_the_global_drifter_program():
    with np.load(bundled("gdp")) as file:
        assert (file["lon"].size, file["data"].size) == (29_081, 438_622)
        assert int(file["data"].sum(dtype=np.int64)) == 39_493_605


def test_ten_years_are_those_of_a_sparse_matrix(table, found):
    lon, _, begin, end, share = table
    push = scipy.sparse.csr_array((share, (end, begin)), (lon.size, lon.size))
    mass = np.full(lon.size, 1 / lon.size)
    for _ in range(730):
        mass = push @ mass
    assert found.hours[-1] == 730 * 5 * 24
    np.testing.assert_allclose(found.share[-1], mass, rtol=1e-10, atol=1e-18)


def test_five_patches_are_within_3_degrees_of_the_published_places(found):
    assert found.patch_share.size == 5
    for west, east, north in PATCHES:
        off = np.maximum(np.maximum(west - found.patch_lon, found.patch_lon - east), 0)
        off = np.hypot(off * np.cos(np.radians(north)), found.patch_lat - north)
        assert off.min() < 3, (west, north, off)


def test_patches_have_the_shares_of_their_cells(found):
    assert 0.32 < found.patch_share.sum() < 0.35
    assert (found.patch_cells >= 200).all()
    assert (found.patch_density > 6).all()


def _shortest(steps, source, target):
    """The shortest way by a heap, and its length; `steps` has ends and lengths of each cell."""
    away, before, queue = {source: 0.0}, {}, [(0.0, source)]
    while queue:
        length, cell = heapq.heappop(queue)
        if cell == target:
            break
        if length > away[cell]:
            continue
        for after, more in steps[cell]:
            if length + more < away.get(after, np.inf):
                away[after], before[after] = length + more, cell
                heapq.heappush(queue, (length + more, after))
    path = [target]
    while path[-1] != source:
        path.append(before[path[-1]])
    return path[::-1], away[target]


@pytest.mark.parametrize("back", [False, True])
def test_routes_are_those_of_a_heap_and_take_the_published_days(table, found, back):
    lon, _, begin, end, share = table
    route = found.back if back else found.there
    stay = np.zeros(lon.size)
    stay[begin[begin == end]] = share[begin == end]
    steps = [[] for _ in lon]
    for a, b, p in zip(begin.tolist(), end.tolist(), share.tolist(), strict=True):
        if a != b:
            steps[a].append((b, -np.log(p / (1 - stay[a]))))
    source, target = int(route[0][0]), int(route[0][-1])
    path, _ = _shortest(steps, source, target)
    days = sum(5 / (1 - stay[cell]) for cell in path[:-1])
    assert route[0].tolist() == path
    assert route[1][-1] / 24 == pytest.approx(days, rel=1e-9)
    assert round(days) == DAYS[back]


def test_committor_and_likeliest_path_are_those_of_a_sparse_solve_and_a_heap(table):
    lon, _, begin, end, share = table
    moves = drift.open_counts(bundled("gdp"))
    source, target = moves.cell(-90.9, 23.88), moves.cell(-9.88, 35.8)
    matrix = scipy.sparse.csr_array((share, (begin, end)), (lon.size, lon.size))
    # Only cells that can come to the target have a probability, and the system then has a solution.
    can, reached = np.zeros(lon.size, bool), [target]
    into = matrix.tocsc()
    while reached:
        cell = reached.pop()
        if not can[cell]:
            can[cell] = True
            reached += into.indices[into.indptr[cell] : into.indptr[cell + 1]].tolist()
    can[[source, target]] = False
    inner = matrix[can][:, can]
    right = matrix[can][:, [target]].toarray()[:, 0]
    ahead = np.zeros(lon.size)
    ahead[can] = scipy.sparse.linalg.spsolve(scipy.sparse.eye_array(right.size) - inner, right)
    ahead[target] = 1
    found = markov.committor(moves.chain, source=source, target=target)
    np.testing.assert_allclose(found.value, ahead, atol=1e-9)

    steps = [[] for _ in lon]
    for a, b, p in zip(begin.tolist(), end.tolist(), share.tolist(), strict=True):
        steps[a].append((b, -np.log(p)))
    way, length = _shortest(steps, source, target)
    path, log_probability = markov.most_probable_path(moves.chain, source, target)
    assert path.tolist() == way
    assert log_probability == pytest.approx(-length)


def test_shares_that_stay_are_those_of_powers_of_a_matrix_and_of_the_tracks():
    """The Chapman-Kolmogorov test, with moves that are counted without the library."""
    seen, lag, side = drift.open_trajectories(bundled("drifters")), 5 * 86_400.0, 4.0
    cell = np.floor(seen.lon / side) * 1000 + np.floor(seen.lat / side)
    names, cell = np.unique(cell, return_inverse=True)
    place = {pair: cell[k] for k, pair in enumerate(zip(seen.drifter, seen.time, strict=True))}

    def pairs(steps):
        ends = [(c, place.get((d, t + steps * lag))) for (d, t), c in place.items()]
        return np.array([pair for pair in ends if pair[1] is not None]).T

    counts = np.zeros((names.size, names.size))
    np.add.at(counts, tuple(pairs(1)), 1)
    matrix = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    west = (names < np.median(seen.lon) / side * 1000).astype(int)
    observed = [(steps, *pairs(steps)) for steps in (1, 3)]
    test = markov.chapman_kolmogorov(Chain.from_scipy(matrix), west, observed)
    for row, (steps, begin, end) in enumerate(observed):
        power = np.linalg.matrix_power(matrix, steps)
        for number in (0, 1):
            inside = west[begin] == number
            stays = power[begin[inside]][:, west == number].sum(axis=1).mean()
            assert test.by_chain[row, number] == pytest.approx(stays)
            assert test.seen[row, number] == pytest.approx((west[end[inside]] == number).mean())


def test_first_lines_say_where_it_goes_and_how_long_it_takes(found):
    first, _, route = found.answer
    assert first.startswith("After 10 years 33.3 % of what was spread evenly over the sea is in 5")
    assert "288 days" in route
    assert "537 days" in route


def test_parts_of_the_drifters_add_up_to_all(table, found):
    """Five parts in all: two where no drifter was seen to go on, what is lost, patches, others."""
    lon, _, begin, end, share = table
    with np.load(bundled("gdp")) as file:
        sizes = np.diff(file["indptr"])
        total = np.bincount(np.repeat(np.arange(sizes.size), sizes), file["data"], sizes.size)
        total += file["lost"]
        no_cell = (file["lost"] / np.maximum(total, 1))[total > 0]
    push = scipy.sparse.csr_array((share, (end, begin)), (lon.size, lon.size))
    mass, lost = np.full(lon.size, 1 / lon.size), 0.0
    for _ in range(730):
        lost += no_cell @ mass
        mass = push @ mass
    stay = mass[push.diagonal() == 1].sum()
    assert found.lost == pytest.approx(lost, rel=1e-9)
    assert found.stayed == pytest.approx(stay, rel=1e-9)
    assert found.ended == pytest.approx(1 - mass.sum() - lost, rel=1e-9)
    assert "Of all, 23.9 % is where no drifter was seen to go on" in found.answer[1]


def test_moves_into_cells_left_out_are_in_doubt_and_no_fate_of_drifters():
    """Half of the moves from the first cell are into a cell with a move, one into an empty one."""
    counts = np.array([[5, 0, 4, 1], [0, 9, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]])
    moves = drift.CellCounts.of(np.arange(4.0), np.zeros(4), counts, 5.0, least=2)
    found = drift.CountedDrift.of(moves, after=5 * 86400.0)
    parts = found.removed, found.ended, found.stayed, found.lost
    assert parts == pytest.approx((0.2, 0.05, 0.5, 0))
    assert found.answer[0].startswith("In doubt: 20 % went into cells that --least leaves out")


def test_a_path_there_counts_and_lonely_cells_are_left_out():
    counts = np.array([[8, 2, 0], [5, 5, 0], [1, 0, 0]])
    moves = drift.CellCounts.of([0.0, 1.0, 2.0], np.zeros(3), counts, 5.0, least=2)
    assert moves.cells == 2
    cells, hours = moves.route(0, 1)
    assert (cells.tolist(), hours.tolist()) == ([0, 1], [0.0, pytest.approx(5 * 24 / 0.2)])


def test_places_belong_to_the_nearest_cell():
    moves = drift.CellCounts.of([0.0, 1.0, 180.0], np.zeros(3), np.eye(3), 5.0)
    assert [moves.cell(0.6, 0.0), moves.cell(-180.0, 0.2)] == [1, 2]
    with pytest.raises(ValueError, match=r"no drifter was at \(0, 5\); the nearest cell is 556 km"):
        moves.cell(0.0, 5.0)


GRAPH = """<?xml version="1.0"?><graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="x" for="node" attr.name="lon"/><key id="y" for="node" attr.name="lat"/>
<key id="d" for="graph" attr.name="day_cut_off"/><key id="p" for="edge" attr.name="prob"/>
<key id="c" for="edge" attr.name="N"/>
<graph edgedefault="directed"><data key="d">5</data>
<node id="a"><data key="x">0</data><data key="y">10</data></node>
<node id="b"><data key="x">1</data><data key="y">10</data></node>
<edge source="a" target="b"><data key="p">0.25</data><data key="c">1</data></edge>
<edge source="a" target="a"><data key="p">0.5</data><data key="c">2</data></edge>
<edge source="b" target="b"><data key="p">1</data><data key="c">7</data></edge>
</graph></graphml>"""


@pytest.mark.parametrize("counted", [True, False])
def test_graphml_is_read_with_counts_or_shares(tmp_path, counted):
    path = tmp_path / "moves.GraphML"
    path.write_text(GRAPH if counted else GRAPH.replace('"c"', '"other"').replace('"N"', '"M"'))
    moves = drift.open_counts(path)
    assert moves.lag == 5 * 86400
    assert moves.chain.to_scipy().toarray().tolist() == [[0.5, 0.25], [0.0, 1.0]]
    assert moves.total.tolist() == ([4.0, 7.0] if counted else [1.0, 1.0])


def test_h3_cells_have_the_places_of_the_bundled_file(tmp_path):
    with np.load(bundled("gdp")) as file:
        names, lon = file["h3"][[100, 2000]].tolist(), file["lon"][[100, 2000]].tolist()
    text = GRAPH.replace('attr.name="lon"', 'attr.name="name"')
    for old, new in zip(("0", "1"), names, strict=True):
        text = text.replace(f'<data key="x">{old}<', f'<data key="x">{new}<')
    path = tmp_path / "moves.graphml"
    path.write_text(text)
    assert drift.open_counts(path).lon.tolist() == lon
    path.write_text(text.replace(str(names[0]), "7"))
    with pytest.raises(ValueError, match=r"moves.graphml: node 7: expected lon and lat"):
        drift.open_counts(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lon": None}, "expected lon, and found none"),
        ({"data": np.array([-1, 1])}, "0 or more"),
        ({"data": np.array([0.5, 1.5])}, "sums of at most 1, got 1.5"),
        ({"lat": np.array([0.0, 91.0])}, "positions in degrees"),
        ({"days": np.array(0.0)}, "more than 0 days"),
        ({"data": np.array([0, 0])}, "2 cells or more"),
        ({"indptr": np.array([0, 1, 9])}, "moves.npz"),
    ],
)
def test_wrong_arrays_are_refused(tmp_path, change, message):
    path, one = tmp_path / "moves.npz", np.array([1, 1])
    arrays = {"lon": 1.0 * one, "lat": 0.0 * one, "days": np.array(5.0), "data": one}
    arrays |= {"indices": np.array([1, 0]), "indptr": np.array([0, 1, 2])} | change
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(ValueError, match=message):
        drift.open_counts(path)
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(ValueError, match=r"moves\.npz: "):
        drift.open_counts(path)


def test_parameters_of_trajectories_are_refused_for_counts():
    with pytest.raises(ValueError, match="lag: it has no effect on counts of moves"):
        study.Drifters(file=(bundled("gdp"),), lag=2.0)
    with pytest.raises(ValueError, match="from_: it has no effect on trajectories"):
        study.Drifters(file=(bundled("drifters"),), from_="1,2", to="3,4")
    with pytest.raises(ValueError, match="from_ '90Q,2': expected"):
        study.Drifters(file=(bundled("gdp"),), from_="90Q,2", to="3,4")


def test_a_hexagon_is_drawn_as_the_squares_nearest_to_it(tmp_path):
    """Three rows of hexagons at 20 N, of which the middle one gathers drifters."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(3.0))
    lon, lat = (x + (y % 2) / 2).ravel() / np.cos(np.radians(20)), (20 + y * np.sqrt(3) / 2).ravel()
    share = np.full((15, 15), 0.01)
    share[:, 7] = 0.86
    counts = drift.CellCounts.of(lon, lat, share, 5.0)
    found = drift.CountedDrift.of(counts, after=50 * 86400.0, source=0, target=14)
    map = found.on_squares(np.arange(15))
    water = found.waters[0]
    for cell in range(15):
        mine = map == cell
        assert mine.any()
        centre = water.lon[water.row[mine], water.column[mine]].mean()
        assert centre == pytest.approx(lon[cell], abs=0.4)
    record.save_recording(found, tmp_path / "found.rrd")
    assert (tmp_path / "found.rrd").stat().st_size > 1000
    assert found.plot().get_title().startswith("logarithm")


def test_a_copy_of_the_file_is_counts_too(tmp_path):
    shutil.copy(bundled("gdp"), tmp_path / "mine.npz")
    found = study.Drifters(file=(tmp_path / "mine.npz",), after=30.0, least=100).run()
    assert (found.counts.total >= 100).all()
    assert found.hours[-1] == 30 * 24


def test_least_is_refused_for_shares(tmp_path):
    shares = scipy.sparse.csr_array(np.array([[0.5, 0.5], [0.2, 0.8]]))
    matrix = {name: getattr(shares, name) for name in ("data", "indices", "indptr")}
    np.savez(tmp_path / "shares.npz", lon=[0.0, 1.0], lat=[0.0, 0.0], days=5.0, **matrix)
    with pytest.raises(ValueError, match="least: it has no effect on shares of moves, got 5"):
        study.Drifters(file=(tmp_path / "shares.npz",), least=5).run()
