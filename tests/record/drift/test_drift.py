import dataclasses

import numpy as np
import pytest
from recordings import read_back
from seas import double_gyre, drift_of, sea

from jaxcell import bundled, drift
from jaxcell.base.formatting import in_time
from jaxcell.record.canvas.stream import new_stream
from jaxcell.record.drift.map import Clock, CurrentMap


# The goal of `gyres`.
GOAL = 538 + 167

pytestmark = pytest.mark.usefixtures("few_drifters")


@pytest.fixture(scope="module")
def leaving():
    """A sea in which everything drifts to the East, and off the grid, past an island."""
    wet = np.ones((4, 7), bool)
    wet[1, 3] = False
    east = np.where(wet, 0.5, 0)
    return drift_of(sea(east, 0.1 * east, wet, angle=0.5), drift.DriftStep(2000, edge="exit"))


def kinds(recording, name, water):
    """The class of each cell in a picture of a recording."""
    return recording.picture(f"/map/grid/{name}")[water.row, water.column].astype(int)


def labels(recording, name, water):
    """The label of each cell in a picture of a recording."""
    return recording.labels(f"/map/grid/{name}")[water.row, water.column]


def map_of(sea, number):
    """The map of one layer."""
    return CurrentMap(new_stream("test"), sea, Clock(sea), number)


@pytest.fixture(scope="module")
def recording(gyres):
    recording = read_back(gyres, {"file": "a|b", "seed": 3})
    assert recording.size < 6_000_000
    return recording


def test_the_recording_shows_groups(gyres, recording):
    assert recording.timelines == {"minute", "date"}
    for layer, water in enumerate(gyres.waters):
        behaviour = gyres.layers[layer].behaviour
        rank = gyres.group_ranks[layer]
        group, part = np.asarray(behaviour.groups.group), np.asarray(behaviour.transient.group)
        assert recording.classes(f"/map/grid/groups_{layer}")[0] == "land"
        for cell, label in enumerate(labels(recording, f"groups_{layer}", water)):
            homes = () if group[cell] >= 0 else behaviour.transient.domiciles[part[cell]]
            if group[cell] >= 0:
                expected = f"persistent group {rank[group[cell]]}"
            elif len(homes) == 1:
                expected = f"ends in group {rank[homes[0]]} for sure"
            else:
                expected = f"may end in groups {', '.join(map(str, sorted(rank[list(homes)])))}"
            assert label == expected


def test_a_label_stands_deep_in_its_set_of_cells(gyres):
    """Around a hole, too, where the middle of all cells is not one of them."""
    map = map_of(gyres, 0)
    water = map.water
    row, column = water.row - water.row.mean(), water.column - water.column.mean()
    ring = np.abs(np.hypot(row, column) - 8) < 2.5
    assert ring.any()
    x, y = map.middle(ring)
    at = np.linalg.norm(map.xy(np.arange(map.water.cells)) - [x, y], axis=1).argmin()
    assert ring[at]
    assert np.hypot(row[at] - row[~ring], column[at] - column[~ring]).min() > 1.5


def test_the_distribution_plays(gyres, recording):
    pictures = recording.pictures("minute", "/map/grid/distribution_1")
    water, chain = gyres.waters[1], gyres.layers[1].behaviour.chain.to_scipy()
    assert [*pictures][:3] == [0, 57, 113]
    share = np.full(water.cells, 1 / water.cells)
    for picture in list(pictures.values())[:4]:
        kind = picture[water.row, water.column].astype(int)
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
    sea = dataclasses.replace(leaving, exchange=exchange, beaching=beaching)
    return sea, read_back(sea, {})


def test_the_recording_shows_regions_and_their_exchange(asked):
    sea, shown = asked
    exchange = sea.exchange
    names = shown.static("/exchange/matrix/labels", "Points2D:labels")
    assert names == ["west", "strait", "west", "strait", "elsewhere", "off the map"]
    numbers = shown.static("/exchange/matrix/numbers", "Points2D:labels")
    numbers = np.array(numbers, float).reshape(2, 4)
    np.testing.assert_allclose(numbers.sum(axis=1), 100, atol=0.2)
    np.testing.assert_allclose(numbers[:, :2], 100 * exchange.share, rtol=5e-3, atol=1e-9)
    names = shown.static("/map/region_names", "Points2D:labels")
    assert names == [f"west: {exchange.residence_hours[0]:.3g} h",
                     f"strait: {exchange.residence_hours[1]:.3g} h"]  # fmt: skip


def test_the_recording_shows_beaches_and_how_many_strand(asked):
    sea, shown = asked
    water, beaching = sea.waters[0], sea.beaching
    np.testing.assert_array_equal(kinds(shown, "beached", water) > 1, drift.coast(water))
    ends = np.array(shown.static("/beaching/curve/share", "LineStrips2D:strips")[0])
    assert len(ends) == beaching.steps + 1
    assert np.ptp(ends[:, 1]) > 0


def test_the_recording_shows_currents_and_drifters(gyres, recording):
    sea_map = map_of(gyres, 0)
    arrows = recording.over("minute", "/map/current_1", "Arrows2D:vectors")
    # A day, and what comes until the drifters have gone on for 40 steps.
    assert list(arrows) == [60 * hour for hour in range(38)]
    water = gyres.waters[1]
    for time in (0, 600):
        east = gyres.currents.u.values[time // 60, 1][water.row, water.column]
        north = gyres.currents.v.values[time // 60, 1][water.row, water.column]
        shown = np.array(arrows[time])
        along = shown / np.linalg.norm(shown, axis=1, keepdims=True)
        expected = np.stack([east, north], axis=1) / np.hypot(east, north)[:, None]
        np.testing.assert_allclose(along, expected, atol=2e-3)
    places = recording.over("minute", "/map/drifters_0/here", "Points2D:positions")
    assert len(places) == sea_map.clock.frames + 1
    first, last = (np.array(places[time]) for time in (0, sea_map.clock.last))
    for at in (first, last):
        square = np.floor(at / sea_map.side).astype(int)
        assert (gyres.waters[0].number[square[:, 1], square[:, 0]] >= 0).all()
    # They gather.
    assert first.std(axis=0).prod() > last.std(axis=0).prod()
    assert (last < sea_map.size).all()


def test_the_recording_shows_times_deployment_and_reach(gyres, recording):
    sea_map = map_of(gyres, 0)
    kind = kinds(recording, "absorption_0", gyres.waters[0])
    hours = np.asarray(gyres.layers[0].behaviour.hours)
    assert (kind[hours == 0] == 1).all()
    order = np.argsort(hours)
    assert (np.diff(kind[order]) >= 0).all()
    marks = np.array(recording.static("/map/deployment", "Points2D:positions"))
    np.testing.assert_allclose(marks, sea_map.xy(gyres.deployment.cells), rtol=1e-5)
    stays = np.array(["stays" in label for label in labels(recording, "reach_2", gyres.waters[2])])
    np.testing.assert_array_equal(stays, gyres.of_layer(gyres.reachable[0], 2))
    text = recording.text("/reach/text")
    assert f"| 10 m | {stays.sum()} |" in text
    assert "| file | a&#124;b |" in recording.text("/groups/text")
    assert f"**{gyres.views.cells.size}** drifters" in (
        recording.text("/deployment/text").replace("\n", " ")
    )
    assert (
        len(recording.static("/map/views/discs", "LineStrips2D:strips")) == gyres.views.cover.size
    )


def test_the_recording_shows_the_voyage(gyres, recording):
    action = np.asarray(gyres.voyage.policy.action)
    vectors = np.array(recording.static("/space/policy/arrows", "Arrows3D:vectors"))
    others = np.delete(np.arange(action.size), GOAL)
    assert (np.sign(np.round(vectors[:, 2], 6)) == -action[others]).all()
    assert (np.abs(vectors[action[others] == 0][:, :2]).sum(axis=1) > 0).all()
    goal = np.array(recording.static("/space/goal", "Points3D:positions"))
    assert goal.shape == (1, 3)
    place = map_of(gyres, 1).xy(np.array([GOAL - 538]))[0]
    np.testing.assert_allclose(goal[0, :2], place, rtol=1e-5)
    assert goal[0, 2] < 0
    # Drifters start above one another, at the surface.
    places = recording.over("minute", "/space/drifters", "Points3D:positions")
    first = np.array(places[0])
    assert np.ptp(first[:, 2]) == 0
    assert np.ptp(first[:, :2], axis=0).max() < 1
    text = recording.text("/voyage/text")
    assert "| surest | 100 % | 1,512 |" in text


def test_a_sea_without_groups_start_or_goal_has_a_recording(leaving):
    """No groups, no start, no goal, one record, a turned grid; drifters go."""
    recording = read_back(leaving)
    assert not {one for one in recording.entities if "reach" in one or one.startswith("/space")}
    places = recording.over("minute", "/map/drifters_0/here", "Points2D:positions")
    counts = [0 if one is None else len(one) for one in places.values()]
    assert counts[0] == 27
    assert counts[-1] < counts[0]
    # None is drawn on the island.
    for at in places.values():
        square = np.floor(np.reshape(at or [], (-1, 2))).astype(int)
        assert (leaving.waters[0].number[square[:, 1], square[:, 0]] >= 0).all()
    assert "| 0 m | 27 | 0 | none | 27 | 0 |" in recording.text("/groups/text")
    assert "leaves the map for sure" in recording.classes("/map/grid/groups_0")
    arrow = np.array(recording.static("/map/frame/north", "Arrows2D:vectors"))[0]
    assert np.arctan2(arrow[0], arrow[1]) == pytest.approx(0.5)
    # Arrows are along the grid: the current, turned back by its angle.
    (vectors,) = recording.over("minute", "/map/current_0", "Arrows2D:vectors").values()
    angle = np.arctan2(*np.array(vectors)[0, ::-1])
    assert angle == pytest.approx(np.arctan2(0.1, 1) - 0.5, abs=1e-5)


def test_drifters_and_their_ways_around_the_earth():
    """All stay on the map, and no way is drawn from one side of it to the other."""
    columns = 12
    one = sea(np.full((3, columns), 1.0), np.zeros((3, columns)), dx=3e6, dy=3e6)
    column, row = np.meshgrid(np.arange(columns), np.arange(3))
    one = one.assign_coords(lon=(("y", "x"), 30.0 * column), lat=(("y", "x"), 27.0 * row - 27))
    recording = read_back(drift_of(one, drift.DriftStep(3e6, edge="exit")))
    places = recording.over("day", "/map/drifters_0/here", "Points2D:positions")
    x = np.array([np.array(at)[:, 0] for at in places.values()])
    assert (x >= 0).all()
    assert (x <= 3000 * columns).all()
    assert (np.abs(np.diff(x, axis=0)) > 20_000).any()  # some go across the seam
    trails = recording.over("day", "/map/drifters_0/trail", "LineStrips2D:strips")
    for time, strips in trails.items():
        for number, strip in enumerate(strips):
            assert np.abs(np.diff(np.array(strip)[:, 0])).max(initial=0) < 3000
            np.testing.assert_allclose(strip[-1], places[time][number], atol=1e-3)


def test_all_cells_persistent():
    """Nothing is absorbed, so that there is no tab about it."""
    swirl = np.linspace(-1, 1, 5)
    currents = sea(np.tile(swirl[:, None], 5), np.tile(-swirl, (5, 1)))
    lone = drift_of(currents, drift.DriftStep(2000, spread="all"))
    assert lone.layers[0].transient_groups == 0
    recording = read_back(lone)
    assert not {entity for entity in recording.entities if "absorption" in entity}


def test_cells_that_take_almost_forever_are_shown():
    """An eddy that holds drifters for some 10^20 steps, in cells that are transient."""
    currents = drift.open_currents(bundled("gyres"), depths=0)
    water, flow = drift.Water.of(currents), drift.Flow.of(currents).mean()
    chain = drift.drift_map(water, flow, drift.DriftStep(3600))
    behaviour = drift.long_term_behaviour(chain, 3600, throw=False)
    late = np.asarray(behaviour.absorption.value) > 10_000
    assert 0 < late.sum() < water.cells
    lone = drift_of(currents, drift.DriftStep(3600))
    np.testing.assert_array_equal(lone.layers[0].almost_forever, late)
    recording = read_back(lone)
    shown = np.char.startswith(labels(recording, "absorption_0", water), "almost forever")
    np.testing.assert_array_equal(shown, late)
    text = recording.text("/absorption/text")
    assert f"| {late.sum()} |" in text
    assert "take what holds" in text.replace("\n", " ")


def test_a_large_sea_makes_a_small_file():
    row, column = np.mgrid[:60, :90] / 15
    currents = sea(np.sin(np.pi * row), np.sin(np.pi * column), dx=5000.0)
    large = drift_of(currents, drift.DriftStep(2000, spread="all"), start=5, goal=np.arange(1500))
    assert read_back(large).size < 3_000_000


def test_many_groups_have_few_colours():
    """Every cell is a group of its own where the step is too short."""
    east = np.random.default_rng(0).uniform(-1, 1, (2, 15, 20))
    lone = drift_of(sea(*east), drift.DriftStep(100, edge="exit"), start=0)
    assert lone.layers[0].persistent_groups > 200
    recording = read_back(lone)
    classes = recording.classes("/map/grid/groups_0")
    assert len(classes) <= 255
    assert "a smaller persistent group" in classes
    assert lone.layers[0].warning in recording.text("/groups/text")


def test_nearly_closed_sets_are_in_the_recording():
    closed = drift_of(double_gyre(8, 16), drift.METHODS["drifters"].lasting(2000))
    chains = [layer.behaviour.chain for layer in closed.layers]
    sets = drift.ClosedSets.of(closed.waters, chains, closed.step, 2)
    sea = dataclasses.replace(closed, nearly_closed_sets=sets)
    number = sets.number[0]
    assert ((number == -2) == ~closed.currents.water.values[0]).all()
    assert [(number == rank).sum() for rank in sets.rank] == sets.size.tolist()
    recording = read_back(sea, {})
    shown = kinds(recording, "nearly_closed_0", closed.waters[0])
    # 0 is land and 1 is in no set.
    np.testing.assert_array_equal(np.unique(shown), np.unique(number[number > -2] + 2))
    text = recording.text("/nearly_closed/text")
    assert f"after **{in_time(sets.window_hours)}**" in text
