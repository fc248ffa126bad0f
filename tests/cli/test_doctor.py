import json
import math
import re

import numpy as np
import pytest
import xarray as xr
from drift import products
from helpers import run

from jaxcell import bundled
from jaxcell.automata import Filter, subset_construction
from jaxcell.cli import main
from jaxcell.cli.described import KINDS, describe
from jaxcell.robot import save_team
from jaxcell.sweep import Spec, run_sweep


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    lab = str(bundled("maps/lab_a.json"))
    options = ["--bounce", "135", "--collision", "endpoint", "--out", str(out)]
    assert main(["localize", lab, *options]) == 0
    return out


def test_files_of_one_current_are_read_together(tmp_path, capsys):
    mesh = products.nemo_mesh()
    products.write(tmp_path, mesh, "mesh_mask.nc")
    for point, name, value in (("u", "vozocrtx", 0.5), ("v", "vomecrty", 0.25)):
        file = products.nemo(mesh, point, name, value)
        products.write(tmp_path, file, f"{point}.nc")
    names = [str(tmp_path / name) for name in ("u.nc", "v.nc", "mesh_mask.nc")]
    assert main(["doctor", *names, "--json"]) in (0, 1)
    report = json.loads(capsys.readouterr().out)
    assert report["what"].startswith("currents")
    assert report["records"] == products.RECORDS
    assert not any("not read" in doubt for doubt in report["doubts"])


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
    assert main(["doctor", str(results / "filter.jxf")]) == 0
    assert "a localization filter" in capsys.readouterr().out
    assert run(capsys, "doctor", results / "filter.jxf")[1]["states"] == 124


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
    assert main(["doctor", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxcell doctor: {path}: ")
    assert error.count("\n") == 1


def test_unknown_and_missing_files_are_refused(tmp_path, capsys):
    (tmp_path / "picture.gif").touch()
    for path in (tmp_path / "picture.gif", tmp_path / "nothing.nc", tmp_path):
        assert main(["doctor", str(path)]) == 2
        assert str(path) in capsys.readouterr().err


SQUARES = "type octile\nheight 1\nwidth 5\nmap\n....@\n"


def test_doubts_are_listed_with_the_options_that_settle_them(tmp_path, capsys):
    (tmp_path / "clean.map").write_text(SQUARES)
    assert main(["doctor", str(tmp_path / "clean.map")]) == 0
    assert re.search(r"doubts +│ none", capsys.readouterr().out)
    pixels = np.full((8, 40), 254, np.uint8)
    pixels[:, 3] = 0
    pixels[:4, :3] = 205
    (tmp_path / "scan.pgm").write_bytes(b"P5\n40 8\n255\n" + pixels.tobytes())
    lines = ["image: scan.pgm", "resolution: 0.1", "origin: [0, 0, 0]", "negate: 0"]
    lines += ["occupied_thresh: 0.65", "free_thresh: 0.25"]
    (tmp_path / "scan.yaml").write_text("\n".join(lines))
    picture = tmp_path / "scan.png"
    both = [str(tmp_path / "scan.yaml"), str(tmp_path / "clean.map"), "--json"]
    assert main(["doctor", *both]) == 1
    out, err = capsys.readouterr()
    scan, clean = json.loads(out)
    assert err == ""
    assert (scan["what"], scan["pieces"], clean["doubts"]) == ("a map", 1, [])
    grey, piece = scan["doubts"]
    assert "scan.pgm: 12 pixels of grey 205 are walls" in grey
    assert grey.endswith("use --unknown free")
    # 288 free squares on the right and 12 on the left.
    assert "2 separate pieces: only the largest is used, with 96 % of its area" in piece
    assert piece.endswith("for all of them, set --piece all")
    assert main(["doctor", both[0], "--out", str(picture)]) == 1
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["doctor", *both[:2], "--out", str(picture)]) == 2
    assert "--out: expected one file to draw, got 2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ocean/gyres.nc", {"records": 24, "depths_m": [0.0, 5.0, 10.0], "water_cells": 1512}),
        ("ocean/drifters.nc", {"drifters": 200, "observations": 3922}),
        ("graphs/eight.json", {"vertices": 8}),
        ("maps/lab_a.json", {"pieces": 1}),
    ],
)
def test_bundled_files_are_free_of_doubt_and_drawn(tmp_path, capsys, name, expected):
    out = tmp_path / "picture.png"
    assert main(["doctor", str(bundled(name)), "--json", "--out", str(out)]) == 0
    assert expected.items() <= json.loads(capsys.readouterr().out).items()
    assert out.read_bytes().startswith(b"\x89PNG")


def test_a_file_that_no_command_reads_is_doubtful(tmp_path, capsys):
    xr.Dataset({"t": ("x", [1.0, 2.0])}).to_netcdf(tmp_path / "other.nc")
    assert main(["doctor", str(tmp_path / "other.nc"), "--json"]) == 1
    [doubt] = json.loads(capsys.readouterr().out)["doubts"]
    assert doubt.startswith("not read as trajectories: ")
    assert "; not read as currents: " in doubt


def report_of(capsys, *words):
    """Run the doctor; return its exit status and its report."""
    status = main(["doctor", *map(str, words), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_two_pieces_of_any_map_are_doubted_until_one_is_chosen(tmp_path, capsys):
    (tmp_path / "rooms.map").write_text("type octile\nheight 1\nwidth 5\nmap\n.@..@\n")
    (tmp_path / "rooms.txt").write_text("#.#..#\n")
    wall = [[2, 0], [3, 0], [3, 1], [2, 1]]
    plan = {"format": "jaxcell-map", "version": 1, "obstacles": [wall]}
    plan["boundary"] = [[0, 0], [9, 0], [9, 1], [0, 1]]
    (tmp_path / "rooms.json").write_text(json.dumps(plan))
    for name in ("rooms.map", "rooms.txt", "rooms.json"):
        status, report = report_of(capsys, tmp_path / name)
        assert (status, report["pieces"]) == (1, 2)
        assert "rooms: the free space has 2 separate pieces: all are used" in report["doubts"][0]
        assert report["doubts"][0].endswith("set --piece")
        for piece, pieces in (("largest", 1), ("all", 2)):
            status, report = report_of(capsys, tmp_path / name, "--piece", piece)
            assert (status, report["pieces"]) == (0, pieces)


def test_maps_and_graphs_are_described_with_what_they_are_taken_for(tmp_path, capsys):
    pixels = np.full((4, 6), 254, np.uint8)
    pixels[0, :3], pixels[3, 0] = 205, 0
    (tmp_path / "scan.pgm").write_bytes(b"P5\n6 4\n255\n" + pixels.tobytes())
    lines = ["image: /elsewhere/scan.pgm", "resolution: 0.1", "origin: [0, 0, 90]", "negate: 0"]
    lines += ["occupied_thresh: 0.65", "free_thresh: 0.196"]
    (tmp_path / "scan.yaml").write_text("\n".join(lines))
    _, report = report_of(capsys, tmp_path / "scan.yaml")
    expected = {"unknown_pixels": 3, "pixel_m": 0.1, "yaw_rad": 90.0, "format": "map_server of ROS"}
    assert expected.items() <= report.items()
    assert report["mode"] == "trinary, as in ROS 1"
    assert "there is no such file" in report["notes"][0]
    [yaw] = report["doubts"]
    assert yaw.endswith(
        "the yaw of origin is 90 radians, more than a turn; if it means degrees, write 1.5708"
    )
    (tmp_path / "weighted.txt").write_text("% sym\n1 2 3\n2 3 10\n4 5 4\n")
    assert main(["doctor", str(tmp_path / "weighted.txt")]) == 2
    assert "if it is an edge with its length, set --weight" in capsys.readouterr().err
    _, report = report_of(capsys, tmp_path / "weighted.txt", "--weight", "km")
    expected = {"edges": 3, "one_way": 0, "pieces": 2, "lengths": "km of edges"}
    assert (expected | {"positions": "none", "total_length_m": 17.0}).items() <= report.items()
    assert (
        main(["doctor", str(tmp_path / "weighted.txt"), "--weight", "km", "--crop", "0,0,1,1"]) == 2
    )
    assert "--crop: it has an effect on a map, not on a graph" in capsys.readouterr().err


def test_lines_and_folders_are_said(tmp_path, capsys):
    line = {"type": "LineString", "coordinates": [[7, 46], [7.001, 46]]}
    text = json.dumps({"type": "FeatureCollection", "features": [{"geometry": line}]})
    (tmp_path / "streets.geojson").write_text(text)
    assert main(["doctor", str(tmp_path / "streets.geojson")]) == 2
    assert "lines are neither a map nor a graph" in capsys.readouterr().err
    (tmp_path / "clean.map").write_text(SQUARES)
    status, report = report_of(capsys, tmp_path)
    assert status == 1
    assert report["files"] == {"clean.map": "a map", "streets.geojson": "not read"}
    assert "lines are neither" in report["doubts"][-1]


def in_furlongs():
    file = products.regular()
    for name in ("uo", "vo"):
        file[name].attrs["units"] = "furlongs"
    return file


HOURS = ["--time-units", "hours since 2020-01-01"]
# A file of currents, and the options that its doubt names.
UNSAID = {
    "dims": (
        products.regular(dims=("when", "row", "col")).drop_vars(("when", "row", "col"))
        .assign(P=("col", products.LON), Q=("row", products.LAT)),
        ["--dims", "when=time", "row=y", "col=x", "--coords", "P", "Q", *HOURS],
    ),
    "time_units": (
        products.regular(time=(np.arange(3), {"units": "moons"})), HOURS
    ),
    "calendar": (
        products.regular(time=products.hours(calendar="mayan")), ["--calendar", "standard"]
    ),
    "units": (in_furlongs(), ["--units", "cm/s"]),
    "variables": (products.regular("p", "q"), ["--variables", "p", "q"]),
}  # fmt: skip


@pytest.mark.parametrize("unsaid", UNSAID)
def test_currents_are_free_of_doubt_with_the_options_that_it_names(unsaid, tmp_path, capsys):
    file, options = UNSAID[unsaid]
    products.write(tmp_path, file)
    status, report = report_of(capsys, tmp_path / "sea.nc")
    assert status == 1
    assert options[0] in report["doubts"][0]
    picture = ["--out", tmp_path / "sea.png"]
    status, report = report_of(capsys, tmp_path / "sea.nc", *options, *picture)
    assert (status, report["records"], report["doubts"]) == (0, products.RECORDS, [])
    assert report["what"].startswith("currents")


def test_a_group_is_chosen(tmp_path, capsys):
    for name in ("a", "b"):
        products.regular().to_netcdf(tmp_path / "sea.nc", mode="a", group=name)
    assert main(["doctor", str(tmp_path / "sea.nc")]) == 2
    assert "--group b" in capsys.readouterr().err
    assert report_of(capsys, tmp_path / "sea.nc", "--group", "b")[0] == 0


def test_currents_are_read_with_their_grid(tmp_path, capsys):
    parts = ("u", "vozocrtx", 0.5), ("v", "vomecrty", 0.25)
    mesh = products.nemo_mesh()
    products.write(tmp_path, mesh, "mesh_mask.nc")
    for point, name, value in parts:
        products.write(tmp_path, products.nemo(mesh, point, name, value), f"{point}.nc")
    both = tmp_path / "u.nc", tmp_path / "v.nc"
    _, report = report_of(capsys, *both)
    assert "--grid" in report["doubts"][0]
    status, report = report_of(capsys, *both, "--grid", tmp_path / "mesh_mask.nc")
    assert (status, report["records"]) == (0, products.RECORDS)


def test_options_of_currents_are_refused_for_other_files(tmp_path, capsys):
    (tmp_path / "clean.map").write_text(SQUARES)
    assert main(["doctor", str(tmp_path / "clean.map"), "--units", "cm/s"]) == 2
    assert "--units: it has an effect on currents, not on a map" in capsys.readouterr().err
    products.write(tmp_path, products.regular())
    _, report = report_of(capsys, tmp_path / "sea.nc", "--dims", "k=depth")
    assert "dims: 'k' is not a dimension" in report["doubts"][0]
