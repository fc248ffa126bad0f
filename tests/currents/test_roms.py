import itertools

import netCDF4
import numpy as np
import pytest
import xarray as xr
from drift import products
from drift.products import RHO, refused, write
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from jaxcell.currents.models.roms import SLevels, at_height, to_centres
from jaxcell.currents.netcdf import OceanFile
from jaxcell.drift import open_currents


ROWS, COLUMNS, LEVELS, RECORDS = 6, 8, 5, 2
S = (np.arange(LEVELS) - LEVELS + 0.5) / LEVELS
STRETCHING = np.sinh(3 * S) / np.sinh(3)
CRITICAL_DEPTH = 4.0
SEA_BED = 12.0 + 3.0 * np.arange(COLUMNS) + 2.0 * np.arange(ROWS)[:, None]
ZETA = np.stack([0.3 * np.ones((ROWS, COLUMNS)), -0.2 + 0.05 * np.indices((ROWS, COLUMNS))[0]])
DRY = np.zeros((ROWS, COLUMNS), bool)
DRY[0, :3] = DRY[3, 4] = True


def height(transform, k, j, i, t):
    """The height of a level, written from the formulas of CF for one cell at a time."""
    s, c, h, zeta = S[k], STRETCHING[k], SEA_BED[j, i], ZETA[t, j, i]
    if transform == 1:  # ocean_s_coordinate_g1
        still = CRITICAL_DEPTH * s + (h - CRITICAL_DEPTH) * c
        return still + zeta * (1 + still / h)
    share = (CRITICAL_DEPTH * s + h * c) / (CRITICAL_DEPTH + h)  # ocean_s_coordinate_g2
    return zeta + (zeta + h) * share


def heights(transform):
    z = np.zeros((RECORDS, LEVELS, ROWS, COLUMNS))
    for place in itertools.product(*map(range, z.shape)):
        t, k, j, i = place
        z[place] = height(transform, k, j, i, t)
    return z


def native(x, y, turn_deg=0.0, transform=2, dry=DRY):
    """A file of ROMS with the given velocities along the grid at the centres of the cells.

    They must not differ along the axis on which their component is staggered, so that the mean of
    two sides gives them back. On land there is garbage.
    """
    shape = (RECORDS, LEVELS, ROWS, COLUMNS)
    x, y = (np.broadcast_to(a, shape).copy() for a in (x, y))
    lon, lat = products.positions(*np.indices((ROWS, COLUMNS)), 4000, turn_deg, -124, 43.5)
    wet, moving = ~dry, ("ocean_time", "s_rho")
    mask_u, mask_v = products.open_faces(wet).values()
    cells = {
        "lon_rho": lon, "lat_rho": lat, "h": SEA_BED, "mask_rho": 1.0 * wet,
        "angle": np.full(lon.shape, np.radians(turn_deg)),
        "pm": np.full(lon.shape, 1 / 4000), "pn": np.full(lon.shape, 1 / 4100),
    }  # fmt: skip
    return xr.Dataset(
        {
            **{name: (RHO, values) for name, values in cells.items()},
            "mask_u": (("eta_u", "xi_u"), 1.0 * mask_u),
            "mask_v": (("eta_v", "xi_v"), 1.0 * mask_v),
            "u": ((*moving, "eta_u", "xi_u"), np.where(mask_u, x[..., 1:], 0.77)),
            "v": ((*moving, "eta_v", "xi_v"), np.where(mask_v, y[..., 1:, :], -0.55)),
            "zeta": (("ocean_time", *RHO), np.where(wet, ZETA, 9.0)),
            "Cs_r": ("s_rho", STRETCHING),
            "hc": CRITICAL_DEPTH,
            "Vtransform": transform,
        },
        coords={
            "s_rho": S,
            "ocean_time": ("ocean_time", [0, 3600], {"units": "seconds since 2024-10-17"}),
        },
    )


def away_from_land():
    """Water cells none of whose sides is a coast."""
    wet = np.pad(~DRY, 1, constant_values=True)
    return wet[1:-1, 1:-1] & wet[2:, 1:-1] & wet[:-2, 1:-1] & wet[1:-1, 2:] & wet[1:-1, :-2]


@pytest.mark.parametrize("turn_deg", [0, 16.4, 44, -100])
def test_a_current_to_the_east_comes_out_east(tmp_path, turn_deg):
    turn = np.radians(turn_deg)
    path = write(tmp_path, native(0.3 * np.cos(turn), -0.3 * np.sin(turn), turn_deg))
    currents = open_currents(path)
    np.testing.assert_array_equal(currents.water[0], ~DRY)
    open_sea = away_from_land()
    assert open_sea.sum() > 30
    np.testing.assert_allclose(currents.u.values[:, 0, open_sea], 0.3, atol=1e-12)
    np.testing.assert_allclose(currents.v.values[:, 0, open_sea], 0, atol=1e-12)
    np.testing.assert_allclose(currents.dx, 4000)
    np.testing.assert_allclose(currents.dy, 4100)
    assert np.isnan(currents.u.values[:, 0, DRY]).all()
    assert "by their dimensions (eta_u, xi_u)" in currents.attrs["east_from"]
    assert "turned to East and North by the variable angle" in currents.attrs["notes"]


def test_nothing_flows_through_a_coast(tmp_path):
    """Values on the sides of land cells have no effect, with and without masks."""
    masked = open_currents(write(tmp_path, native(0.4, 0.2)))
    beside = float(masked.u[0, 0, 3, 3]), float(masked.v[0, 0, 2, 4])
    assert beside == (pytest.approx(0.2), pytest.approx(0.1))
    derived = open_currents(write(tmp_path, native(0.4, 0.2).drop_vars(["mask_u", "mask_v"])))
    xr.testing.assert_equal(derived, masked)
    fills = native(0.4, 0.2)
    for name in ("u", "v"):
        fills[name] = fills[name].where(fills[f"mask_{name}"] == 1).fillna(1e37)
    fills = fills.drop_vars(["mask_u", "mask_v", "mask_rho"])
    dropped = open_currents(write(tmp_path, fills))
    np.testing.assert_array_equal(dropped.u, masked.u)


@given(st.data())
def test_centres_have_the_mean_of_two_sides(data):
    levels, rows, sides = (data.draw(st.integers(1, 4)) for _ in range(3))
    shape = (levels, rows, sides)
    number = st.floats(-5, 5) | st.just(np.nan)
    flow = data.draw(arrays(float, shape, elements=number))
    is_open = data.draw(arrays(bool, shape))
    along = to_centres(flow, is_open, -1)
    across = to_centres(np.swapaxes(flow, 1, 2), np.swapaxes(is_open, 1, 2), -2)
    np.testing.assert_array_equal(along, np.swapaxes(across, 1, 2))
    expected = products.to_centres(np.where(is_open, flow, 0), 2)
    np.testing.assert_allclose(along, expected, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("transform", [1, 2])
def test_heights_of_levels_are_those_of_cf(transform):
    levels = SLevels(S, STRETCHING, CRITICAL_DEPTH, transform, np.arange(LEVELS))
    for t in range(RECORDS):
        np.testing.assert_allclose(levels.heights(SEA_BED, ZETA[t]), heights(transform)[t])
    ends = SLevels(np.array([-1.0, 0]), np.array([-1.0, 0]), 4.0, transform, np.arange(2))
    bed, surface = ends.heights(SEA_BED, ZETA[1])
    np.testing.assert_allclose(bed, -SEA_BED)
    np.testing.assert_allclose(surface, ZETA[1])


@given(st.data())
def test_values_are_linear_between_levels(data):
    levels = data.draw(st.integers(1, 5))
    number = st.floats(-50, 50)
    values = data.draw(arrays(float, (levels, 2, 3), elements=number))
    steps = data.draw(arrays(float, (levels, 2, 3), elements=st.floats(0.1, 20)))
    z = np.cumsum(steps, axis=0) - 40
    wanted = data.draw(arrays(float, (2, 3), elements=st.floats(-60, 60)))
    found = at_height(values, z, wanted)
    for j, i in np.ndindex(2, 3):
        expected = np.interp(wanted[j, i], z[:, j, i], values[:, j, i])
        np.testing.assert_allclose(found[j, i], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("top_first", [False, True])
def test_depths_are_interpolated_below_the_surface(tmp_path, transform, top_first):
    """A velocity on the levels of flat water, interpolated by hand."""
    x = 0.1 * np.arange(1, LEVELS + 1)[:, None, None]
    dataset = native(x, 0.0, transform=transform)
    if top_first:
        dataset = dataset.isel(s_rho=slice(None, None, -1))
    depths = [0.0, 2.5, 10.0, 20.0]
    currents = open_currents(write(tmp_path, dataset), depths=depths)
    np.testing.assert_array_equal(currents.depth, depths)
    z = heights(transform)
    for t, k in itertools.product(range(RECORDS), range(4)):
        for j, i in np.argwhere(away_from_land()):
            expected = np.nan
            if (depths[k] <= SEA_BED[j, i] + ZETA[:, j, i]).all():
                wanted = ZETA[t, j, i] - depths[k]
                expected = np.interp(wanted, z[t, :, j, i], 0.1 * np.arange(1, LEVELS + 1))
            np.testing.assert_allclose(currents.u[t, k, j, i], expected, atol=1e-9)
    deep_enough = (SEA_BED + ZETA.min(axis=0) >= 20) & ~DRY
    assert 0 < deep_enough.sum() < (~DRY).sum()
    np.testing.assert_array_equal(currents.water[3], deep_enough)
    assert f"Vtransform {transform}" in currents.attrs["notes"]
    surface = open_currents(write(tmp_path, dataset))
    xr.testing.assert_equal(surface, currents.isel(layer=[0]))


def croco(dataset):
    """The same file as CROCO writes it: other dimensions, names, and a time without a date."""
    dataset = dataset.rename(Cs_r="Cs_rho", ocean_time="time").drop_vars(["Vtransform", "s_rho"])
    for name in ("u", "mask_u"):
        dataset[name] = dataset[name].rename(eta_u="eta_rho")
    for name in ("v", "mask_v"):
        dataset[name] = dataset[name].rename(xi_v="xi_rho")
    dataset["sc_r"] = ("s_rho", S)
    dataset["time"] = ("time", [0.0, 3600], {"units": "second"})
    dataset.attrs["VertCoordType"] = "NEW"
    return dataset


def xios(dataset):
    """The same file as XIOS writes it for CROCO."""
    dataset = dataset.rename(
        eta_rho="y_rho", xi_rho="x_rho", xi_u="x_u", eta_v="y_v", lon_rho="nav_lon_rho",
        lat_rho="nav_lat_rho", ocean_time="time_counter",
    )  # fmt: skip
    for name in ("u", "mask_u"):
        dataset[name] = dataset[name].rename(eta_u="y_rho")
    for name in ("v", "mask_v"):
        dataset[name] = dataset[name].rename(xi_v="x_rho")
    return dataset


def equally_long(dataset):
    """The same file cut with one range of indices on all points, with garbage in the surplus."""
    return dataset.pad(xi_u=(0, 1), eta_v=(0, 1), mode="constant", constant_values=7.0)


def as_attributes(dataset):
    dataset = dataset.drop_vars(["Cs_r", "hc", "Vtransform", "s_rho"])
    return dataset.assign_attrs(Cs_r=STRETCHING, sc_r=S, hc=CRITICAL_DEPTH, Vtransform=2)


def by_standard_name(dataset):
    dataset = dataset.drop_vars("Vtransform")
    dataset.s_rho.attrs["standard_name"] = "ocean_s_coordinate_g2"
    return dataset


@pytest.mark.parametrize("change", [croco, xios, equally_long, as_attributes, by_standard_name])
def test_other_layouts_of_one_current_are_read_alike(tmp_path, change):
    # Each component differs across its own axis only, and from level to level.
    level = np.arange(LEVELS)[:, None, None]
    x = 0.1 + 0.02 * np.arange(ROWS)[:, None] + 0.01 * level
    y = -0.2 + 0.03 * np.arange(COLUMNS) + 0.01 * level
    plain = open_currents(write(tmp_path, native(x, y, 30), "plain.nc"), depths=(0, 5))
    other = open_currents(write(tmp_path, change(native(x, y, 30))), depths=(0, 5))
    for name in plain.data_vars:
        np.testing.assert_allclose(other[name], plain[name], err_msg=name)


def test_zeta_and_angle_may_be_missing(tmp_path):
    dataset = native(0.3, 0.1, 30)
    whole = open_currents(write(tmp_path, dataset))
    flat = open_currents(write(tmp_path, dataset.drop_vars("zeta")))
    np.testing.assert_allclose(flat.u, whole.u)
    assert "the surface is taken as flat" in flat.attrs["notes"]
    computed = open_currents(write(tmp_path, dataset.drop_vars(["angle", "pm"])))
    np.testing.assert_allclose(computed.u, whole.u, atol=1e-3)
    np.testing.assert_allclose(computed.dy, 4000, rtol=2e-3)
    assert "computed from lon_rho and lat_rho" in computed.attrs["notes"]
    degrees = dataset.assign(angle=np.degrees(dataset.angle).assign_attrs(units="degrees"))
    np.testing.assert_allclose(open_currents(write(tmp_path, degrees)).u, whole.u)


def test_velocities_to_the_east_are_not_turned(tmp_path):
    dataset = native(0.3, 0.1, 30)
    rho = ("ocean_time", "s_rho", "eta_rho", "xi_rho")
    for name in ("u_eastward", "v_northward"):
        dataset[name] = rho, np.full((RECORDS, LEVELS, ROWS, COLUMNS), 0.2)
    currents = open_currents(write(tmp_path, dataset))
    assert (currents.u.values[:, 0, ~DRY] == 0.2).all()
    assert "u_eastward (by their names)" in currents.attrs["east_from"]
    asked = open_currents(tmp_path / "sea.nc", variables=("u", "v"))
    assert float(asked.u[0, 0, 5, 1]) == pytest.approx(0.3 * np.cos(np.pi / 6) - 0.05)


def test_surface_files_are_read(tmp_path):
    dataset = native(0.3, 0.0).isel(s_rho=-1, drop=True).rename(u="u_sur", v="v_sur")
    currents = open_currents(write(tmp_path, dataset.drop_vars(["Cs_r", "hc", "Vtransform"])))
    np.testing.assert_allclose(currents.u.values[:, 0, away_from_land()], 0.3)


@given(st.data())
def test_a_block_is_a_part_of_the_whole(data):
    """It holds along the edges too, where the sides of cells outside count."""
    dataset, random = native(0.0, 0.0, 20), np.random.default_rng(3)
    for name in ("u", "v"):
        dataset[name] = dataset[name].dims, random.uniform(-1, 1, dataset[name].shape)
    whole = open_currents(dataset, depths=(0, 8))
    # Two cells at corners of the bounds, or one cell.
    (j, b), (i, a) = (data.draw(st.tuples(*2 * [st.integers(0, n - 1)])) for n in (ROWS, COLUMNS))
    lon, lat = (values.values for values in (whole.lon, whole.lat))
    corners = np.array([(lon[j, i], lat[j, i]), (lon[b, a], lat[b, a])])
    (west, south), (east, north) = corners.min(axis=0) - 1e-3, corners.max(axis=0) + 1e-3
    inside = (lon >= west) & (lon <= east) & (lat >= south) & (lat <= north)
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    part = whole.isel(y=slice(rows[0], rows[-1] + 1), x=slice(columns[0], columns[-1] + 1))
    if not part.water.any(("y", "x")).all():
        return
    currents = open_currents(dataset, depths=(0, 8), bounds=(west, south, east, north))
    for name in whole.variables:
        np.testing.assert_array_equal(currents[name], part[name], err_msg=name)


@pytest.mark.parametrize(
    ("change", "choice", "message"),
    [
        (lambda d: d.drop_vars("Vtransform"), {}, r"Vtransform: missing, and s_rho does not say"),
        (lambda d: d.assign(Vtransform=3), {}, r"Vtransform: expected 1 or 2, got \[3"),
        (lambda d: d.drop_vars("hc"), {}, r"hc: missing"),
        (lambda d: d.assign(hc=-2.0), {}, r"hc: expected metres, 0 or more"),
        (lambda d: d.drop_vars("Cs_r"), {}, r"Cs_r: missing"),
        (lambda d: d.drop_vars("s_rho"), {}, r"s_rho: missing"),
        (lambda d: d.drop_vars("h"), {}, r"h: missing"),
        (lambda d: d.assign(zeta=d.zeta.rename(ocean_time="t")), {}, r"zeta: dimension t of len"),
        (lambda d: d.assign(Cs_r=10 * d.Cs_r), {}, r"Cs_r: expected levels in order between"),
        (lambda d: d.assign(Cs_r=("s_rho", STRETCHING[[0, 2, 1, 3, 4]])), {}, r"Cs_r: expected"),
        (lambda d: d.assign(Cs_r=("s_w", np.linspace(-1, 0, 6))), {}, r"Cs_r: expected 5 levels"),
        (lambda d: d, {"depths": [0, 500]}, r"depths: 500 m is below the sea bed everywhere: it "
         r"is 43 m at most"),
        (lambda d: d.assign(u=d.u + 30), {}, r"u: expected currents up to 10 m/s, got 30.* at "
         r"record 0, level 0, row 0, column 3"),
        (lambda d: d.isel(eta_u=slice(0, 5)), {}, r"eta_u: expected a length of 6 with 6 cells"),
        (lambda d: d.assign(pm=0 * d.pm), {}, r"lon_rho: the cell at row 0, column 3 has sides"),
        (lambda d: d.assign(angle=np.nan * d.angle), {}, r"no angle at row 0, column 3"),
        (lambda d: d.isel(eta_rho=slice(None, None, -1)), {}, r"lat_rho: .*mirror image"),
    ],
)  # fmt: skip
def test_damaged_files_and_wrong_choices_are_refused(tmp_path, change, choice, message):
    refused(write(tmp_path, change(native(0.3, 0.1))), message, **choice)


def test_packed_masks_are_read(tmp_path):
    """Packed files have 0.99999 for 1 and a little more than 0 for 0."""
    dataset = native(0.3, 0.1)
    for name in ("mask_rho", "mask_u", "mask_v"):
        dataset[name] = dataset[name] * 0.99998 + 1e-5
    np.testing.assert_array_equal(open_currents(write(tmp_path, dataset)).water[0], ~DRY)


def test_a_missing_value_in_the_sea_is_a_gap(tmp_path):
    path = write(tmp_path, native(0.3, 0.1))
    with netCDF4.Dataset(path, "a") as file:
        file["u"][1, :, 4, 5] = np.nan
    currents = open_currents(path)
    assert not currents.water.values[0, 4, 5:7].any()
    assert int((~currents.water).sum()) == DRY.sum() + 2


def test_lengths_that_do_not_fit_are_refused_before_any_values_are_read(tmp_path, monkeypatch):
    path = write(tmp_path, native(0.1, 0.2).isel(xi_u=slice(0, 5)))
    monkeypatch.delattr(OceanFile, "read")
    refused(path, "xi_u: expected a length of 7 with 8 cells")


@pytest.mark.parametrize(("transform", "bed"), [(1, 0.0), (2, -CRITICAL_DEPTH)])
def test_a_bed_for_which_the_formula_divides_by_0_is_land(tmp_path, transform, bed):
    file = native(0.1, 0.2, transform=transform, dry=np.zeros((ROWS, COLUMNS), bool))
    file["h"] = file["h"].copy()
    file["h"][2, 5] = bed
    water = open_currents(write(tmp_path, file), depths=1).water[0]
    assert not water[2, 5]
    assert water.sum() == water.size - 1
