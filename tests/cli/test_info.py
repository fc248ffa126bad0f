import json
import math

import numpy as np
import pytest

from jaxcell import bundled
from jaxcell.automata import Filter, subset_construction
from jaxcell.cli import main
from jaxcell.cli.info import describe
from jaxcell.robot import save_team
from jaxcell.sweep import Spec, run_sweep


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    lab = str(bundled("maps/lab_a.json"))
    options = ["--bounce", "135", "--collision", "endpoint", "--out", str(out)]
    assert main(["localize", lab, *options]) == 0
    return out


def test_every_file_of_a_command_is_told(results):
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
    assert describe(results)["files"] == [
        "filter.jxf",
        "groups.nc",
        "localization.nc",
        "localization.rrd",
        "summary.json",
    ]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("maps/lab_a.json", {"what": "a map", "positions": 19, "width_m": 8.0}),
        ("maps/maze.txt", {"what": "a map", "cell_m": 0.5}),
        ("maps/office.yaml", {"what": "a map", "cell_m": 0.1}),
        ("graphs/eight.json", {"what": "a graph", "vertices": 8, "edges": 13}),
        ("ocean/gyres.nc", {"dimensions": {"lat": 21, "lon": 29, "time": 24, "depth": 3}}),
    ],
)
def test_bundled_data_are_told(name, told):
    assert told.items() <= describe(bundled(name)).items()


@pytest.mark.parametrize("suffix", [".dot", ".jff", ".h", ".json", ".ino"])
def test_filters_for_other_programs_are_told(suffix, tmp_path):
    # A robot that goes to cell 0 of three and stays there.
    spec = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.0, "bounce_deg": 90}
    image, bumped = np.int32([0, 0, 1]), np.array([True, False, False])
    filter = Filter.of(subset_construction(image, bumped), metadata=spec)
    path, file = tmp_path / "filter.jxf", tmp_path / f"filter{suffix}"
    filter.save(path)
    written = (
        ["robot", "sketch", path, "--out", file] if suffix == ".ino" else ["export", path, file]
    )
    assert main([str(word) for word in written]) == 0
    told = describe(file)
    assert told["states"] == len(filter.transition) == 3
    assert told["transitions"] == (filter.transition >= 0).sum() == 5
    assert told.get("knowledge_cycles", 1) == 1
    assert file.name in describe(tmp_path)["files"]


def test_a_program_without_a_filter_is_told(tmp_path):
    path = tmp_path / "bounce.ino"
    assert main(["robot", "sketch", "--bounce", "90", "--step", "1", "--out", str(path)]) == 0
    told = describe(path)
    assert told["title"].startswith("Lets an iRobot Create 2 bounce")
    assert "states" not in told


def test_places_of_drifters_are_told(tmp_path):
    table, points = tmp_path / "a.csv", tmp_path / "a.geojson"
    table.write_text("number,lon,lat,cell\r\n1,-118.5,33.25,7\r\n2,-117.5,33.5,9\r\n")
    features = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": {}}
        for place in ([-118.5, 33.25], [-117.5, 33.5])
    ]
    points.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    place = {"points": 2, "longitudes": [-118.5, -117.5], "latitudes": [33.25, 33.5]}
    for path in (table, points):
        assert place.items() <= describe(path).items()


@pytest.mark.parametrize("depth", [8, 16])
def test_pictures_of_maps_are_told(tmp_path, depth):
    path = tmp_path / "a.pgm"
    full, width = 2**depth - 1, depth // 8
    pixels = [0, full, full, full // 5, full // 2, full]
    data = b"".join(pixel.to_bytes(width, "big") for pixel in pixels)
    path.write_bytes(f"P5 3 2 {full}\n".encode() + data)
    told = describe(path)
    assert (told["width"], told["height"]) == (3, 2)
    assert told["occupied_share"] == pytest.approx(2 / 6, abs=1e-6)


def test_a_team_for_robots_is_told(tmp_path):
    common = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.2}
    path = tmp_path / "team.json"
    save_team(path, common, [(0.5, 0.5, 0.0), (1.5, 0.5, 0.0)], [0.0, math.pi / 2], ["0", "1"])
    told = {"kind": "team", "robots": 2, "cell_m": 1.0, "robot_radius_m": 0.2}
    assert told.items() <= describe(path).items()


def test_a_sweep_and_its_specification_are_told(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text('task = "sweep_stub:stub"\nchunk = 2\n[grid]\nx = [1, 2, 3]\n')
    told = {"task": "sweep_stub:stub", "dimensions": {"x": 3}, "chunks": 2}
    assert told.items() <= describe(path).items()
    run_sweep(Spec.load(path), tmp_path / "out")
    told |= {"done": 2, "failed": 0}
    assert told.items() <= describe(tmp_path / "out").items()
    assert told.items() <= describe(tmp_path / "out" / "sweep.zarr").items()


def test_it_is_told_to_people_and_to_programs(results, capsys):
    assert main(["info", str(results / "filter.jxf")]) == 0
    assert "a localization filter" in capsys.readouterr().out
    assert main(["info", "--json", str(results / "filter.jxf")]) == 0
    assert json.loads(capsys.readouterr().out)["states"] == 124


@pytest.mark.parametrize(
    "suffix",
    [
        *(".jxf", ".nc", ".rrd", ".json", ".jsonl", ".yaml", ".edges"),
        *(".dot", ".jff", ".h", ".ino", ".csv", ".geojson", ".pgm"),
    ],
)
def test_damaged_files_are_refused_by_name(suffix, tmp_path, capsys):
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(b"RRF2 neither this nor that \xff")
    assert main(["info", str(path)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"jaxcell info: {path}: ")
    assert told.count("\n") == 1


def test_other_files_and_no_files_are_refused(tmp_path, capsys):
    (tmp_path / "picture.png").touch()
    for path in (tmp_path / "picture.png", tmp_path / "nothing.nc", tmp_path):
        assert main(["info", str(path)]) == 2
        assert str(path) in capsys.readouterr().err
