import json
import math

import pytest

from jaxcell.bundled import bundled
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


@pytest.mark.parametrize("suffix", [".jxf", ".nc", ".rrd", ".json", ".jsonl", ".yaml", ".edges"])
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
