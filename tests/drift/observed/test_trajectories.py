"""Files of trajectories in the layouts of real products, and the chains that they give."""

import contextlib
import dataclasses

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, strategies as st

from jaxcell import drift
from jaxcell.base.doubts import Doubt
from jaxcell.drift.observed.moves import located


# Three drifters of 4, 2 and 3 observations, the first of which crosses the date line.
LON = [[179.6, 179.8, -179.9, -179.5], [10.0, 10.25], [-30.0, -30.5, -31.0]]
LAT = [[0.5, 0.5, 0.75, 1.0], [50.0, 50.5], [-60.0, -60.0, -60.25]]
HOURS = [[0, 6, 12, 18], [6, 12], [0, 6, 18]]
SINCE = "hours since 2020-01-01"


def padded(rows, width, fill):
    return np.array([[*row, *[fill] * (width - len(row))] for row in rows])


def global_drifter_program():
    """A ragged array with the number of observations of each drifter."""
    data = {"longitude": ("obs", np.concatenate(LON)), "latitude": ("obs", np.concatenate(LAT))}
    data["rowsize"] = ("traj", [4, 2, 3], {"sample_dimension": "obs"})
    data["start_lon"] = ("traj", [row[0] for row in LON], {"standard_name": "longitude"})
    seconds = 3600 * np.concatenate(HOURS)
    time = ("obs", seconds, {"units": "seconds since 2020-01-01 00:00:00"})
    return xr.Dataset({**data, "ID": ("traj", [101, 77, 300])}, {"time": time})


def labelled():
    """Observations in any order, each with its drifter."""
    order = np.random.default_rng(0).permutation(9)
    data = {
        "LON": ("obs", np.concatenate(LON)[order]),
        "LAT": ("obs", np.concatenate(LAT)[order]),
        "TIME": ("obs", np.concatenate(HOURS)[order], {"units": "hour"}),
        "ID": ("obs", np.repeat([5, 80, 200], [4, 2, 3])[order]),
    }
    return xr.Dataset(data)


def opendrift():
    """A matrix by time, with longitudes from 0 to 360, empty before and after."""
    place = {"lon": np.full((3, 4), np.nan), "lat": np.full((3, 4), np.nan)}
    for number, (lon, lat, hours) in enumerate(zip(LON, LAT, HOURS, strict=True)):
        at = np.array(hours) // 6
        place["lon"][number, at], place["lat"][number, at] = np.array(lon) % 360, lat
    dims = "trajectory", "time"
    data = {name: (dims, values, {"_FillValue": 9.96921e36}) for name, values in place.items()}
    data["lon"][2]["standard_name"] = "longitude"
    return xr.Dataset(data, {"time": ("time", [0, 6, 12, 18], {"units": SINCE})})


def parcels():
    """A matrix by observation, each with its time."""
    data = {
        "lon": (("traj", "obs"), padded(LON, 4, np.nan)),
        "lat": (("traj", "obs"), padded(LAT, 4, np.nan)),
        "time": (("traj", "obs"), padded(HOURS, 4, np.nan), {"units": SINCE}),
        "z": (("traj", "obs"), padded(LAT, 4, np.nan)),
    }
    return xr.Dataset(data)


def same(seen):
    assert seen.drifters == 3
    np.testing.assert_allclose(seen.lon, np.concatenate(LON), atol=1e-9)
    np.testing.assert_allclose(seen.lat, np.concatenate(LAT))
    np.testing.assert_array_equal(seen.time, 3600 * np.concatenate(HOURS))
    np.testing.assert_array_equal(seen.drifter, np.repeat([0, 1, 2], [4, 2, 3]))


@pytest.mark.parametrize("made", [global_drifter_program, labelled, opendrift, parcels])
def test_products_are_read(made, tmp_path):
    path = tmp_path / "drifters.nc"
    made().to_netcdf(path)
    trajectories = drift.open_trajectories(path)
    same(trajectories)
    assert trajectories.source == "drifters.nc"


def test_a_zarr_store_is_read(tmp_path):
    parcels().rename(traj="trajectory").to_zarr(tmp_path / "particles.zarr", consolidated=False)
    same(drift.open_trajectories(tmp_path / "particles.zarr"))


def test_decoded_times_of_an_open_dataset_are_read():
    trajectories = drift.open_trajectories(xr.decode_cf(parcels()))
    same(
        drift.Trajectories(
            trajectories.lon,
            trajectories.lat,
            trajectories.time - trajectories.time[0],
            trajectories.drifter,
        )
    )


def drogue_status(file):
    """Drogues that the first drifter loses after two observations, and the second has lost."""
    return file.assign(drogue_status=("obs", np.int8([1, 1, 0, 0, 0, 0, 1, 1, 1])))


def drogue_lost_date(file):
    dates = ("traj", [1.577880e9, 1.0, np.nan], {"units": "seconds since 1970-01-01 00:00:00"})
    time = ("obs", 1577836800.0 + 3600 * np.concatenate(HOURS), dates[2])
    return file.assign_coords(time=time).assign(drogue_lost_date=dates)


@pytest.mark.parametrize("marked", [drogue_status, drogue_lost_date])
def test_drifters_with_and_without_a_drogue_are_told_apart(marked, tmp_path):
    marked(global_drifter_program()).to_netcdf(tmp_path / "drogues.nc")
    seen = drift.open_trajectories(tmp_path / "drogues.nc")
    assert seen.drogued.tolist() == [True] * 2 + [False] * 4 + [True] * 3
    kept, lost = seen.with_drogue(True), seen.with_drogue(False)
    np.testing.assert_allclose(kept.lon, [*LON[0][:2], *LON[2]])
    np.testing.assert_allclose(lost.lon, [*LON[0][2:], *LON[1]], atol=1e-9)
    assert (kept.drifters, lost.drifters) == (2, 2)
    with pytest.raises(ValueError, match="no drifter had lost its drogue"):
        kept.with_drogue(False)
    global_drifter_program().to_netcdf(tmp_path / "unknown.nc")
    with pytest.raises(ValueError, match="not known which drifters had their drogue"):
        drift.open_trajectories(tmp_path / "unknown.nc").with_drogue(True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.drop_vars(["longitude", "start_lon"]),
         "lon: expected trajectories with a longitude, got"),
        (lambda d: d.assign(rowsize=d.rowsize + 1), "rowsize: expected 9 observations of all drif"),
        (lambda d: d.assign(rowsize=("traj", [14, -2, -3])), "rowsize: .* that are none of obs"),
        (lambda d: d.assign(rowsize=("traj", [4.5, 2.5, 2])), "rowsize: .* that are none of obs"),
        (lambda d: d.assign(rowsize=("traj", [4, 5, np.nan])), "rowsize: .* that are none of obs"),
        (lambda d: d.assign(rowsize=(("a", "b"), [[4, 5]])), "rowsize: .* that are none of obs"),
        (lambda d: d.drop_vars("rowsize"), "longitude: the drifters along obs are unknown"),
        (lambda d: d.assign(latitude=d.start_lon),
         "latitude: expected dimensions of .'obs',., got"),
    ],
)  # fmt: skip
def test_files_without_complete_trajectories_are_refused(change, message, tmp_path):
    change(global_drifter_program().drop_vars("ID")).to_netcdf(tmp_path / "odd.nc")
    with pytest.raises(ValueError, match=f"odd.nc: {message}"):
        drift.open_trajectories(tmp_path / "odd.nc")


def test_boxes_go_on_beyond_the_date_line():
    seen = drift.open_trajectories(parcels())
    first = drift.Trajectories(seen.lon[:4], seen.lat[:4], seen.time[:4], seen.drifter[:4])
    water = drift.boxes(first, 0.5)
    assert water.number.tolist() == [[0, 1, -1], [-1, -1, 2]]
    np.testing.assert_allclose(water.lon[0], [179.75, -179.75, -179.25])
    # All of them go round the Earth, and so do the columns; the moves are the same.
    whole = drift.boxes(seen, 1.0, (-180, -90, 180, 90))
    assert whole.wraps
    moves = drift.count_moves(first, whole, 6 * 3600.0)
    lon = moves.water.lon[moves.water.row, moves.water.column]
    assert lon[moves.begin].tolist() == [179.5, 179.5, -179.5]
    with pytest.raises(ValueError, match="bounds: no drifter was within them"):
        drift.boxes(first, 1.0, (0, 0, 10, 10))


@pytest.mark.parametrize("cell", [1.0, 4.0, 7.0, 40.0, 80.0])
@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize(("south", "north"), [(-90, -70), (70, 90), (0, 90), (-90, 90)])
def test_boxes_end_at_the_poles(cell, asked, south, north):
    lat = np.array([south + 0.1, north - 0.1])
    seen = drift.Trajectories.of(np.full(2, 5.0), lat, np.zeros(2), np.arange(2))
    water = drift.boxes(seen, cell, (0, south, 90, north) if asked else None)
    south, north = water.lat[0, 0] - cell / 2, water.lat[-1, 0] + cell / 2
    assert south <= seen.lat.min() + 1e-9
    assert north >= seen.lat.max() - 1e-9
    assert north - south > 180 or (south >= -90 - 1e-9 and north <= 90 + 1e-9)
    assert np.abs(water.lat).max() < 90 - 1e-9
    assert (located(water, seen.lon, seen.lat) >= 0).all()


@pytest.mark.parametrize(("west", "cell"), [(1.7, 0.1), (3.4, 0.2), (-51.2, 0.1), (0.35, 0.01)])
def test_boxes_begin_with_the_first_observation_despite_rounding(west, cell):
    lon = west + cell * np.array([0.0, 1.5])
    seen = drift.Trajectories(lon, np.full(2, 0.55), np.zeros(2), np.arange(2))
    assert drift.boxes(seen, cell).number.shape[1] == 2


@pytest.mark.parametrize(("count", "moves"), [(1, []), (2, [0]), (3, [0, 0])])
def test_a_drifter_with_few_observations_has_few_moves(count, moves):
    time, number = np.arange(count) * 3600.0, np.zeros(count, int)
    seen = drift.Trajectories(np.full(count, 5.0), np.full(count, 0.5), time, number)
    expected = contextlib.nullcontext() if moves else pytest.raises(ValueError, match="3600 s")
    with expected:
        assert drift.count_moves(seen, drift.boxes(seen, 1.0), 3600.0).drifter.tolist() == moves


def test_moves_are_between_observations_a_lag_apart():
    seen = drift.open_trajectories(parcels())
    water = drift.boxes(seen, 0.25)
    assert drift.count_moves(seen, water, 6 * 3600.0).drifter.tolist() == [0, 0, 0, 1, 2]
    assert drift.count_moves(seen, water, 12 * 3600.0).drifter.tolist() == [0, 0, 2]
    with pytest.raises(ValueError, match="least: no cell has 2 moves in 21600 s; the most has 1"):
        drift.count_moves(seen, water, 6 * 3600.0, least=2)


def walks(random, matrix, drifters, steps):
    """Drifters of a chain over cells of a degree from 170 degrees East on; off the end is gone."""
    cells = len(matrix)
    rows = np.cumsum(np.column_stack([matrix, 1 - matrix.sum(axis=1)]), axis=1)
    place = np.full((drifters, steps + 1), cells)
    place[:, 0] = random.integers(0, cells, drifters)
    for n in range(steps):
        here = place[:, n] < cells
        draw = random.random(here.sum())[:, None]
        place[here, n + 1] = (draw > rows[place[here, n]]).sum(axis=1)
    gone = place == cells
    # A drifter that left is observed once more, far away.
    seen = ~gone | (np.cumsum(gone, axis=1) == 1)
    number, time = np.nonzero(seen)
    lon = np.where(gone, 50.0, 170 + place)[seen] + random.uniform(0.1, 0.9, seen.sum())
    lat = random.uniform(0.1, 0.9, seen.sum())
    lon = np.where(lon >= 180, lon - 360, lon)
    return drift.Trajectories(lon, lat, 3600.0 * time, number)


@pytest.fixture(scope="module")
def known():
    """A chain of 20 cells in two halves that leak, and moves of 1500 drifters of it."""
    random = np.random.default_rng(8)
    matrix = np.zeros((20, 20))
    for cell in range(20):
        half = cell // 10 * 10
        to = half + (cell - half + random.permutation(10)[:4]) % 10
        matrix[cell, to] = 0.96 * random.dirichlet(np.ones(4))
        matrix[cell, (cell + 10) % 20] = 0.02
    seen = walks(random, matrix, 1500, 12)
    water = drift.boxes(seen, 1.0, (170, 0, 190, 1))
    return matrix, drift.count_moves(seen, water, 3600.0)


def test_the_chain_of_trajectories_is_estimated_within_its_errors(known):
    matrix, moves = known
    found = drift.bootstrap(moves, lambda chain: chain.to_scipy().toarray(), samples=200)
    np.testing.assert_allclose(found.value, moves.chain.to_scipy().toarray())
    often = matrix > 0.01
    off = np.abs(found.value - matrix)[often] / found.error[often]
    # As of a normal law: two thirds are within one error, and few beyond three.
    assert 0.55 < np.mean(off < 1) < 0.8
    assert np.mean(off < 3) > 0.98
    assert not moves.chain.to_scipy().toarray()[matrix == 0].any()
    # Moves are as good as independent here.
    share = matrix * (1 - matrix) / moves.count[:, None]
    ratio = (found.error / np.sqrt(np.maximum(share, 1e-12)))[matrix > 0.1]
    assert 0.85 < np.median(ratio) < 1.15


@given(st.integers(0, 2**32 - 1))
def test_moves_are_those_of_every_pair_of_observations(seed):
    random = np.random.default_rng(seed)
    number = random.integers(0, 3, 12)
    days = random.choice(np.array([0.0, 1.0, 1.5, 2.0, 3.0]), 12)
    lon, lat = random.uniform(-182, -178, 12), random.uniform(0, 2, 12)
    seen = drift.Trajectories.of(lon, lat, 86400 * days, number)
    water = drift.boxes(seen, 1.0)
    pairs = [
        (i, j)
        for i in range(seen.lon.size)
        for j in range(seen.lon.size)
        if seen.drifter[i] == seen.drifter[j] and seen.time[j] - seen.time[i] == 86400
    ]
    if not pairs:
        return
    moves = drift.count_moves(seen, water, 86400.0)
    box = np.stack([np.floor(seen.lon) % 360, np.floor(seen.lat)], axis=1)
    cells = moves.water
    square = np.stack([(cells.lon - 0.5) % 360, cells.lat - 0.5], axis=-1)[cells.row, cells.column]
    began = {tuple(box[i]) for i, _ in pairs}
    assert {tuple(one) for one in square.round(6)} == began
    ends = [tuple(box[j]) if tuple(box[j]) in began else None for _, j in pairs]
    named = [*map(tuple, square.round(6)), None]
    assert sorted((named.index(tuple(box[i])), named.index(end)) for (i, _), end in
                  zip(pairs, ends, strict=True)) == sorted(
        (b, e if e >= 0 else len(named) - 1) for b, e in zip(moves.begin, moves.end, strict=True)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s, w: drift.boxes(s, 0), "cell: expected more than 0 and at most 90 degrees"),
        (lambda s, w: drift.boxes(s, 1.0, (0, 10, 5, 5)), "bounds: expected West, South, East and"),
        (lambda s, w: drift.count_moves(s, w, 0), "lag: expected a positive number of seconds"),
        (lambda s, w: drift.count_moves(s, w, 3600.0, least=0), "least: expected 1 or more, got 0"),
        (lambda s, w: dataclasses.replace(s, time=0 * s.time), "number 1 does not"),
        (lambda s, w: drift.bootstrap(drift.count_moves(s, w, 6 * 3600.0), len, samples=1),
         "samples: expected 2 or more, got 1"),
    ],
)  # fmt: skip
def test_cells_lags_and_samples_out_of_range_are_refused(call, message):
    seen = drift.open_trajectories(parcels())
    with pytest.raises(ValueError, match=message):
        call(seen, drift.boxes(seen, 1.0))


@pytest.mark.parametrize("every", [3, 6, 12])
def test_a_track_has_no_move_longer_than_itself(every):
    """A lag of five days, of which an observation every few hours is less than a twentieth."""
    hours, steps = np.arange(0, 20 * 24 + 1, every), 5 * 24 // every
    lon = 0.5 + np.random.default_rng(0).integers(0, 4, (3, hours.size))
    number, time = np.repeat(np.arange(3), hours.size), np.tile(3600.0 * hours, 3)
    seen = drift.Trajectories(lon.ravel(), np.full(lon.size, 0.5), time, number)
    moves = drift.count_moves(seen, drift.boxes(seen, 1.0), 5 * 86400.0)
    expected = [
        (before, after)
        for row in lon - 0.5
        for before, after in zip(row[:-steps].astype(int), row[steps:].astype(int), strict=True)
    ]
    assert list(zip(moves.begin.tolist(), moves.end.tolist(), strict=True)) == expected


@pytest.mark.parametrize("suffix", ["nc", "parquet"])
def test_written_trajectories_are_read_again(suffix, tmp_path):
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
    seen = drift.open_trajectories(parcels())
    drift.save_trajectories(seen, tmp_path / f"seen.{suffix}")
    again = drift.open_trajectories(tmp_path / f"seen.{suffix}")
    for name in ("lon", "lat", "time", "drifter"):
        np.testing.assert_allclose(getattr(again, name), getattr(seen, name), rtol=1e-12)
    assert again.since == seen.since


def test_written_trajectories_have_the_convention_of_trajan():
    """The rules by which TrajAn 0.10 finds a contiguous ragged array."""
    dataset = drift.open_trajectories(parcels()).dataset()
    role = [name for name, v in dataset.variables.items() if "cf_role" in v.attrs]
    assert role == ["trajectory"]
    assert dataset["trajectory"].dims == ("trajectory",)
    assert dataset["lon"].dims == ("index",)
    assert "time" in dataset.coords
    assert dataset["time"].attrs["standard_name"] == "time"
    rows = [name for name in dataset.data_vars if dataset[name].dims == ("trajectory",)]
    assert rows == ["rowsize"]
    assert int(dataset["rowsize"].sum()) == dataset.sizes["index"]


def test_tables_of_parcels_are_read(tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    pa = pytest.importorskip("pyarrow")
    # In the order of time, with more columns, as Parcels 4 writes them.
    seen = drift.open_trajectories(parcels())
    order = np.argsort(seen.time, kind="stable")
    units = {"units": SINCE, "calendar": "standard"}
    fields = [
        *(pa.field(name, pa.float32()) for name in "xyz"),
        pa.field("t", pa.float64(), metadata=units),
        pa.field("particle_id", pa.int64()),
    ]
    columns = [seen.lon, seen.lat, 0 * seen.lat, seen.time / 3600, 100 - seen.drifter]
    arrays = [pa.array(c[order], f.type) for c, f in zip(columns, fields, strict=True)]
    path = tmp_path / "particles.parquet"
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path)
    again = drift.open_trajectories(path)
    assert again.drifters == 3
    assert again.since == "2020-01-01"
    first = again.drifter == 2
    np.testing.assert_allclose(again.lon[first], LON[0], atol=1e-4)
    np.testing.assert_array_equal(again.time[first], 3600.0 * np.array(HOURS[0]))


def test_bad_tables_and_names_are_refused(tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "particles.parquet"
    path.write_bytes(b"no table")
    with pytest.raises(ValueError, match="cannot be read as Parquet"):
        drift.open_trajectories(path)
    with pytest.raises(ValueError, match=r"ends in \.nc or \.parquet"):
        drift.save_trajectories(drift.open_trajectories(parcels()), tmp_path / "seen.csv")


def test_particles_counted_per_time_are_read(tmp_path):
    """The layout of PyGNOME: the particles of one time after those of another, with their ids."""
    data = {
        "particle_count": ("time", [2, 3, 1], {"ragged_row_count": "particles at each time"}),
        "id": ("data", np.array([7, 9, 7, 8, 9, 9], np.uint32)),
        "longitude": ("data", [1.0, 2.0, 1.1, 3.0, 2.1, 2.2]),
        "latitude": ("data", [40.0, 41.0, 40.0, 42.0, 41.0, 41.0]),
    }
    time = ("time", [0.0, 3600.0, 7200.0], {"units": "seconds since 2024-03-07T15:00:00"})
    file = xr.Dataset(data, {"time": time})
    seen = drift.open_trajectories(file)
    assert seen.drifter.tolist() == [0, 0, 1, 2, 2, 2]
    np.testing.assert_allclose(seen.lon, [1.0, 1.1, 3.0, 2.0, 2.1, 2.2])
    assert seen.time.tolist() == [0, 3600, 3600, 0, 3600, 7200]
    file["particle_count"] = file["particle_count"].copy(data=[2, 3, 2])
    with pytest.raises(ValueError, match="particle_count: expected 6 observations, got 7"):
        drift.open_trajectories(file)


def test_the_largest_speed_can_be_chosen():
    """A degree of longitude in an hour on the equator is 31 m/s."""
    lon, time = np.array([4.0, 4.01, 4.02, 5.02, 4.04]), 3600.0 * np.arange(5)
    columns = lon, 0 * lon, time, np.zeros(5, int)
    with pytest.warns(Doubt, match=r"1 of 5 observations .* than 10 m/s.*, set `max_speed`"):
        assert drift.Trajectories.of(*columns).lon.size == 4
    assert drift.Trajectories.of(*columns, max_speed=32).lon.size == 5


def test_places_that_are_none_and_times_that_go_back_are_counted():
    lon, lat = np.array([999.0, 4.01, 4.02, 4.03, 4.04]), np.array([50.0, 50, 999, 50, 50])
    time = 3600.0 * np.array([0, 1, 2, 4, 3])
    with pytest.warns(Doubt) as doubts:
        seen = drift.Trajectories.of(lon, lat, time, np.zeros(5, int))
    assert seen.lon.tolist() == pytest.approx([4.01, 4.04, 4.03])
    places, times = (str(doubt.message) for doubt in doubts)
    assert "2 of 5 observations are left out: longitudes beyond 360" in places
    assert "1 of 5 observations are earlier than the one before of their drifter" in times
