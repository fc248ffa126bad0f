import json

import pytest

from jaxcell.cli import main


pytestmark = pytest.mark.slow


def test_the_tour_shows_every_family(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path)]) == 0
    recordings = {path.parent.name: path.name for path in tmp_path.rglob("*.rrd")}
    assert recordings == {
        "localize": "localization.rrd",
        "localize_45": "localization.rrd",
        "navigate": "navigation.rrd",
        "cover": "coverage.rrd",
        "team": "team.rrd",
        "patrol": "patrol_map.rrd",
        "drift": "drift.rrd",
    }
    for folder in recordings:
        assert json.loads((tmp_path / folder / "summary.json").read_text())
    told = capsys.readouterr().err
    assert "7/7" in told
    assert f"view {tmp_path}" in told.splitlines()[-1]
