import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcell import drift
from jaxcell.cli import main
from jaxcell.study import Drift


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"
# The number of seconds with three groups in every layer.
STEP = ("--duration", 3400, "--method", "source")

pytestmark = pytest.mark.usefixtures("few_drifters")


def run(capsys, *args, file=GYRES):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["drift", str(file), *map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    """A file in which the water goes to the East, a kilometre an hour."""
    east = np.full((1, 1, 4, 9), 1 / 3.6, np.float32)
    names = "sea_water_velocity"
    currents = xr.Dataset(
        {
            "u": (("time", "depth", "lat", "lon"), east, {"standard_name": f"eastward_{names}"}),
            "v": (
                ("time", "depth", "lat", "lon"),
                np.zeros_like(east),
                {"standard_name": f"northward_{names}"},
            ),
        },
        coords={
            "time": ("time", [np.datetime64("2020-05-01", "ns")]),
            "depth": ("depth", [0.0], {"units": "m", "positive": "down"}),
            "lat": ("lat", 0.009 * np.arange(4), {"units": "degrees_north"}),
            "lon": ("lon", 0.009 * np.arange(9), {"units": "degrees_east"}),
        },
    )
    file = tmp_path_factory.mktemp("stream") / "stream.nc"
    currents.to_netcdf(file)
    return file


def test_velocities_and_grid_in_files_of_their_own(capsys, stream, tmp_path):
    with xr.open_dataset(stream, decode_times=False) as whole:
        positions = whole[["lon", "lat"]]
        bare = whole.drop_vars(["lon", "lat"]).rename(u="east", v="north")
        for name in ("east", "north"):
            bare[[name]].to_netcdf(tmp_path / f"{name}.nc")
        positions.to_netcdf(tmp_path / "grid.nc")
    grid, names = tmp_path / "grid.nc", ("east", "north")
    apart = Drift(file=(tmp_path / "e*.nc", tmp_path / "north.nc"), grid=grid, variables=names)
    found, expected = apart.currents(), drift.open_currents(stream)
    xr.testing.assert_equal(found, expected)
    assert found.attrs["source"] == "east.nc, north.nc"
    assert "lon, lat: from grid.nc" in found.attrs["notes"]
    files = [tmp_path / "east.nc", tmp_path / "north.nc"]
    status, _, error = run(
        capsys, files[1], "--grid", grid, "--variables", "east", "south", file=files[0]
    )
    assert status == 2
    line = f"jaxcell drift: {files[0]}, {files[1]}: variables: 'south' is not in the file, which "
    assert error == f"{line}has east, north\n"


def behaviours(duration, **options):
    """The long-term behaviour of each layer of the gyres, by the library."""
    currents = drift.open_currents(GYRES)
    found = []
    for layer in range(3):
        water = drift.Water.of(currents, layer)
        flow = drift.Flow.of(currents, layer).mean()
        chain = drift.drift_map(water, flow, drift.DriftStep(duration, **options))
        found.append(drift.long_term_behaviour(chain, duration))
    return currents, found


def test_groups_and_times_of_each_layer(capsys):
    status, found, error = run(capsys, *STEP)
    assert status == 0
    # The rules of the source are far from drifters, and it says what is nearer.
    far = [
        f'At {depth} m: after 23.6 h the map has .* by the method "drifters"'
        for depth in (0, 5, 10)
    ]
    for line, expected in zip(error.splitlines(), far, strict=True):
        assert re.match(expected, line)
    assert (
        found["distance_24h"] == max(one["compared_distance"][1] for one in found["layers"]) > 0.7
    )
    assert found["east_from"].startswith("u (by the standard names")
    assert found["duration_s"] == 3400
    assert (len(found["records"]), found["records"][0]) == (24, "2011-07-01T00:00:00")
    _, expected = behaviours(3400)
    for layer, one in zip(found["layers"], expected, strict=True):
        sizes = [group["cells"] for group in layer["groups"]]
        assert layer["persistent_groups"] == len(sizes)
        assert sizes == np.asarray(one.groups.size).tolist()
        single = np.asarray(one.basin) >= 0
        leads = sum(group["single_domicile_cells"] for group in layer["groups"])
        assert leads == layer["single_domicile_cells"] == single.sum() - sum(sizes)
        assert sum(sizes) + leads + layer["multiple_domicile_cells"] == layer["cells"]
        hours = np.asarray(one.hours)
        hours = hours[hours > 0]
        assert layer["longest_hours"] == pytest.approx(hours.max())
        assert layer["mean_hours"] == pytest.approx(hours.mean())
        parts = {tuple(part["domiciles"]): part for part in layer["transients"]}
        assert sum(part["cells"] for part in parts.values()) == hours.size
        weighed = sum(part["cells"] * part["mean_hours"] for part in parts.values())
        assert weighed == pytest.approx(hours.sum())
        assert "warning" not in layer
        assert layer["mean_leaving"] == pytest.approx(0, abs=1e-12)
    assert [layer["depth"] for layer in found["layers"]] == [0, 5, 10]
    assert found["sensitivity"][1] == {"duration": 3400, "groups": 3, "groups_if_known": 3}
    assert [one["duration"] for one in found["sensitivity"]] == [1700, 3400, 6800, 13600]
    assert not {"reached_cells", "voyage", "surest", "views"} & found.keys()


def test_deployment(capsys):
    _, found, _ = run(capsys, *STEP, "--range", 6000, "--depths", 0)
    currents, (surface, *_) = behaviours(3400)
    water = drift.Water.of(currents, 0)
    cells = drift.deployment_cells(surface).cells
    told = [water.cell(one["lon"], one["lat"]) for one in found["deployment"]]
    assert told == cells.tolist()
    assert len(found["minimum"]) == drift.minimum_deployment(surface.chain).size
    assert found["curve_covered"][-1] == water.cells
    views = drift.visible_deployment(water, 6000.0, surface.groups)
    assert [one["cell"] for one in found["views"]] == views.cover.tolist()
    kept = [water.cell(one["lon"], one["lat"]) for one in found["views"] if one["kept"]]
    assert kept == views.cells.tolist()
    assert len(found["layers"]) == 1


def test_the_way_to_a_goal(capsys):
    status, found, _ = run(
        capsys, *STEP, "--start", "-118.0,33.5", "--goal", "-118.1,33.45,5", "--discount", 0.98
    )
    assert status == 0
    currents, layers = behaviours(3400)
    waters = [drift.Water.of(currents, layer) for layer in range(3)]
    sea = drift.Sea.of(waters, [one.chain for one in layers])
    start = waters[0].cell(-118.0, 33.5)
    goal = waters[0].cells + waters[1].cell(-118.1, 33.45)
    keeping = drift.reachable_by_layer(sea, start)
    changing = drift.reachable_at_depth(sea, start)
    for layer in range(3):
        assert found["reached_cells"][layer] == keeping[sea.layer == layer].sum()
        assert found["reached_cells_at_any_depth"][layer] == changing[sea.layer == layer].sum()
    ways = {
        "voyage": drift.discounted_voyage(sea, goal, 0.98),
        "surest": drift.surest_voyage(sea, goal),
    }
    voyage = found["voyage"]
    assert voyage["iterations"] == ways["voyage"].certificate.iterations
    assert voyage["value_error"] <= 1e-8
    for name, way in ways.items():
        assert found[name]["start_probability"] == pytest.approx(float(way.probability[start]))
        assert found[name]["start_hours"] == pytest.approx(float(way.time[start]) * 3400 / 3600)
        mean = float(np.asarray(way.probability).mean())
        assert found[name]["mean_probability"] == pytest.approx(mean)
        assert found[name]["policy_certified"]
        assert found[name]["times_certified"]
    assert np.abs(np.subtract(voyage["goal"], [-118.1, 33.45, 5])).max() < 0.006


def test_a_goal_up_the_stream_has_no_answer(capsys, stream):
    args = ("--method", "source", "--edge", "exit", "--rho", 1, "--start", "0.04,0.01")
    status, found, error = run(capsys, *args, "--goal", "0.01,0.01,0", file=stream)
    assert status == 1
    assert found["surest"]["start_probability"] == 0
    assert found["surest"]["start_hours"] is None
    assert found["surest"]["start_hours_if_it_arrives"] is None
    assert error == "No policy brings a drifter from the start to the goal.\n"
    status, found, error = run(capsys, *args, "--goal", "0.07,0.01,0", file=stream)
    assert (status, error) == (0, "")
    assert found["voyage"]["start_probability"] == 1
    # Four cells, a kilometre each, at a kilometre an hour.
    assert found["voyage"]["start_hours"] == pytest.approx(4, rel=0.01)
    assert found["layers"][0]["mean_leaving"] == 1
    assert found["layers"][0]["persistent_groups"] == 0
    assert [one["groups"] for one in found["sensitivity"]][1:] == [0, 0, 0]


def test_the_step_is_long_enough_for_the_slowest_layer(capsys):
    part = (-118.1, 33.44, -117.9, 33.54)
    _, found, _ = run(capsys, "--method", "source", "--bounds", *part)
    shifts = [layer["mean_shift_cells"] for layer in found["layers"]]
    assert min(shifts) == pytest.approx(1)
    _, found, _ = run(capsys, "--depths", 0, "--bounds", *part)
    currents = drift.open_currents(GYRES, depths=0, bounds=part)
    layer = [drift.Water.of(currents)], [drift.Flow.of(currents).repeated()]
    nearest = drift.nearest_step(*layer, drift.METHODS["drifters"]).duration
    assert found["duration_s"] == pytest.approx(nearest)
    assert (found["spread"], found["edge"]) == ("sampled", "exit")
    assert found["layers"][0]["self_image_share"] < 0.1
    assert max(found["distance_6h"], found["distance_24h"]) < 0.2


def test_a_part_of_the_file(capsys):
    _, found, _ = run(capsys, "--time", 3, "--bounds", -118.1, 33.4, -118.05, 33.5, "--depths", 5)
    assert found["records"] == ["2011-07-01T03:00:00"]
    assert found["depths_m"] == [5]
    currents = drift.open_currents(GYRES, time=3, depths=5, bounds=(-118.1, 33.4, -118.05, 33.5))
    assert found["layers"][0]["cells"] == int(currents.water.sum())
    _, same, _ = run(
        capsys,
        *("--time", "2011-07-01T03:00", "--depths", 5),
        *("--bounds", -118.1, 33.4, -118.05, 33.5),
    )
    assert same["layers"] == found["layers"]


def test_a_step_that_is_too_short_is_warned_of(capsys):
    args = ["--duration", "900", "--depths", "0", "--method", "source"]
    assert main(["drift", str(GYRES), *args]) == 0
    captured = capsys.readouterr()
    assert re.search("At 0 m: .* the grid, and not the water", captured.err)
    advice = '; take a longer duration or the spread "sampled".\n'
    assert advice in captured.err.replace(" \n", " ")
    # Enough for a terminal, and where the rest is.
    assert len(captured.out.splitlines()) <= 40
    assert "The rest is in the files of --out, and in --json." in captured.out


def test_advice_names_no_option_that_is_on(capsys):
    args = ("--duration", "900", "--time", "0", "--depths", "0", "--spread", "sampled")
    assert main(["drift", str(GYRES), *args]) == 0
    error = capsys.readouterr().err
    assert "; take a longer duration.\n" in error
    assert "the spread" not in error


def test_velocities_by_name(capsys, stream, tmp_path):
    with xr.open_dataset(stream) as known:
        bare = known.load().rename(u="p", v="q")
    for name in "pq":
        bare[name].attrs = {}
    bare.to_netcdf(tmp_path / "bare.nc")
    status, found, error = run(capsys, file=tmp_path / "bare.nc")
    assert (status, found) == (2, None)
    args = ("--edge", "exit", "--variables", "p", "q")
    status, found, error = run(capsys, *args, file=tmp_path / "bare.nc")
    assert (status, error) == (0, "")
    assert found["variables"] == ["p", "q"]
    assert found["east_from"] == "p (as asked)"


def test_around_the_earth(capsys, tmp_path):
    """A jet goes on for ever, also as computed anew and in the recording."""
    lon, lat = np.arange(0.0, 360, 10), np.arange(-15.0, 20, 10)
    east = np.ones((lat.size, lon.size))
    names = "sea_water_velocity"
    jet = xr.Dataset(
        {
            "u": (("lat", "lon"), east, {"standard_name": f"eastward_{names}"}),
            "v": (("lat", "lon"), 0 * east, {"standard_name": f"northward_{names}"}),
        },
        {
            "lat": ("lat", lat, {"units": "degrees_north"}),
            "lon": ("lon", lon, {"units": "degrees_east"}),
        },
    )
    jet.to_netcdf(tmp_path / "jet.nc")
    args = (
        "--method",
        "source",
        "--edge",
        "exit",
        "--rho",
        1,
        "--duration",
        1.1e6,
        "--out",
        tmp_path / "out",
    )
    status, found, error = run(capsys, *args, "--verify", file=tmp_path / "jet.nc")
    assert (status, error) == (0, "")
    (layer,) = found["layers"]
    assert [group["cells"] for group in layer["groups"]] == [lon.size] * lat.size
    assert layer["mean_leaving"] == 0
    assert any("goes round the Earth" in note for note in found["notes"])
    # A land cell and disturbances, too.
    jet["u"][1, 3] = np.nan
    jet.to_netcdf(tmp_path / "jet.nc")
    for spread in ("turned", "all", "sampled"):
        args = ("--edge", "exit", "--spread", spread, "--verify")
        status, found, error = run(capsys, *args, file=tmp_path / "jet.nc")
        assert status == 0, error


def test_tables_for_people(capsys):
    args = ["--start", "-118.0,33.5", "--goal", "-118.1,33.45,5", "--range", "6000"]
    assert main(["drift", str(GYRES), *map(str, STEP), *args]) == 0
    out = capsys.readouterr().out
    assert "drifters that the map has in a wrong" in out
    assert re.search(r"persistent groups +│ 3 +│ 3 +│ 3 ", out)
    assert re.search(r"cells of water +│ 538 +│ 538 +│ 436 ", out)
    assert out[out.index("Views") : out.index("Layers")].count("°") == 2 * 17
    assert "Deployment" not in out
    assert re.search(r"cells reached, by keeping the depth +│ 536, 530, 433 ", out)
    assert re.search(r"depth of the goal +│ -118.096, 33.454, 5 ", out)


def test_six_layers_fit_on_a_screen_and_begin_with_what_people_ask(
    capsys, monkeypatch, stream, tmp_path
):
    monkeypatch.setenv("COLUMNS", "80")
    with xr.open_dataset(stream) as one:
        depths = {"depth": ("depth", [0.0, 10, 25, 50, 75, 100], one.depth.attrs)}
        deep = xr.concat([one.load().drop_vars("depth")] * 6, "depth").assign_coords(depths)
    deep.transpose("time", "depth", "lat", "lon").to_netcdf(tmp_path / "deep.nc")
    # So short a step is warned of in every layer.
    assert main(["drift", str(tmp_path / "deep.nc"), "--duration", "300"]) == 0
    captured = capsys.readouterr()
    said = captured.out.splitlines() + captured.err.splitlines()
    assert len(said) <= 40
    assert "more of that kind, at other depths" in captured.err
    rows = [line.split("│")[1].strip() for line in said if line.startswith("│")]
    assert rows[:5] == [
        "persistent groups",
        "probability of leaving the map, mean",
        "time to a group or off the map, transient cells, median",
        "drifters that left the map after about 24 h",
        "drifters that the map has in a wrong cell after about 24 h",
    ]
    # One row for each layer.
    assert rows[-6:] == [str(layer) for layer in range(6)]


@pytest.mark.parametrize("back", [None, 14_400])
def test_as_many_strand_as_of_drifters_that_strand(capsys, stream, tmp_path, back):
    """Drifters of the current, followed one by one, of which those at a coast toss a coin."""
    with xr.open_dataset(stream, decode_times=False) as sea:
        sea.where(sea.lon < sea.lon[-1]).transpose(*sea.u.dims).to_netcdf(tmp_path / "coast.nc")
    # Four of the five points of a cell along its way come to the next one.
    step, after, half = 2880, 14_400, 7200
    args = ["--duration", step, "--after", after, "--beaching", half]
    args += [] if back is None else ["--resuspension", back]
    _, found, _ = run(capsys, *args, file=tmp_path / "coast.nc")
    random = np.random.default_rng(4)
    currents = drift.open_currents(tmp_path / "coast.nc")
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)
    coast = drift.coast(water)
    assert coast.sum() == found["beaching"]["beaches"] == 4
    cell = random.integers(0, water.cells, 20_000)
    x, y = (one[cell] + random.uniform(-0.5, 0.5, cell.size) for one in (water.column, water.row))
    ashore, gone = np.zeros((2, cell.size), bool)
    strands, floats = 1 - 2 ** (-step / half), 0 if back is None else 1 - 2 ** (-step / back)
    for _ in range(after // step):
        draw = random.random(cell.size)
        lands = ~ashore & ~gone & coast[cell] & (draw < strands)
        moves = ~ashore & ~gone & ~lands
        ashore = (ashore & (draw >= floats)) | lands
        moved = drift.advect(flow, x, y, float(step), method="rk4", steps=4)
        x, y = (np.where(moves, a, b) for a, b in zip(moved, (x, y), strict=True))
        landed = water.landing(x[None], y[None], origin=cell, exits=True)[0]
        gone |= moves & (landed < 0)
        cell = np.where(moves & (landed >= 0), landed, cell)
    assert found["beaching"]["share"] == pytest.approx(ashore.mean(), abs=0.02)
    assert found["beaching"]["left"] == pytest.approx(gone.mean(), abs=0.02)
    assert 0.2 < ashore.mean() < 0.7


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--beaching", 0), "--beaching: expected more than 0 seconds, got 0"),
        (("--resuspension", 60), "--resuspension has no meaning without beaching"),
    ],
)
def test_beaching_out_of_range_is_refused(capsys, stream, args, message):
    status, found, error = run(capsys, *args, file=stream)
    assert (status, found, error) == (2, None, f"jaxcell drift: {message}\n")


def test_writes_its_results(capsys, tmp_path):
    out = tmp_path / "new" / "out"
    status, found, _ = run(capsys, *STEP, "--depths", 0, "--out", out)
    assert status == 0
    assert {path.name for path in out.iterdir()} == {
        "deployment.csv",
        "deployment.geojson",
        "drift.nc",
        "drift.rrd",
        "summary.json",
    }
    assert json.loads((out / "summary.json").read_text()) == found
    with xr.open_dataset(out / "drift.nc") as dataset:
        assert dataset.sizes["layer"] == 1
        assert int(dataset.group.max()) == found["layers"][0]["persistent_groups"] - 1
        assert json.loads(dataset.attrs["spec"])["duration_s"] == 3400
    with (out / "deployment.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["lon"]) for row in rows] == pytest.approx(
        [one["lon"] for one in found["deployment"]], abs=1e-6
    )


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--rho", 1.5), "--rho: expected a probability from 0 to 1, got 1.5"),
        (("--duration", 0), "--duration: expected more than 0 seconds, got 0"),
        (("--discount", 1), "--discount: expected more than 0 and less than 1, got 1"),
        (("--rho", 0.5), "--rho has no meaning for a spread that is sampled"),
        (
            ("--rho", 0.5, "--method", "source", "--spread", "sampled"),
            "--rho has no meaning for a spread that is sampled",
        ),
        (("--after", 60), "--after has no meaning without regions or beaching"),
        (("--discount", 0.5), "--discount has no meaning without a goal"),
        (("--range", -2), "--range: expected more than 0 m, got -2"),
        (("--range", 20), "--range: expected 707"),
        (("--search", 5), "--search has no meaning without a range"),
        (("--nearly-closed", 437), "--nearly-closed: expected at most 436, the cells of a layer"),
        (
            ("--duration", 1e-9),
            "--duration: expected 3.47 to 3.47e\\+06 s, in which drifters go by",
        ),
        (("--start", "here"), "--start 'here': expected \"lon,lat\" in degrees"),
        (("--start", "5,6"), r"--start 5,6: place \(5, 6\) is off the grid"),
        (("--goal", "-118,33.5"), "--goal '-118,33.5': expected \"lon,lat,depth\" in degrees"),
        (("--goal", "-118,33.5,3"), "expected one of the depths 0, 5, 10 m, got 3"),
        (("--goal", "-117.85,33.45,10"), "is not in the water at 10 m"),
        (("--depths", 3), "3"),
        (("--time", 99), "99"),
        (("--time", "1999-01-01"), "1999-01-01"),
        (("--bounds", 0, 0, 1, 1), "gyres.nc: bounds"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, monkeypatch, args, message):
    # It is refused before anything is mapped.
    monkeypatch.delattr("jaxcell.drift.results.layer.drift_maps")
    monkeypatch.delattr("jaxcell.drift.validation.distance.drift_maps")
    status, found, error = run(capsys, *args)
    assert (status, found) == (2, None)
    assert error.count("\n") == 1
    assert re.search(f"^jaxcell drift: .*{message}", error), error


def test_bad_files_are_one_line_and_status_2(capsys, tmp_path):
    (tmp_path / "cut.nc").write_bytes(GYRES.read_bytes()[:5000])
    (tmp_path / "text.nc").write_text("no")
    for name in ("cut.nc", "text.nc", "none.nc"):
        status, found, error = run(capsys, file=tmp_path / name)
        assert (status, found) == (2, None)
        assert re.fullmatch(rf"jaxcell drift: .*{name}.*\n", error), error


def test_no_answer_is_status_1(capsys, monkeypatch):
    def stalls(*args, **options):
        raise RuntimeError("the residual stayed above the tolerance")

    monkeypatch.setattr("jaxcell.drift.results.sea_drift.discounted_voyage", stalls)
    status, found, error = run(capsys, *STEP, "--goal", "-118.1,33.45,5")
    assert (status, found) == (1, None)
    assert error == "jaxcell drift: the residual stayed above the tolerance\n"


def test_backward_with_diffusion_between_regions(capsys, stream, tmp_path):
    box = [[-0.004, -0.01], [0.0405, -0.01], [0.0405, 0.04], [-0.004, 0.04], [-0.004, -0.01]]
    geometry = {"type": "Polygon", "coordinates": [box]}
    feature = {"type": "Feature", "properties": {"name": "west"}, "geometry": geometry}
    path = tmp_path / "regions.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    hour = ("--duration", 3600, "--regions", path, "--after", 3600)
    _, found, _ = run(capsys, *hour, file=stream)
    (west,) = found["exchange"]["regions"]
    # Five columns, a column an hour.
    assert (west["name"], west["cell_count"]) == ("west", 20)
    assert west["share"] == pytest.approx([0.8], abs=1e-3)
    assert west["residence_hours"] == pytest.approx(3.0, abs=0.01)
    assert west["left"] == pytest.approx(0, abs=1e-9)
    _, found, error = run(capsys, *hour, "--backward", "--diffusivity", 1, file=stream)
    (west,) = found["exchange"]["regions"]
    assert west["share"] == pytest.approx([0.8], abs=0.01)
    assert west["left"] == pytest.approx(0.2, abs=0.02)
    assert error.startswith("Drifters go backward in time, from the last record on")


@pytest.mark.parametrize("wrong", ["diffusivity=-1", "windage=2", "after=0"])
def test_physics_out_of_range_is_refused(capsys, stream, wrong):
    status, _, error = run(capsys, f"--{wrong}", file=stream)
    assert status == 2
    assert error.startswith(f"jaxcell drift: --{wrong.split('=')[0]}: expected")


def test_wind_that_is_not_there(capsys, stream):
    status, _, error = run(capsys, "--windage", 0.03, file=stream)
    assert status == 2
    assert error.startswith(f"jaxcell drift: {stream}: wind: the file has no wind")
