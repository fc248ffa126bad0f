"""When a robot is localized, and what a result says of robots that are not."""

import dataclasses
import json
import math

import numpy as np
import pytest

from jaxcell import bounce, robot, space, walls
from jaxcell.base.bundled import bundled
from jaxcell.cli import main
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.study import LocalizeAnywhere


L_ROOM = space.Workspace([(0, 0), (6, 0), (6, 1), (4, 1), (4, 2), (0, 2)])
CLOSET = {
    "format": "jaxcell-map",
    "version": 1,
    "units": "m",
    "boundary": [[0, 0], [7, 0], [7, 2.5], [3, 2.5], [3, 6], [0, 6]],
    "obstacles": [
        [[1, 1], [2.2, 1], [2.2, 1.1], [1, 1.1]],
        [[1, 2.1], [2.2, 2.1], [2.2, 2.2], [1, 2.2]],
        [[1, 1.1], [1.1, 1.1], [1.1, 2.1], [1, 2.1]],
        [[2.1, 1.1], [2.2, 1.1], [2.2, 2.1], [2.1, 2.1]],
    ],
    "cell": 0.5,
    "directions": 8,
}


def test_an_empty_set_is_lost_and_never_localized():
    filter = walls.WallFilter.of(L_ROOM, headings=8)
    empty = filter.observe(filter.turn(filter.observe(None, 1.0), np.pi), 50.0)
    assert filter.refuted(empty, 1).all()
    extent = filter.extent(empty, 1)
    assert np.isinf(extent).all()
    assert not walls.is_localized(extent, 100.0).any()


def test_a_robot_is_localized_from_its_first_small_set_that_is_not_empty():
    extent = [[5.0, 1.0, 3.0], [5.0, 5.0, 1.0001], [5.0, np.inf, np.inf], [0.0, 0.0, 0.0]]
    until = walls.bumps_until_localized(np.array(extent), 0.5)
    np.testing.assert_array_equal(until, [2, np.inf, np.inf, 1])


@pytest.fixture(scope="module")
def found():
    cells = space.CellSpace.of(L_ROOM, 1.0, 8)
    filter = walls.WallFilter.of(L_ROOM, headings=8)
    angles = np.radians([135.0])
    trial = walls.drive_anywhere(L_ROOM, filter, angles.tolist(), robots=10, bumps=3, headings=8)
    return bounce.Anywhere(cells, filter, 8, angles, 0.5, trial)


def test_lost_robots_count_as_lost_in_every_number(found):
    """Four robots are localized, of which one is elsewhere; five have empty sets; one has not."""
    extent = np.full((10, 3), np.inf)
    extent[:4], extent[9], held = [8.0, 0.5, 2.0], [8.0, 3.0, 2.0], np.ones((10, 3), bool)
    held[3, 1:], held[4:9] = False, False
    trial = dataclasses.replace(found.trial, extent=extent, held=held)
    result = dataclasses.replace(found, trial=trial)
    assert result.localized_share == 0.4
    assert result.right_share == 0.75
    assert result.lost_share == 0.6
    assert result.median_bumps == np.inf
    np.testing.assert_array_equal(result.median_extent, [np.inf, np.inf, np.inf])
    assert not result.answered
    assert "6 of 10 robots are lost" in result.remarks[0]


def test_the_median_extent_and_the_ninth_decile_are_those_of_all_robots(found):
    extent = np.repeat(np.arange(1.0, 11.0)[:, None], 3, axis=1)
    extent[9, 2] = np.inf
    result = dataclasses.replace(found, trial=dataclasses.replace(found.trial, extent=extent))
    np.testing.assert_array_equal(result.extent_of_nine_tenths, [9, 9, 9])
    np.testing.assert_array_equal(result.median_extent, [5.5, 5.5, 5.5])


def test_a_robot_stops_at_the_bump_at_which_the_trial_calls_it_localized(found):
    until = walls.bumps_until_localized(found.trial.extent, found.radius)
    settings = robot.AnywhereSettings(
        found.filter, tuple(found.bounces.tolist()), found.radius, confirm=0
    )
    stopped = []
    for runs in found.trial.run.tolist():
        events = [{"event": "observation", "run": run, "turn": math.radians(135)} for run in runs]
        log = robot.LoggedRun({}, tuple(events), True)
        bumps = np.inf
        for bump in range(1, len(events) + 1):
            part = dataclasses.replace(log, events=tuple(events[:bump]))
            if robot.replay_anywhere(part, settings).result == "localized":
                bumps = min(bumps, bump)
        stopped.append(bumps)
    assert np.isfinite(until).any()
    np.testing.assert_array_equal(stopped, until)


def test_a_refuted_run_has_no_extent_and_a_log_that_is_json(tmp_path):
    elsewhere = space.Workspace([(0, 0), (9, 0), (9, 7), (0, 7)])
    settings = robot.AnywhereSettings(walls.WallFilter.of(L_ROOM), (math.radians(100),), 0.5)

    with robot.RunLog(tmp_path / "run.jsonl", {"kind": "anywhere"}) as log:
        walker = robot.Walker(DirectBody(Body(elsewhere, (4.0, 3.0, 1.0))), 1.0)
        outcome = robot.run_anywhere(walker, settings, log=log, limit=60)
    assert (outcome.result, outcome.extent, outcome.place) == ("refuted", None, None)
    for line in (tmp_path / "run.jsonl").read_text().splitlines():
        json.loads(line, parse_constant=pytest.fail)


def test_only_robots_in_the_closet_cannot_be_localized(tmp_path):
    """Two angles tell all places of the room apart; a square closet has four alike poses."""
    path = tmp_path / "closet.json"
    path.write_text(json.dumps(CLOSET))
    study = LocalizeAnywhere(map=path, bounce=(45.0, 135.0), robots=80, bumps=4)
    result = study.run()
    x, y = result.trial.start.T
    locked = (np.abs(x - 1.6) < 0.5) & (np.abs(y - 1.6) < 0.5)
    assert 0 < locked.sum() < 10
    assert result.alike_share == locked.mean()
    (remark,) = result.remarks
    assert "For robots that start in the piece of 1 m² at (1.6 m, 1.6 m), 4 poses" in remark
    assert "of the robots start outside the largest piece" in result.answer[-1]
    inside = dataclasses.replace(study, piece="1.6,1.6", robots=2).run()
    assert inside.radius == result.radius == 0.5
    assert "outside" not in inside.answer[-1]


def test_a_symmetry_of_the_closet_is_not_one_of_the_room(tmp_path):
    path = tmp_path / "closet.json"
    path.write_text(json.dumps(CLOSET))
    assert sorted(walls.alike_places(space.Workspace.load(path))) == [1, 4]


def test_a_map_that_suggests_no_cell_is_localized_with_a_usual_one(tmp_path, capsys):
    """A floor of 27.56 m² is 200 squares of .371 m, and .25 m is the next round side."""
    path = tmp_path / "closet.json"
    path.write_text(json.dumps({key: one for key, one in CLOSET.items() if key != "cell"}))
    assert main(["localize", str(path), "--bounce", "45", "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["cell_m"] == 0.25
    assert 200 <= found["positions"] <= 200 * (0.5 / 0.25) ** 2
    assert err.count("cells are squares of 0.25 m; set another side with --cell") == 1
    assert main(["localize", str(path), "--bounce", "45", "--cell", "0.5", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["cell_m"] == 0.5
    assert "suggests no side" not in err


@pytest.mark.parametrize(("heading", "said"), [("known", False), ("unknown", True)])
def test_it_is_said_when_only_symmetries_are_looked_for(heading, said):
    study = LocalizeAnywhere(
        map=bundled("lab_a"), bounce=(100.0,), heading=heading, robots=2, bumps=1
    )
    if heading == "known":
        study = dataclasses.replace(study, bounce=(135.0,))
    remarks = " ".join(study.run().remarks)
    assert ("only symmetries of the map are looked for" in remarks) == said


def test_a_start_whose_heading_the_robot_cannot_have_is_refused():
    study = LocalizeAnywhere(map=bundled("lab_a"), bounce=(135.0,), start="0.5,0.5,30", robots=1)
    with pytest.raises(
        ValueError, match=r"start '0\.5,0\.5,30': .* multiple of 45 degrees, got 30"
    ):
        study.run()
    assert dataclasses.replace(study, heading="unknown", bumps=1).run().lost_share == 0


@pytest.mark.parametrize(
    ("errors", "said"),
    [(("run=0.01",), True), (("run=0.01", "displacement=0.06"), False), ((), False)],
)
def test_a_task_whose_errors_have_no_displacement_is_doubted(tmp_path, capsys, errors, said):
    options = ["--bounce", "135", "--robots", "1", "--bumps", "1"]
    options += ["--errors", *errors] if errors else []
    assert main(["localize", "anywhere", "@lab_a", *options, "--out", str(tmp_path / "out")]) == 0
    err = capsys.readouterr().err
    assert ("anywhere.json: --errors have no displacement" in err) == said
    assert ("displacement=0.06" in err) == said


def test_slices_that_divide_no_angle_are_refused_by_their_option(capsys):
    words = ["localize", "anywhere", "@lab_a", "--bounce", "45", "--heading", "unknown"]
    assert main([*words, "--slices", "100"]) == 2
    assert "got 45 degrees; set other --slices" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("boundary", "share"),
    [
        ([[0, 0], [4, 0], [4, 3], [0, 3]], 1),
        ([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]], 0),
    ],
)
def test_errors_of_turns_leave_only_symmetries(tmp_path, boundary, share):
    """A rectangle looks the same after half a turn, whatever the errors; an L never does."""
    path = tmp_path / "room.json"
    path.write_text(json.dumps(CLOSET | {"boundary": boundary, "obstacles": []}))
    study = LocalizeAnywhere(
        map=path, bounce=(90.0,), errors=("turn=1",), robots=5, bumps=3, radius=0.3
    )
    result = study.run()
    assert result.alike_share == share
    assert "only symmetries of the map are looked for" in " ".join(result.remarks)
