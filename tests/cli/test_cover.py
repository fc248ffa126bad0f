import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from jaxcell.bounce.coverage import coverage_policy
from jaxcell.cli import main
from jaxcell.markov.solving import solve, stationary
from jaxcell.space import ENDPOINT, CellSpace, Workspace


MAPS = Path(__file__).parents[2] / "data" / "maps"
ARGS = ("--bounces", 45, 90, "--error", 45, "--reliability", 0.7, "--directions", 8)


def run(capsys, *args):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["cover", str(MAPS / "lab_a.json"), *map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


def lab():
    return CellSpace.of(Workspace.load(MAPS / "lab_a.json"), 1.0, 8)


def policy(target=None, **options):
    return coverage_policy(lab(), np.radians([45, 90]), math.pi / 4, 0.7, target, **options)


def test_prints_what_the_library_gives(capsys):
    status, found, _ = run(capsys, *ARGS, "--collision", "endpoint")
    expected = policy(motion=ENDPOINT)
    assert status == 0
    assert [p["alpha"] for p in found["policies"]] == pytest.approx(expected.alpha.tolist())
    assert [p["bounce_deg"] for p in found["policies"]] == [45, 90]
    assert found["distance"] == pytest.approx(expected.distance)
    assert found["total_variation"] == pytest.approx(expected.total_variation)
    assert found["cells"] == lab().size
    assert found["target"] == "uniform"
    for one, groups, coverage in zip(
        found["policies"], expected.groups, expected.coverage, strict=True
    ):
        assert one["persistent_groups"] == groups.count
        assert one["persistent_cells"] == int(groups.size.sum())
        assert one["positions_alone"] == int((coverage > 0).sum())
        assert one["stationarity_residual"] < 1e-10


def test_has_360_directions_by_default(capsys):
    args = ("--bounces", 45, "--error", 5, "--reliability", 0.8)
    status, found, _ = run(capsys, *args)
    assert (status, found["directions"]) == (0, 360)


def test_a_table_for_people(capsys):
    assert main(["cover", str(MAPS / "lab_a.json"), *map(str, ARGS)]) == 0
    out = capsys.readouterr().out
    assert "45°" in out
    assert f"{100 * float(policy().alpha[1]):.4g} %" in out


def test_an_image_as_target(capsys, tmp_path):
    cells = lab()
    worth = np.random.default_rng(0).integers(1, 255, cells.free.shape, np.uint8)
    picture = Image.fromarray(worth[::-1])
    deep = Image.fromarray(worth[::-1].astype(np.uint16) * 200)
    for name, image in (("grey", picture), ("color", picture.convert("RGB")), ("deep", deep)):
        file = tmp_path / f"{name}.png"
        image.save(file)
        status, found, _ = run(capsys, *ARGS, "--target", file)
        assert status == 0
        expected = policy(worth[cells.free].astype(float))
        assert found["distance"] == pytest.approx(expected.distance, rel=1e-6)
        assert found["target"] == str(file)


def test_a_variable_as_target(capsys, tmp_path):
    cells = lab()
    worth = np.random.default_rng(0).random(cells.free.shape)
    rows, columns = cells.free.shape
    file = tmp_path / "wanted.nc"
    xr.Dataset(
        {
            "on_grid": (("x", "y"), worth.T),
            "on_positions": ("position", worth[cells.free]),
            "on_time": ("time", [1.0]),
        },
        {"x": 0.6 + np.arange(columns), "y": 0.5 + np.arange(rows)},
    ).sortby("y", ascending=False).to_netcdf(file, engine="netcdf4")
    expected = policy(worth[cells.free]).distance
    for name in ("on_grid", "on_positions"):
        status, found, _ = run(capsys, *ARGS, "--target", f"{file}:{name}")
        assert (status, found["distance"]) == (0, pytest.approx(expected))
    for target, message in (
        (f"{file}:on_time", "over position, or over coordinates x and y .* over time"),
        (f"{file}:nothing", "which holds on_grid, on_positions, on_time"),
        (file, r"which variable\? give FILE.nc:VARIABLE"),
    ):
        status, found, error = run(capsys, *ARGS, "--target", target)
        assert (status, found) == (2, None)
        assert_line(error, f"--target .*{message}")


def test_coordinates_must_reach_over_the_map(capsys, tmp_path):
    file = tmp_path / "small.nc"
    grid = xr.Dataset({"worth": (("y", "x"), np.ones((2, 2)))}, {"x": [0.5, 1.5], "y": [0.5, 3.5]})
    grid.to_netcdf(file, engine="netcdf4")
    status, _, error = run(capsys, *ARGS, "--target", f"{file}:worth")
    assert status == 2
    assert_line(error, "reaches 6 m beyond its coordinates x, which go from 0.5 to 1.5")


def assert_line(error, message):
    assert error.count("\n") == 1
    assert "Traceback" not in error
    assert re.search(message, error), error


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--bounces", 30, *ARGS[3:]), "bounce: 30 deg is not a whole number of the 8 directions"),
        (("--bounces", 45, 405, *ARGS[3:]), "bounces: 405 deg comes twice"),
        ((*ARGS, "--error", 30), "error: 30 deg is not a whole number"),
        ((*ARGS, "--error", 180), r"error: \+-180 deg are 9 turns, more than the 8 directions"),
        ((*ARGS, "--reliability", 0), "reliability: expected above 0 and at most 1, got 0"),
        ((*ARGS, "--reliability", 1.5), "reliability: .* got 1.5"),
        ((*ARGS, "--error", 0), "reliability: 0.7 leaves a chance of an error"),
        ((*ARGS, "--target", "nowhere.png"), "--target nowhere.png: there is no such file"),
        ((*ARGS, "--target", "no.nc:v"), "--target no.nc:v: there is no file no.nc"),
        ((*ARGS, "--target", MAPS / "lab_a.json"), "--target .*lab_a.json: it is no image"),
    ],
)
def test_bad_input_is_refused_in_one_line(capsys, args, message):
    status, found, error = run(capsys, *args)
    assert (status, found) == (2, None)
    assert_line(error, f"^jaxcell cover: .*{message}")


def test_a_dark_image_is_refused(capsys, tmp_path):
    file = tmp_path / "dark.png"
    Image.fromarray(np.zeros((4, 8), np.uint8)).save(file)
    status, _, error = run(capsys, *ARGS, "--target", file)
    assert status == 2
    assert_line(error, r"--target .*dark.png: it is 0 at all positions")


def test_a_solve_that_stalls_has_no_answer(capsys, monkeypatch):
    monkeypatch.setattr(solve, "LARGEST_FACTOR", 0)
    monkeypatch.setattr(solve, "MAX_PRODUCTS", 2)
    monkeypatch.setattr(stationary, "_SMALL", 0)
    status, found, error = run(capsys, *ARGS)
    assert (status, found) == (1, None)
    assert_line(error, "^jaxcell cover: limiting_distribution: the residual stayed")


def test_writes_its_results(capsys, tmp_path):
    status, found, _ = run(capsys, *ARGS, "--out", tmp_path / "out")
    assert status == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == found
    with xr.open_dataset(tmp_path / "out" / "coverage.nc") as dataset:
        assert dataset.alpha.values.tolist() == [p["alpha"] for p in found["policies"]]
        assert json.loads(dataset.attrs["spec"])["bounces_deg"] == [45, 90]
    assert (tmp_path / "out" / "coverage.rrd").stat().st_size > 1000
