import json
import math

import numpy as np
import pytest
from helpers import run

from jaxcell import bundled
from jaxcell.automata import Filter, subset_construction
from jaxcell.cli import main
from jaxcell.cli.info import KINDS, describe
from jaxcell.robot import save_team
from jaxcell.sweep import Spec, run_sweep


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    lab = str(bundled("maps/lab_a.json"))
    options = ["--bounce", "135", "--collision", "endpoint", "--out", str(out)]
    assert main(["localize", lab, *options]) == 0
    return out


def test_files_of_a_command_are_described(results, capsys):
    assert describe(results / "filter.jxf")["states"] == 124
    groups = describe(results / "groups.nc")
    assert groups["what"] == "a result of jaxcell: Periodic groups of a bouncing robot"
    assert groups["dimensions"]["position"] == 19
    recording = describe(results / "localization.rrd")
    assert recording["application"].startswith("jaxcell_localization_")
    assert set(recording["timelines"]) == {"direction", "step"}
    summary = describe(results / "summary.json")
    assert summary["what"] == "the summary of jaxcell localize"
    assert summary["periodic_groups"] == 1
    newer = results.parent / "summary.json"
    newer.write_text((results / "summary.json").read_text().replace('"version": 1', '"version": 9'))
    with pytest.raises(ValueError, match=r"summary\.json: version: expected at most 1, got 9"):
        describe(newer)
    names = ["filter.jxf", "groups.nc", "localization.nc", "localization.rrd", "summary.json"]
    described = describe(results)
    assert (described["what"], described["files"]) == ("a result", names)
    assert described["command"].startswith("jaxcell localize ")
    assert main(["info", str(results / "filter.jxf")]) == 0
    assert "a localization filter" in capsys.readouterr().out
    assert run(capsys, "info", results / "filter.jxf")[1]["states"] == 124


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("maps/lab_a.json", {"what": "a map", "positions": 19, "width_m": 8.0}),
        ("maps/maze.txt", {"what": "a map", "cell_m": 0.5}),
        ("maps/office.yaml", {"what": "a map", "cell_m": 0.1}),
        ("maps/office.pgm", {"height": 60}),
        ("graphs/eight.json", {"what": "a graph", "vertices": 8, "edges": 13}),
        ("ocean/gyres.nc", {"dimensions": {"lat": 21, "lon": 29, "time": 24, "depth": 3}}),
    ],
)
def test_bundled_data_are_described(name, expected):
    assert expected.items() <= describe(bundled(name)).items()


@pytest.mark.parametrize("suffix", [".dot", ".jff", ".h", ".json", ".ino"])
def test_filters_for_other_programs_are_described(suffix, tmp_path):
    # A robot that goes to cell 0 of three and stays there.
    spec = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.0, "bounce_deg": 90}
    image, bumped = np.int32([0, 0, 1]), np.array([True, False, False])
    filter = Filter.of(subset_construction(image, bumped), metadata=spec)
    path, file = tmp_path / "filter.jxf", tmp_path / f"filter{suffix}"
    filter.save(path)
    line = ["robot", "sketch", path, "--out", file] if suffix == ".ino" else ["export", path, file]
    assert main([str(word) for word in line]) == 0
    described = describe(file)
    assert described["states"] == len(filter.transition) == 3
    if suffix in (".dot", ".jff", ".json"):
        assert described["transitions"] == (filter.transition >= 0).sum() == 5
    assert described.get("knowledge_cycles", 1) == 1
    assert file.name in describe(tmp_path)["files"]


def test_files_for_robots_and_of_drifters_are_described(tmp_path):
    program, team = tmp_path / "bounce.ino", tmp_path / "team.json"
    assert main(["robot", "sketch", "--bounce", "90", "--step", "1", "--out", str(program)]) == 0
    described = describe(program)
    assert described["title"].startswith("Lets an iRobot Create 2 bounce")
    assert "states" not in described
    common = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.2}
    save_team(team, common, [(0.5, 0.5, 0.0), (1.5, 0.5, 0.0)], [0.0, math.pi / 2], ["0", "1"])
    expected = {"kind": "team", "robots": 2, "cell_m": 1.0, "robot_radius_m": 0.2}
    assert expected.items() <= describe(team).items()
    table, points = tmp_path / "a.csv", tmp_path / "a.geojson"
    table.write_text("number,lon,lat,cell\r\n1,-118.5,33.25,7\r\n2,-117.5,33.5,9\r\n")
    places = [{"geometry": {"coordinates": place}} for place in ([-118.5, 33.25], [-117.5, 33.5])]
    points.write_text(json.dumps({"features": places}))
    expected = {"points": 2, "longitudes": [-118.5, -117.5], "latitudes": [33.25, 33.5]}
    for path in (table, points):
        assert expected.items() <= describe(path).items()


def test_a_sweep_and_its_specification_are_described(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text('task = "sweep_stub:stub"\nchunk = 2\n[grid]\nx = [1, 2, 3]\n')
    expected = {"task": "sweep_stub:stub", "dimensions": {"x": 3}, "chunks": 2}
    assert expected.items() <= describe(path).items()
    run_sweep(Spec.load(path), tmp_path / "out")
    expected |= {"done": 2, "failed": 0}
    assert expected.items() <= describe(tmp_path / "out").items()
    assert expected.items() <= describe(tmp_path / "out" / "sweep.zarr").items()


@pytest.mark.parametrize("suffix", [one for one in KINDS if one not in (".jxb", ".toml")])
def test_damaged_files_are_refused_by_name(suffix, tmp_path, capsys):
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(b"RRF2 neither this nor that \xff")
    assert main(["info", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxcell info: {path}: ")
    assert error.count("\n") == 1


def test_unknown_and_missing_files_are_refused(tmp_path, capsys):
    (tmp_path / "picture.png").touch()
    for path in (tmp_path / "picture.png", tmp_path / "nothing.nc", tmp_path):
        assert main(["info", str(path)]) == 2
        assert str(path) in capsys.readouterr().err
