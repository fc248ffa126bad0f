import csv
import dataclasses
import itertools
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import xarray as xr
from recordings import read_back
from seas import sea

from jaxcell import drift, record
from jaxcell.drift.ranks import basin_ranks
from jaxcell.mapping import Chain
from jaxcell.record.canvas.stream import new_stream
from jaxcell.record.drift.frame import place_name, round_below
from jaxcell.record.drift.groups import group_classes
from jaxcell.record.drift.map import Clock, CurrentMap


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"
# At 5 m, in the western basin.
GOAL = 538 + 167

pytestmark = pytest.mark.usefixtures("few_drifters")


def study(currents, step=None, *, goal=None, **options):
    """A study of the mean of currents, by the functions of the library."""
    names = {"source": "sea.nc", "east_from": "u", "north_from": "v", "notes": ""}
    found = drift.SeaDrift.of(
        currents.assign_attrs({**names, **currents.attrs}), step, mean=True, **options
    )
    return found if goal is None else found.towards(goal)


@pytest.fixture(scope="module")
def gyres(few_drifters):
    # The goal is at 5 m.
    return study(
        drift.open_currents(GYRES), drift.DriftStep(3400), start=317, goal=GOAL, reach=6000.0
    )


@pytest.fixture(scope="module")
def dataset(gyres, tmp_path_factory):
    file = tmp_path_factory.mktemp("drift") / "drift.nc"
    record.save_dataset(record.dataset(gyres, spec={"file": "gyres"}), file)
    return xr.load_dataset(file)


@pytest.fixture(scope="module")
def leaving():
    """A sea in which everything drifts to the East, and off the grid, past an island."""
    wet = np.ones((4, 7), bool)
    wet[1, 3] = False
    east = np.where(wet, 0.5, 0)
    return study(sea(east, 0.1 * east, wet, angle=0.5), drift.DriftStep(2000, edge="exit"))


def kinds(found, name, water):
    """The class of each cell in a picture of a recording."""
    buffer = found.static(f"/map/grid/{name}", "SegmentationImage:buffer")[0]
    return np.reshape(buffer, water.number.shape)[water.row, water.column].astype(int)


def map_of(sea, number):
    """The map of one layer."""
    return CurrentMap(new_stream("test"), sea, Clock.of(sea), number)


def by_cell(dataset, name):
    """The values of a variable by the number of the cell."""
    wet = dataset.cell.values >= 0
    values = np.empty(wet.sum(), dataset[name].dtype)
    values[dataset.cell.values[wet]] = dataset[name].values[wet]
    return values


def test_the_dataset_holds_the_chain_and_the_arrays_of_all_layers(gyres, dataset):
    cells = gyres.cells
    entries = dataset.transition.values, (dataset.from_cell.values, dataset.to_cell.values)
    matrix = scipy.sparse.coo_array(entries, shape=(cells, cells)).toarray()
    np.testing.assert_array_equal(matrix, gyres.sea.drift.to_scipy().toarray())
    begins = [layer.begins for layer in gyres.layers]
    for name, of_layer in {
        "group": lambda k: begins[k].groups.group,
        "transient_group": lambda k: begins[k].transient.group,
        "basin": lambda k: begins[k].basin,
        "absorption_time": lambda k: begins[k].hours,
        "leaving": lambda k: gyres.layers[k].leaving,
    }.items():
        expected = np.concatenate([np.asarray(of_layer(k)) for k in range(3)])
        np.testing.assert_array_equal(by_cell(dataset, name), expected, err_msg=name)
    for k, layer in enumerate(gyres.layers):
        wet = dataset.cell[k].values >= 0
        for group, chance in enumerate(np.asarray(layer.ends.value)):
            values = dataset.probability.sel(layer=k, group_index=group).values[wet]
            np.testing.assert_array_equal(values, chance)
    parts = [(k, n) for k in range(3) for n in range(begins[k].transient.count)]
    bounds = itertools.pairwise(dataset.domicile_offset.values)
    for (k, n), (first, last) in zip(parts, bounds, strict=True):
        homes = tuple(dataset.domicile.values[first:last])
        assert homes == begins[k].transient.domiciles[n]
    assert [*zip(dataset.transient_layer, dataset.transient_number, strict=True)] == parts


def test_the_dataset_has_places_units_and_the_spec(gyres, dataset):
    assert dataset.attrs["Conventions"] == "CF-1.8"
    assert json.loads(dataset.attrs["spec"]) == {"file": "gyres"}
    assert float(dataset.step) == 3400
    assert dataset.lon.standard_name == "longitude"
    assert dataset.depth.values.tolist() == [0, 5, 10]
    # Land is where there is no water.
    for name, blank in (("group", -2), ("voyage_action", -2)):
        assert ((dataset[name].values == blank) == ~gyres.currents.water.values).all()
    assert (np.isnan(dataset.absorption_time.values) == ~gyres.currents.water.values).all()
    cell = int(dataset.deployment_cell[1])
    lon, lat, depth = gyres.place(cell)
    row, column = np.argwhere(dataset.cell[0].values == cell)[0]
    assert (lon, lat, depth) == (dataset.lon[row, column], dataset.lat[row, column], 0)
    assert gyres.place(538 + 538)[2] == 10


def test_deployment_files(gyres, dataset, tmp_path):
    record.save_deployment(gyres, tmp_path / "d.csv")
    record.save_deployment(gyres, tmp_path / "d.geojson")
    with (tmp_path / "d.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    places = json.loads((tmp_path / "d.geojson").read_text())
    assert places["type"] == "FeatureCollection"
    assert len(rows) == len(places["features"])
    for row, feature in zip(rows, places["features"], strict=True):
        lon, lat = feature["geometry"]["coordinates"]
        assert (row["lon"], row["lat"]) == (str(lon), str(lat))
        # The cell is the one whose centre is there.
        assert gyres.waters[0].cell(lon, lat) == int(row["cell"]) == feature["properties"]["cell"]
        assert (row["group"] == "") != (row["transient_group"] == "")
    reach = [int(row["cell"]) for row in rows if row["purpose"] == "reach"]
    assert reach == dataset.deployment_cell.values.tolist()
    assert [int(row["cell"]) for row in rows if row["purpose"] == "view"] == (
        gyres.views.cells.tolist()
    )
    with pytest.raises(FileNotFoundError, match="no folder"):
        record.save_deployment(gyres, tmp_path / "none" / "d.csv")
    with pytest.raises(
        ValueError, match=r"d\.xls: expected a name that ends in \.csv or \.geojson"
    ):
        record.save_deployment(gyres, tmp_path / "d.xls")


@pytest.fixture(scope="module")
def found(gyres, tmp_path_factory, read):
    file = tmp_path_factory.mktemp("drift") / "drift.rrd"
    record.save_recording(gyres, file, spec={"file": "a|b", "seed": 3})
    assert file.stat().st_size < 6_000_000
    return read(file)


def test_the_recording_shows_groups(gyres, found):
    assert len(found.blueprints) == 1
    assert found.timelines == {"minute", "date"}
    scale = np.reshape(found.static("/map", "Transform3D:scale"), -1)
    np.testing.assert_array_equal(scale, [1, -1, 1])
    for layer, water in enumerate(gyres.waters):
        behaviour = gyres.layers[layer].behaviour
        labels, rank = found.classes(f"/map/grid/groups_{layer}"), gyres.group_ranks[layer]
        group, part = np.asarray(behaviour.groups.group), np.asarray(behaviour.transient.group)
        assert labels[0] == "land"
        for cell, kind in enumerate(kinds(found, f"groups_{layer}", water).tolist()):
            homes = () if group[cell] >= 0 else behaviour.transient.domiciles[part[cell]]
            if group[cell] >= 0:
                expected = f"persistent group {rank[group[cell]]}"
            elif len(homes) == 1:
                expected = f"ends in group {rank[homes[0]]} for sure"
            else:
                expected = f"may end in groups {', '.join(map(str, sorted(rank[list(homes)])))}"
            assert labels[kind] == expected
    # A group and what leads there for sure have one colour, in two shades.
    kind, classes = group_classes(gyres.layers[0], gyres.group_ranks[0])
    colors = {one.label: np.array(one.color[:3], float) for one in classes}
    for number in range(3):
        full, pale = (
            colors[name]
            for name in (f"persistent group {number}", f"ends in group {number} for sure")
        )
        assert full.argmax() == pale.argmax() or np.ptp(pale) < np.ptp(full)
        assert pale.sum() > full.sum()


def test_a_label_stands_deep_in_its_set_of_cells(gyres):
    """Around a hole, too, where the middle of all cells is not one of them."""
    map = map_of(gyres, 0)
    water = map.water
    row, column = water.row - water.row.mean(), water.column - water.column.mean()
    ring = np.abs(np.hypot(row, column) - 8) < 2.5
    assert ring.any()
    x, y = map.middle(ring)
    at = np.linalg.norm(map.xy() - [x, y], axis=1).argmin()
    assert ring[at]
    assert np.hypot(row[at] - row[~ring], column[at] - column[~ring]).min() > 1.5


def test_the_distribution_plays(gyres, found):
    pictures = found.over("minute", "/map/grid/distribution_1", "SegmentationImage:buffer")
    water, chain = gyres.waters[1], gyres.layers[1].behaviour.chain.to_scipy()
    assert [*pictures][:3] == [0, 57, 113]
    share = np.full(water.cells, 1 / water.cells)
    for buffer in list(pictures.values())[:4]:
        kind = np.reshape(buffer, water.number.shape)[water.row, water.column].astype(int)
        # The class is higher where there are more, and 1 below a sixteenth of what was there.
        np.testing.assert_array_equal(kind == 1, share * water.cells < 1 / 16)
        assert (np.diff(kind[np.argsort(share)]) >= 0).all()
        share = share @ chain


@pytest.fixture(scope="module")
def asked(leaving):
    """A recording with regions and beaches, and what it shows."""
    surface = leaving.layers[0]
    column = surface.water.column
    inside = np.stack([column < 3, column == 3])
    exchange = drift.Exchange.of(surface.behaviour, ["west", "strait"], inside, 2 * leaving.step)
    beaching = drift.Stranded.of(surface.water, surface.behaviour, 6000, afloat=2000.0)
    found = dataclasses.replace(leaving, exchange=exchange, beaching=beaching)
    return found, read_back(found, {})


def test_the_recording_shows_regions_and_their_exchange(asked):
    found, shown = asked
    exchange = found.exchange
    labels = shown.static("/exchange/matrix/labels", "Points2D:labels")
    assert labels == ["west", "strait", "west", "strait", "elsewhere", "off the map"]
    numbers = shown.static("/exchange/matrix/numbers", "Points2D:labels")
    numbers = np.array(numbers, float).reshape(2, 4)
    np.testing.assert_allclose(numbers.sum(axis=1), 100, atol=0.2)
    np.testing.assert_allclose(numbers[:, :2], 100 * exchange.share, rtol=5e-3, atol=1e-9)
    names = shown.static("/map/region_names", "Points2D:labels")
    assert names == [f"west: {exchange.residence_hours[0]:.3g} h",
                     f"strait: {exchange.residence_hours[1]:.3g} h"]  # fmt: skip


def test_the_recording_shows_beaches_and_how_many_strand(asked):
    found, shown = asked
    water, beaching = found.waters[0], found.beaching
    np.testing.assert_array_equal(kinds(shown, "beached", water) > 1, drift.coast(water))
    ends = np.array(shown.static("/beaching/curve/share", "LineStrips2D:strips")[0])
    assert len(ends) == beaching.steps + 1
    assert np.ptp(ends[:, 1]) > 0


def test_a_colour_is_of_one_place_in_all_layers():
    """Groups 0 and 1 of the top are 1 and 2 below, of other sizes; 0 is new there, and lasts."""
    top = np.array([[0, 0, 1, 1, 1, -1]])
    middle = np.array([[1, 1, 2, 2, -1, 0]])
    deep = np.array([[-1, 1, 0, -1, -1, 2]])
    found = basin_ranks([top, middle, deep])
    assert [rank.tolist() for rank in found] == [[1, 0], [2, 1, 0], [0, 1, 2]]
    # In the middle either of two groups could go on; all together have most in common.
    crossed = basin_ranks(
        [np.array([[0] * 5 + [1] * 4]), np.array([[0] * 4 + [1] + [0] * 3 + [1]])]
    )
    assert [rank.tolist() for rank in crossed] == [[0, 1], [0, 1]]
    none = basin_ranks([np.full((1, 6), -1), top])
    assert [rank.tolist() for rank in none] == [[], [1, 0]]


def test_the_recording_shows_currents_and_drifters(gyres, found):
    sea_map = map_of(gyres, 0)
    arrows = found.over("minute", "/map/current_1", "Arrows2D:vectors")
    # A day, and what comes until the drifters have gone on for 40 steps.
    assert list(arrows) == [60 * hour for hour in range(38)]
    water = gyres.waters[1]
    for time in (0, 600):
        east = gyres.currents.u.values[time // 60, 1][water.row, water.column]
        north = gyres.currents.v.values[time // 60, 1][water.row, water.column]
        shown = np.array(arrows[time])
        along = shown / np.linalg.norm(shown, axis=1, keepdims=True)
        np.testing.assert_allclose(
            along, np.stack([east, north], axis=1) / np.hypot(east, north)[:, None], atol=2e-3
        )
    places = found.over("minute", "/map/drifters_0/here", "Points2D:positions")
    width, height = sea_map.size
    assert len(places) == sea_map.clock.frames + 1
    first, last = (np.array(places[time]) for time in (0, sea_map.clock.last))
    for at in (first, last):
        square = np.floor(at / sea_map.side).astype(int)
        assert (gyres.waters[0].number[square[:, 1], square[:, 0]] >= 0).all()
    # They gather.
    assert first.std(axis=0).prod() > last.std(axis=0).prod()
    assert last[:, 0].max() < width
    assert last[:, 1].max() < height


def test_the_recording_shows_times_deployment_and_reach(gyres, found):
    sea_map = map_of(gyres, 0)
    kind = kinds(found, "absorption_0", gyres.waters[0])
    hours = np.asarray(gyres.layers[0].behaviour.hours)
    assert (kind[hours == 0] == 1).all()
    order = np.argsort(hours)
    assert (np.diff(kind[order]) >= 0).all()
    marks = np.array(found.static("/map/deployment", "Points2D:positions"))
    np.testing.assert_allclose(marks, sea_map.xy(gyres.deployment.cells), rtol=1e-5)
    labels = found.classes("/map/grid/reach_2")
    kind = kinds(found, "reach_2", gyres.waters[2])
    stays = np.array(["stays" in labels[number] for number in kind])
    np.testing.assert_array_equal(stays, gyres.of_layer(gyres.reachable[0], 2))
    text = found.static("/reach/text", "TextDocument:text")[0]
    assert f"| 10 m | {stays.sum()} |" in text
    assert "| file | a&#124;b |" in found.static("/groups/text", "TextDocument:text")[0]
    assert f"**{gyres.views.cells.size}** drifters" in (
        found.static("/deployment/text", "TextDocument:text")[0].replace("\n", " ")
    )
    assert len(found.static("/map/views/discs", "LineStrips2D:strips")) == gyres.views.cover.size


def test_the_recording_shows_the_voyage(gyres, found):
    action = np.asarray(gyres.voyage.policy.action)
    vectors = np.array(found.static("/space/policy/arrows", "Arrows3D:vectors"))
    others = np.delete(np.arange(action.size), GOAL)
    assert (np.sign(np.round(vectors[:, 2], 6)) == -action[others]).all()
    assert (np.abs(vectors[action[others] == 0][:, :2]).sum(axis=1) > 0).all()
    goal = np.array(found.static("/space/goal", "Points3D:positions"))
    assert goal.shape == (1, 3)
    place = map_of(gyres, 1).xy(np.array([GOAL - 538]))[0]
    np.testing.assert_allclose(goal[0, :2], place, rtol=1e-5)
    assert goal[0, 2] < 0
    # Drifters start above one another, at the surface.
    places = found.over("minute", "/space/drifters", "Points3D:positions")
    first = np.array(places[0])
    assert np.ptp(first[:, 2]) == 0
    assert np.ptp(first[:, :2], axis=0).max() < 1
    text = found.static("/voyage/text", "TextDocument:text")[0]
    assert "| surest | 100 % | 1,512 |" in text


def test_a_sea_without_groups_start_or_goal_has_a_recording(leaving):
    """No groups, no start, no goal, one record, a turned grid; drifters go."""
    found = read_back(leaving)
    assert not {one for one in found.entities if "reach" in one or one.startswith("/space")}
    places = found.over("minute", "/map/drifters_0/here", "Points2D:positions")
    counts = [0 if one is None else len(one) for one in places.values()]
    assert counts[0] == 27
    assert counts[-1] < counts[0]
    # None is drawn on the island.
    for at in places.values():
        square = np.floor(np.reshape(at or [], (-1, 2))).astype(int)
        assert (leaving.waters[0].number[square[:, 1], square[:, 0]] >= 0).all()
    assert (
        "| 0 m | 27 | 0 | none | 27 | 0 |" in found.static("/groups/text", "TextDocument:text")[0]
    )
    assert "leaves the map for sure" in found.classes("/map/grid/groups_0")
    arrow = np.array(found.static("/map/frame/north", "Arrows2D:vectors"))[0]
    assert np.arctan2(arrow[0], arrow[1]) == pytest.approx(0.5)
    # Arrows are along the grid: the current, turned back by its angle.
    (vectors,) = found.over("minute", "/map/current_0", "Arrows2D:vectors").values()
    angle = np.arctan2(*np.array(vectors)[0, ::-1])
    assert angle == pytest.approx(np.arctan2(0.1, 1) - 0.5, abs=1e-5)


def test_drifters_and_their_ways_around_the_earth():
    """All stay on the map, and no way is drawn from one side of it to the other."""
    columns = 12
    one = sea(np.full((3, columns), 1.0), np.zeros((3, columns)), dx=3e6, dy=3e6)
    column, row = np.meshgrid(np.arange(columns), np.arange(3))
    one = one.assign_coords(lon=(("y", "x"), 30.0 * column), lat=(("y", "x"), 27.0 * row - 27))
    found = read_back(study(one, drift.DriftStep(3e6, edge="exit")))
    places = found.over("day", "/map/drifters_0/here", "Points2D:positions")
    x = np.array([np.array(at)[:, 0] for at in places.values()])
    assert (x >= 0).all()
    assert (x <= 3000 * columns).all()
    assert (np.abs(np.diff(x, axis=0)) > 20_000).any()  # some go across the seam
    trails = found.over("day", "/map/drifters_0/trail", "LineStrips2D:strips")
    for time, strips in trails.items():
        for number, strip in enumerate(strips):
            assert np.abs(np.diff(np.array(strip)[:, 0])).max(initial=0) < 3000
            np.testing.assert_allclose(strip[-1], places[time][number], atol=1e-3)


def test_all_cells_persistent():
    """Nothing is absorbed, so that there is no tab about it."""
    swirl = np.linspace(-1, 1, 5)
    lone = study(
        sea(np.tile(swirl[:, None], 5), np.tile(-swirl, (5, 1))),
        drift.DriftStep(2000, spread="all"),
    )
    assert lone.layers[0].transient_groups == 0
    found = read_back(lone)
    assert not {entity for entity in found.entities if "absorption" in entity}


def test_cells_that_take_almost_forever_are_shown():
    """An eddy that holds drifters for some 10^20 steps, in cells that are transient."""
    currents = drift.open_currents(GYRES, depths=0)
    water, flow = drift.Water.of(currents), drift.Flow.of(currents).mean()
    chain = drift.drift_map(water, flow, drift.DriftStep(3600))
    behaviour = drift.long_term_behaviour(chain, 3600, throw=False)
    late = np.asarray(behaviour.absorption.value) > 10_000
    assert 0 < late.sum() < water.cells
    lone = study(currents, drift.DriftStep(3600))
    np.testing.assert_array_equal(lone.layers[0].almost_forever, late)
    found = read_back(lone)
    labels = found.classes("/map/grid/absorption_0")
    kind = kinds(found, "absorption_0", water)
    shown = np.array([labels[number].startswith("almost forever") for number in kind])
    np.testing.assert_array_equal(shown, late)
    text = found.static("/absorption/text", "TextDocument:text")[0]
    assert f"| {late.sum()} |" in text
    assert "take what holds" in text.replace("\n", " ")


def test_a_large_sea_makes_a_small_file(tmp_path):
    row, column = np.mgrid[:60, :90] / 15
    currents = sea(np.sin(np.pi * row), np.sin(np.pi * column), dx=5000.0)
    large = study(currents, drift.DriftStep(2000, spread="all"), start=5, goal=np.arange(1500))
    record.save_recording(large, tmp_path / "large.rrd")
    assert (tmp_path / "large.rrd").stat().st_size < 3_000_000


def test_many_groups_have_few_colours():
    """Every cell is a group of its own where the step is too short."""
    east = np.random.default_rng(0).uniform(-1, 1, (2, 15, 20))
    lone = study(sea(*east), drift.DriftStep(100, edge="exit"), start=0)
    assert lone.layers[0].persistent_groups > 200
    found = read_back(lone)
    labels = found.classes("/map/grid/groups_0")
    assert len(labels) <= 255
    assert "a smaller persistent group" in labels
    assert lone.layers[0].warning in found.static("/groups/text", "TextDocument:text")[0]


@pytest.mark.parametrize(
    ("duration", "hours", "unit", "frame"),
    [
        (4 * 86400, 24, "day", 1),
        (4 * 3600, 1, "hour", 1),
        (40, 0.01, "second", 10),
        (2400, 24, "minute", 18),
        (9, 1, "second", 45),
    ],
)
def test_the_clock_is_as_fine_as_the_steps(duration, hours, unit, frame):
    currents = sea(*np.full((2, 3, 3, 4), 0.2), hours=hours)
    lone = study(currents, drift.DriftStep(duration, spread="all"))
    clock = Clock.of(lone)
    assert clock.unit == unit
    assert clock.frame == frame
    # It goes on for 40 steps, and until the current of three records begins again.
    wanted = max(40 * duration, 3 * hours * 3600)
    assert wanted <= clock.last * clock.seconds <= wanted + clock.frame * clock.seconds
    assert clock.frames <= 241


def test_layers_and_starts_of_other_seas_are_refused(gyres):
    for change, message in (
        ({"layers": gyres.layers[:2]}, "layers: expected 3, got 2"),
        ({"start": 538}, "start: expected a cell of the surface, 0 to 537"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(gyres, **change)


def altered(layer, **fields):
    """A layer with other fields in its behaviour."""
    behaviour = dataclasses.replace(layer.behaviour, **fields)
    return dataclasses.replace(layer, behaviour=behaviour, measured=layer.compared)


def test_a_layer_that_contradicts_itself_is_refused(gyres):
    layer = gyres.layers[0]
    behaviour = layer.behaviour
    chain, group = behaviour.chain, behaviour.groups.group
    few = Chain(chain.image, 0.99 * chain.probability)
    moved = dataclasses.replace(behaviour.groups, group=jnp.roll(group, 1))
    ends = dataclasses.replace(layer.ends, value=0.9 * layer.ends.value)
    wrong = altered(layer)
    wrong.__dict__["ends"] = ends
    for one, name in (
        (altered(layer, chain=few), "steps_out_of_persistent_groups"),
        (altered(layer, groups=moved), "steps_out_of_persistent_groups"),
        (wrong, "ends_sum_to_1"),
    ):
        value, limit = one.checks()[name]
        assert value > limit
        with pytest.raises(RuntimeError, match=f"the result contradicts itself: {name} is"):
            record.dataset(dataclasses.replace(gyres, layers=(one, *gyres.layers[1:])))
    chance = jnp.roll(layer.ends.value, 1, axis=0)
    wrong.__dict__["ends"] = dataclasses.replace(ends, value=chance)
    assert wrong.checks()["ends_residual"][0] < 1e-8
    chance = layer.ends.value.at[0, 100].add(0.1).at[1, 100].add(-0.1)
    wrong.__dict__["ends"] = dataclasses.replace(ends, value=chance)
    assert wrong.checks()["ends_residual"][0] > 1e-3


def test_times_are_reported_and_refuse_nothing(gyres):
    layer = gyres.layers[0]
    solve = layer.behaviour.absorption
    slow = altered(layer, absorption=dataclasses.replace(solve, value=1.5 * solve.value))
    found = record.dataset(dataclasses.replace(gyres, layers=(slow, *gyres.layers[1:])))
    assert found.attrs["check_absorption_time_residual"] > 0.01


def test_places_and_round_lengths():
    assert place_name(-118.1, 33.456) == "33.46° N, 118.10° W"
    assert place_name(5.0, -0.5) == "0.50° S, 5.00° E"
    assert [round_below(one) for one in (7.2, 1.9, 0.05, 99.0)] == [5, 1, 0.05, 50]


def test_nearly_closed_sets_are_in_the_dataset_the_summary_and_the_recording(leaving):
    chains = [layer.behaviour.chain for layer in leaving.layers]
    sets = drift.ClosedSets.of(leaving.waters, chains, leaving.step, 2)
    found = dataclasses.replace(leaving, nearly_closed_sets=sets)
    dataset = record.dataset(found)
    number = dataset.nearly_closed_sets_number.values[0]
    assert ((number == -2) == ~leaving.currents.water.values[0]).all()
    for rank, size in enumerate(dataset.nearly_closed_sets_size.values):
        assert (number == rank).sum() == size
    listed = record.summary(found)["nearly_closed_sets"]["sets"]
    assert [row["leakage"] for row in listed] == sets.leakage.tolist()
    assert "nearly_closed_sets" not in record.summary(leaving)
    recorded = read_back(found, {})
    shown = kinds(recorded, "nearly_closed_0", leaving.waters[0])
    # 0 is land and 1 is in no set.
    np.testing.assert_array_equal(np.unique(shown), np.unique(number[number > -2] + 2))
    text = recorded.static("/nearly_closed/text", "TextDocument:text")[0]
    assert f"after **{sets.window_hours:.3g} hours**" in text
