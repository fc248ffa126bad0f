import dataclasses
import itertools

import jax
import numpy as np
import pytest
import shapely
import xarray as xr
from changed_results import changed
from recordings import packed, read_back

from jaxcell.optimize import Graph
from jaxcell.patrol import Attack, Capture, capture_policies, vulnerability
from jaxcell.patrol.map import capture_frontier
from jaxcell.patrol.map.intruder import AttackState, simulate_attacks
from jaxcell.record import dataset, save_dataset
from jaxcell.record.canvas.palette import CATEGORIES, KNOWN, PLAIN
from jaxcell.space import CellSpace, Workspace, visibility_polygon
from jaxcell.study import PatrolMap


TIMES = [6, 20, 40]


@pytest.fixture(scope="module")
def patrol(tmp_path_factory):
    """A function that patrols a small hall with two obstacles, not at the origin."""
    obstacles = [[[3, 2], [4, 2], [4, 4], [3, 4]], [[6, 3], [7, 3], [7, 5], [6, 5]]]
    hall = Workspace([[1, 1], [11, 1], [11, 6], [1, 6]], obstacles, name="hall|way")
    hall.save(path := tmp_path_factory.mktemp("map") / "hall.json")
    options = {"range": 2.5, "share": 0.8, "attack_times": tuple(TIMES), "runs": 400, "seed": 4}
    return lambda **more: PatrolMap(map=path, cell=1.0, **options, **more).run()


@pytest.fixture(scope="module")
def alone(patrol):
    return patrol(robots=2)


@pytest.fixture(scope="module")
def based(patrol):
    return patrol(robots=3, base="auto", lost=1)


@pytest.fixture(scope="module")
def recording(alone):
    return read_back(alone, {"map": "a|b"})


def on_cells(patrol, picture):
    """The classes of the cells in a picture; other squares have class 0."""
    assert (picture[~patrol.cells.free] == 0).all()
    return picture[patrol.cells.free]


def places(patrol, recording, entity):
    """The cell of a robot by time."""
    shown = recording.over("step", entity, "Points2D:positions")
    x, y = np.concatenate(list(shown.values())).T
    return patrol.cells.index(x.astype(float), y.astype(float)) % patrol.cells.positions


def test_the_dataset_holds_the_walks_and_a_map_of_capture(alone, tmp_path):
    file = tmp_path / "patrol.nc"
    save_dataset(dataset(alone), file)
    with xr.open_dataset(file) as data:
        np.testing.assert_array_equal(np.stack([data.x, data.y], axis=1), alone.xy)
        for robot, policy in enumerate(alone.policies):
            cover = data.cover.values[robot]
            np.testing.assert_array_equal(cover[cover >= 0], policy.cover)
            np.testing.assert_array_equal(data.weight[robot], policy.weights)
            # The walk can be rebuilt from its branches.
            P = np.zeros((alone.cells.positions,) * 2)
            for image, chance in zip(data.image[robot], data.probability[robot], strict=True):
                used = image.values >= 0
                np.add.at(P, (np.flatnonzero(used), image.values[used]), chance.values[used])
            np.testing.assert_allclose(P, policy.chain.to_scipy().toarray(), atol=1e-15)
        law = alone.attack.fit.law
        fitted = [float(data[f"attack_fit_l{i}"]) for i in (1, 2, 3, 4)]
        assert fitted == pytest.approx([law.l1, law.l2, law.l3, law.l4])
        assert "regions_region" not in data
        picture = data.captures_probability.set_index(position=("y", "x")).unstack()
        assert float(picture.sel(attack_time=6, x=1.5, y=1.5)) == alone.captures.probability[0, 0]


@pytest.mark.parametrize(
    ("field", "wrong", "check"),
    [
        ("captures.probability", lambda chance: chance[::-1], "captures_falls_with_time"),
        ("captures.probability", lambda chance: chance + 0.9, "out_of_0_to_1|mean_capture_out_of"),
        ("attack.exact", lambda chance: chance / 2, "attack_exact_is_of_law"),
        ("attack.law", lambda law: law + 0.5, "attack_law_beyond_1|exact_is_of_law"),
    ],
)
def test_a_patrol_that_contradicts_itself_is_refused(alone, field, wrong, check):
    with pytest.raises(RuntimeError, match=check):
        dataset(changed(alone, field, wrong))


def test_attacks_keep_to_their_rules(alone):
    """The rules of the attacks, from the places of the robots."""
    attacks = simulate_attacks(alone, 3)
    edges = {frozenset(edge) for edge in alone.graph.edges.tolist()}
    for walk in attacks.place.T.tolist():
        assert all(frozenset(step) in edges for step in itertools.pairwise(walk))
    seen = alone.attack.view[attacks.place].any(axis=1)
    state, since = attacks.state, attacks.since
    before = np.append(AttackState.WAITING, state[:-1])
    during, earlier = state == AttackState.ATTACKING, before == AttackState.ATTACKING
    begun, ended = during & ~earlier, earlier & ~during
    assert (before[begun] == AttackState.WAITING).all()
    assert not seen[during].any()
    assert not since[begun].any()
    assert (np.diff(since)[during[:-1]] == 1).all()
    assert (since[during] < TIMES[0]).all()
    assert (since[ended & ~seen] == TIMES[0]).all()
    assert (since[ended] <= TIMES[0]).all()
    ends = np.where(seen, AttackState.CAUGHT, AttackState.SUCCEEDED)
    np.testing.assert_array_equal(state[ended], ends[ended])
    assert (state[(state != before) & ~begun & ~ended] == AttackState.WAITING).all()
    for end, counts in (
        (AttackState.CAUGHT, attacks.caught),
        (AttackState.SUCCEEDED, attacks.succeeded),
    ):
        np.testing.assert_array_equal(counts, np.cumsum(ended & (state == end)))
        assert counts[-1] > 3
    again = simulate_attacks(alone, 3)
    np.testing.assert_array_equal(again.place, attacks.place)
    assert not np.array_equal(simulate_attacks(alone, 5).place, attacks.place)


def test_many_robots_are_shown_for_less_long(alone):
    many = dataclasses.replace(alone, policies=alone.policies * 50)
    assert simulate_attacks(many, 0).place.shape == (121, 100)


def test_the_recording_shows_the_patrol(alone, recording):
    attacks = simulate_attacks(alone, 4)
    for robot in range(2):
        here = places(alone, recording, f"/map/robots/{robot}/here")
        np.testing.assert_array_equal(here, attacks.place[:, robot])
        # The outline is that of the visibility polygon.
        rings = recording.over("step", f"/map/sight/{robot}", "LineStrips2D:strips")
        polygon = visibility_polygon(alone.cells.workspace, alone.xy[here[7]], 2.5)
        shown = shapely.Polygon(rings[7][0])
        assert shown.symmetric_difference(polygon).area == pytest.approx(0, abs=1e-4)
    pictures = recording.pictures("step", "/map/grid/seen")
    assert len(pictures) == len(attacks.place)
    for time in (0, 50):
        by = alone.visible[attacks.place[time]]
        expected = np.select([by.all(axis=0), by[0], by[1]], [4, 2, 3], 1)
        np.testing.assert_array_equal(on_cells(alone, pictures[time]), expected)
    colors = recording.over("step", "/map/attack", "Points2D:colors")
    names = [PLAIN, CATEGORIES["yellow"], KNOWN, CATEGORIES["pink"]]
    assert [one for (one,) in colors.values()] == [packed(names[state]) for state in attacks.state]
    labels = recording.over("step", "/map/attack_label", "Points2D:labels")
    time = int(np.flatnonzero(attacks.state == AttackState.ATTACKING)[1])
    assert labels[time] == [f"attack: step {attacks.since[time]} of 6"]
    for name in ("caught", "succeeded"):
        curve = recording.over("step", f"/attacks/{name}", "Scalars:scalars")
        assert [one for (one,) in curve.values()] == getattr(attacks, name).tolist()
    text = recording.text()
    assert f"in this run {attacks.caught[-1]} times" in text.replace("\n", " ")
    assert "| map | a&#124;b |" in text


def test_the_recording_shows_the_covers(alone, recording):
    for robot, policy in enumerate(alone.policies):
        for timeline in ("cover", "step"):
            pictures = recording.pictures(timeline, f"/map/grid/cover_{robot}")
            stops = recording.over(timeline, f"/map/cover_{robot}/stops", "Points2D:positions")
            rings = recording.over(timeline, f"/map/cover_{robot}/outline", "LineStrips2D:strips")
            assert list(pictures) == list(stops) == list(rings)
            assert len(stops) == policy.cover.size
            before = np.zeros(alone.cells.positions, bool)
            shown = zip(pictures.values(), stops.values(), strict=True)
            for k, (picture, dots) in enumerate(shown):
                np.testing.assert_allclose(dots, alone.xy[policy.cover[: k + 1]])
                now = alone.visible[policy.cover[k]]
                expected = np.select([before, now], [2, 3], 1)
                np.testing.assert_array_equal(on_cells(alone, picture), expected)
                before |= now
            assert before.all()
        assert min(recording.pictures("cover", f"/map/grid/cover_{robot}")) == 1


def test_the_recording_shows_the_policies(alone, recording):
    ends = alone.xy[alone.graph.edges]
    for robot, policy in enumerate(alone.policies):
        some = policy.weights > 0
        lines = np.array(recording.static(f"/map/policy_{robot}/edges", "LineStrips2D:strips"))
        np.testing.assert_allclose(lines, ends[some])
        radii = np.array(recording.static(f"/map/policy_{robot}/edges", "LineStrips2D:radii"))
        # The width grows with the weight.
        steps = np.diff(radii[np.argsort(policy.weights[some])])
        assert (steps >= -1e-7).all()
        dots = recording.static(f"/map/policy_{robot}/cover", "Points2D:positions")
        np.testing.assert_allclose(dots, alone.xy[policy.cover])


def test_the_recording_shows_the_law(alone, recording):
    attack = alone.attack
    kind = on_cells(alone, recording.picture("/map/grid/target_view"))
    np.testing.assert_array_equal(kind, np.select([attack.boundary, attack.view], [3, 2], 1))

    # The bars have the heights of the runs' shares, and the curves those of the laws.
    def curve(name):
        (strip,) = recording.static(name, "LineStrips2D:strips")
        return np.array(strip) * [1, -1]

    most_y = attack.law[3] / curve("/target/times/exact")[3, 1]
    bars = recording.picture("/target/times/simulated").sum(axis=0)
    (scale,) = recording.static("/target/times/simulated", "Transform3D:scale")
    heights = bars * scale[1] * most_y
    times = np.asarray(attack.arrivals.time)
    width = -(-(np.quantile(times, 0.95, method="lower") + 1) // 80)
    shares = np.histogram(times, width * np.arange(len(bars) + 1))[0] / times.size / width
    np.testing.assert_allclose(heights, shares, atol=1.5 * most_y * scale[1])
    assert shares.max() > 0.01

    x, y = curve("/target/captures/exact").T
    np.testing.assert_allclose(y / y[-1], np.cumsum(attack.law) / attack.law.sum(), atol=1e-6)
    assert x[20] / x[-1] == pytest.approx(0.5)
    runs = curve("/target/captures/simulated")[:, 1]
    fitted = curve("/target/captures/fitted")[:, 1]
    height = y[-1] / attack.exact[-1]
    np.testing.assert_allclose(runs[TIMES] / height, attack.simulated, atol=1e-6)
    np.testing.assert_allclose(fitted[TIMES] / height, attack.fitted, atol=1e-6)
    assert len(recording.static("/target/captures/attack_times", "LineStrips2D:strips")) == 3
    text = recording.text("/target/text")
    exact, simulated = 100 * attack.exact[1], 100 * attack.simulated[1]
    assert f"| 20 steps | {exact:.3g} % | {simulated:.3g} % |" in text


def test_the_recording_shows_the_vulnerability(alone, recording):
    caught = alone.captures.probability[0]
    kind = on_cells(alone, recording.picture("/map/grid/capture")).astype(int)
    assert kind.min() >= 3
    assert kind.max() <= 34
    assert (np.diff(kind[np.argsort(caught)]) >= 0).all()
    frame = recording.static("/map/worst_capture/frame", "Boxes2D:centers")
    np.testing.assert_allclose(frame, alone.xy[[caught.argmin()]])
    (label,) = recording.static("/map/worst_capture/label", "Points2D:labels")
    assert label == f"most vulnerable: {caught.min():.3f}"
    low = recording.classes("/map/grid/capture")[kind[caught.argmin()]]
    assert low.startswith(f"caught with probability {caught.min():.3f}"[:-1])
    text = recording.text("/vulnerability/text")
    assert f"{100 * caught.min():.3g} %" in text


def test_an_emphasis_that_lowers_capture_is_remarked(alone):
    worse = dataclasses.replace(alone, share_capture=np.array([0.3, 0.2]))
    remark = "an emphasis of 0.8 lowers the least probability of capture from 0.300 to 0.200"
    assert remark in worse.remarks
    assert remark not in dataclasses.replace(worse, chosen_share=0.0).remarks


def test_the_recording_shows_a_search_and_its_frontier(alone, monkeypatch):
    monkeypatch.setattr("jaxcell.patrol.map.capture_search.STEPS", 20)
    problem = alone.graph, alone.visible, 2, Attack(TIMES[0])
    search = capture_policies(*problem, starts=1)
    frontier = capture_frontier(*problem, [0.0, 0.6])
    patrol = dataclasses.replace(
        alone, policies=search.policies, search=search, frontier=frontier, share_capture=None
    )
    assert (
        "the patrol is a local optimum of a search from 1 start; another may" in patrol.remarks[0]
    )
    recording = read_back(patrol)
    assert len(recording.static("/frontier/curve/floors", "Points2D:positions")) == 2
    text = recording.text("/frontier/text")
    caught = 100 * frontier.least_capture[1]
    assert f"| 60% | {frontier.entropy[1]:.3g} nats | {caught:.3g} % |" in text
    assert "local optimum" in recording.text("/policies/text")


def test_the_recording_shows_the_regions(based):
    recording = read_back(based)
    xy, regions, after = based.xy, based.regions, based.reassignment
    for name, one, owner, policies in (
        ("regions", regions, [0, 1, 2], based.policies),
        ("regions_after", after.regions, [0, 2], after.policies),
    ):
        labels = recording.labels(f"/map/grid/{name}")[based.cells.free]
        for cell, label in enumerate(labels):
            region = one.region[cell]
            said = "reports" if one.view[cell] else "patrols"
            expected = f"robot {owner[region]} {said}" if region >= 0 else "only the base"
            assert label == expected
        dots = recording.static(f"/map/{name}_contacts", "Points2D:positions")
        np.testing.assert_allclose(dots, xy[[policy.contact for policy in policies]])
    np.testing.assert_allclose(
        recording.static("/map/base/station", "Boxes2D:centers"), xy[[regions.base]]
    )
    heat = recording.labels("/map/grid/capture")[based.cells.free]
    np.testing.assert_array_equal(heat == "always in view of the base station", regions.view)
    last = list(recording.pictures("cover", "/map/grid/cover_2").values())[-1]
    np.testing.assert_array_equal(on_cells(based, last) == 4, regions.region != 2)
    text = recording.text("/regions/text")
    assert f"**{after.silence_limit:,}** steps" in text
    assert "robot 1 is lost" in text


def test_a_target_that_is_always_seen_has_no_fit(alone):
    everything = np.ones_like(alone.visible)
    problem = alone.graph, everything, alone.policies
    attack = vulnerability(jax.random.key(0), *problem, 3, Attack(TIMES), runs=10)
    capture = Capture.of(*problem, Attack(TIMES))
    patrol = dataclasses.replace(alone, visible=everything, attack=attack, captures=capture)
    recording = read_back(patrol)
    assert "/target/times/fitted" not in recording.entities
    assert "No generalized lambda" in recording.text("/target/text")
    assert "attack_fit_l1" not in dataset(patrol)
    curve = recording.over("step", "/attacks/caught", "Scalars:scalars")
    assert set(map(tuple, curve.values())) == {(0,)}


def test_parts_of_different_patrols_are_refused(alone, based):
    for change, message in (
        ({"graph": Graph([[0, 1]])}, "graph: expected 46 cells, got 2"),
        (
            {"captures": dataclasses.replace(alone.captures, probability=np.ones((3, 5)))},
            "captures: expected 46 cells, got 5",
        ),
        (
            {"captures": dataclasses.replace(alone.captures, attack=alone.captures.attack.first)},
            r"captures: expected the attack times \[.*\], got \[.\]",
        ),
        ({"reassignment": based.reassignment}, "reassignment: expected regions with it"),
        ({"cells": CellSpace.of_grid(np.ones((2, 23), bool), 8)}, "the cells of a map, got a grid"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(alone, **change)
