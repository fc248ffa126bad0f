import json
import shlex

import pytest

from jaxcell.cli import main
from jaxcell.cli.app import read
from jaxcell.cli.demo import STOPS


MAX_LINES = 45


def test_stops_are_commands_that_exist():
    for stop in STOPS:
        name, command = read(stop.line.split()[1:])
        assert command.study is stop.study
        assert name == stop.study.command


@pytest.mark.usefixtures("few_drifters")
def test_each_stop_of_the_tour_shows_its_claim(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path)]) == 0
    out = {
        stop.folder: json.loads((tmp_path / stop.folder / "summary.json").read_text())
        for stop in STOPS
    }
    assert out["home"]["lost_share"] == 0
    assert out["home"]["arrived_share"] > 0.9
    (groups,) = out["groups"]["groups"]
    assert groups["count"] > 2
    assert groups["largest_basin"] < out["groups"]["cells"] / 2
    assert out["localize"]["localized_to_one"] == 1
    navigated = out["navigate"]
    assert navigated["found"]
    assert navigated["cells_that_reach_the_goal"] < navigated["cells"]
    assert all(one["alpha"] > 0.1 for one in out["cover"]["policies"])
    assert out["team"]["uncovered"] == 0
    game = out["patrol"]["game"]
    assert sum(one["share"] > 0.01 for one in game["strategies"]) > 1
    assert game["value"] > 2 * game["alone"]
    assert out["drift"]["fewest_count"] > 20

    said = capsys.readouterr().err
    assert said.count("\n") <= MAX_LINES
    assert f"view {shlex.quote(str(tmp_path))}" in said.splitlines()[-1]
    index = (tmp_path / "index.md").read_text()
    for stop in STOPS:
        assert stop.line in said
        assert stop.line in index
        (recording,) = (tmp_path / stop.folder).glob("*.rrd")
        assert f"({stop.folder}/{recording.name})" in index
