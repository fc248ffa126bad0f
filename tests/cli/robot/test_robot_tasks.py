import functools
import math

import numpy as np
import pytest
import robot_files
from robot_files import SPEC, run
from wheels import map_cells

from jaxcell.cli.robot.replay import RobotReplay
from jaxcell.cli.robot.run import RobotRun
from jaxcell.robot import draw_cross, read_log
from jaxcell.robot.tasks.patrol_task import save_patrols
from jaxcell.robot.team import save_team
from jaxcell.space import CellSpace, Workspace, free_steps, visible_cells


LAB = map_cells("lab_b.json")
simulated = functools.partial(robot_files.simulated, name="lab_b.json")


@pytest.fixture
def patrol_file(tmp_path):
    """Three robots that go from cell to cell at random."""
    image = free_steps(map_cells("lab_b.json", directions=4))
    walks = [
        (image, np.random.default_rng(seed).dirichlet(np.ones(4), LAB.positions).T)
        for seed in range(3)
    ]
    path = tmp_path / "patrol.json"
    save_patrols(path, LAB, walks, [0, 7, 18], 1.6)
    return path


def check_replay(out, answer, capsys):
    """Check that the log of a run has the outcome of the run."""
    code, again = run(RobotReplay(log=out / "run.jsonl", json=True), capsys)
    assert code == 0
    del again["log"], again["whole"]
    assert again.items() <= answer.items()


def test_a_patrol_is_logged_and_replays(patrol_file, tmp_path, capsys):
    out = tmp_path / "out"
    fields = {"robot": 1, "visits": 3, "start": "3.5,0.5,90", "out": out}
    code, answer = run(simulated(patrol_file, **fields), capsys)
    assert (code, answer["result"]) == (0, "patrolled")
    check_replay(out, answer, capsys)
    assert RobotReplay(log=out / "run.jsonl").run() == 0
    assert "3 cells" in capsys.readouterr().out
    patrol = read_log(out / "run.jsonl").header["patrol"]
    assert (patrol["start"], patrol["facing"]) == (int(LAB.index(3.5, 0.5)), 1)
    patrol_file.write_text(patrol_file.read_text() + " ")
    with pytest.raises(ValueError, match=r"run\.jsonl: the log is of another patrol"):
        RobotReplay(log=out / "run.jsonl").run()


def test_an_intruder_is_reported_from_a_cell_that_sees_it(patrol_file, capsys):
    # Two steps from the start, so that it is not seen at once.
    ways = free_steps(map_cells("lab_b.json", directions=4))
    sees = visible_cells(LAB, 1.6)
    hidden = next(int(z) for z in ways[:, ways[:, 0]].ravel() if not sees[0, z])
    x, y, _ = map(float, LAB.centre(hidden))
    code, answer = run(simulated(patrol_file, intruder=f"{x},{y}"), capsys)
    assert (code, answer["result"]) == (0, "reported")
    assert answer["intruder"] == {"x": x, "y": y}
    assert sees[answer["position"], hidden]
    assert "0" in answer["observations"]


def test_the_marker_is_found_in_pictures(patrol_file, tmp_path, capsys):
    cv2 = pytest.importorskip("cv2")
    blank = np.full((240, 320), 160, np.uint8)
    marked = blank.copy()
    # The middle of an odd sheet is that of a pixel.
    cross = draw_cross(101)
    marked[60 : 60 + len(cross), 90 : 90 + len(cross)] = cross
    for i, picture in enumerate([blank, blank, marked]):
        assert cv2.imwrite(str(tmp_path / f"{i}.png"), picture)
    code, answer = run(simulated(patrol_file, camera=str(tmp_path)), capsys)
    assert (code, answer["result"]) == (0, "reported")
    assert answer["intruder"].startswith("cross at 140")
    assert len(answer["observations"]) == 2


@pytest.mark.parametrize("steps", ["encoder", "clock"])
def test_a_robot_of_a_team_runs_its_part(tmp_path, capsys, steps):
    # East until the wall, and back; then a meeting, a turn to the left, and the wall there.
    path, hall = tmp_path / "team.json", Workspace([(0, 0), (3, 0), (3, 2), (0, 2)])
    cells = CellSpace.of(hall, 1.0, 8)
    hall.save(tmp_path / "hall.json")
    starts = [(0.5, 0.5, 0.0), (2.5, 1.5, math.pi)]
    save_team(path, SPEC, starts, [math.pi, math.pi / 2], ["001002+", "00+"])
    for robot, end in [(0, (1.5, 0.5, math.radians(45))), (1, (0.5, 1.5, math.radians(225)))]:
        out = tmp_path / f"robot{robot}"
        options = {"robot": robot, "steps": steps, "speedup": 1e6, "out": out, "json": True}
        command = RobotRun(file=path, simulate=tmp_path / "hall.json", **options)
        code, answer = run(command, capsys)
        assert (code, answer["result"]) == (0, "arrived"), answer["reason"]
        check_replay(out, answer, capsys)
        if robot == 1:
            assert answer["emulated"]["end"] == int(cells.index(*end))
