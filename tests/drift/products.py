"""Small files in the layout of real products, each with a current that is known."""

import numpy as np
import pytest
import xarray as xr

from jaxcell.drift import open_currents


RHO, FACES = ("eta_rho", "xi_rho"), {"u": ("eta_rho", "xi_u"), "v": ("eta_v", "xi_rho")}
AGRIF = {"option_0": "land", "option_1": "water", "standard_name": "land_binary_mask"}
ROWS, COLUMNS, RECORDS = 5, 6, 3
LON, LAT = 12.0 + 0.25 * np.arange(COLUMNS), 40.0 + 0.25 * np.arange(ROWS)


def write(folder, dataset, name="sea.nc", encoding=None, **options):
    """Write a dataset without fill values that it does not declare."""
    encoding = encoding or {name: {"_FillValue": None} for name in dataset.variables}
    dataset.to_netcdf(folder / name, engine="netcdf4", encoding=encoding, **options)
    return folder / name


def refused(source, message, **choice):
    """Check that reading is refused in one line, which begins with the source and has a message."""
    with pytest.raises(ValueError, match=message) as caught:
        open_currents(source, **choice)
    name = "dataset" if isinstance(source, xr.Dataset) else source
    assert str(caught.value).startswith(f"{name}: ")
    assert "\n" not in str(caught.value)


def numbers(records=RECORDS, rows=ROWS, columns=COLUMNS):
    """Two velocities that tell record, row and column, in 64ths, which floats hold exactly.

    None is 0, which could be land.
    """
    t, j, i = np.indices((records, rows, columns))
    return (t + j) / 8 - i / 64 + 1 / 4, i / 32 - (t + 2 * j) / 64


def hours(first=0, count=RECORDS, since="2020-01-01", **attributes):
    return first + np.arange(count), {"units": f"hours since {since}", **attributes}


def regular(
    u="uo", v="vo", values=None, *, lon=LON, lat=LAT, depth=None, time=None,
    dims=("time", "latitude", "longitude"),
):  # fmt: skip
    """Velocities on longitudes and latitudes, in files of Copernicus and many others.

    The names `u` and `v` alone tell what they are. The values broadcast to records, depths, rows
    and columns; by default they tell the record, row and column.
    """
    time = time or hours()
    t, y, x = dims
    coords = {t: (t, *time)}
    if depth is not None:
        coords["depth"] = "depth", depth, {"units": "m"}
    coords |= {y: (y, lat, {"units": "degrees_north"}), x: (x, lon, {"units": "degrees_east"})}
    shape = [len(value[1]) for value in coords.values()]
    values = numbers(shape[0], *shape[-2:]) if values is None else values
    fields = [np.array(np.broadcast_to(one, shape)) for one in values]
    return xr.Dataset({u: ([*coords], fields[0]), v: ([*coords], fields[1])}, coords)


def positions(j, i, side, turn_deg, lon, lat):
    """Longitudes and latitudes of rows and columns of `side` metres on a grid that is turned."""
    turn, degrees = np.radians(turn_deg), side / np.radians(6371000)
    north, east = i * np.sin(turn) + j * np.cos(turn), i * np.cos(turn) - j * np.sin(turn)
    return lon + degrees * east / np.cos(np.radians(lat)), lat + degrees * north


def open_faces(wet):
    """The faces between two cells of water, along x and y."""
    return {"u": wet[..., 1:] & wet[..., :-1], "v": wet[..., 1:, :] & wet[..., :-1, :]}


def to_centres(flow, axis):
    """The mean of both faces of each cell along an axis; cells at an edge have one face."""
    faces = np.arange(flow.shape[axis])
    around = [faces[max(k - 1, 0) : k + 1] for k in range(faces.size + 1)]
    return np.stack([flow.take(both, axis).mean(axis) for both in around], axis)


def island(rows=7, columns=9):
    """Water around an island of 2 x 3 cells, with a coast in the South of two rows."""
    wet = np.ones((rows, columns), bool)
    wet[:2] = wet[4:6, 3:6] = False
    return wet


def stretched(levels, theta):
    """The s-coordinate and its stretching curve towards the surface."""
    s = (np.arange(1, levels + 1) - levels - 0.5) / levels
    return s, np.sinh(theta * s) / np.sinh(theta)


def croco(wet, *, u=0.3, v=-0.2, levels=4, theta=5.0, part=slice(None), depth=40.0, turn_deg=0.0,
          mask=AGRIF):  # fmt: skip
    """A file of CROCO in which `u[level]` and `v[level]` flow along the grid through open faces.

    Land and coasts have 0; `part` chooses the levels that are kept.
    """
    lon, lat = positions(*np.indices(wet.shape), 2000, turn_deg, 17, -33)
    s, stretching = (values[part] for values in stretched(levels, theta))
    side = np.full(wet.shape, 1 / 2000)
    dataset = xr.Dataset(
        {
            "lon_rho": (RHO, lon, {"units": "degree_east"}),
            "lat_rho": (RHO, lat, {"units": "degree_north"}),
            "h": (RHO, np.where(wet, depth, 10.0), {"units": "meter"}),
            "pm": (RHO, side), "pn": (RHO, side), "angle": (RHO, 0 * lon + np.radians(turn_deg)),
            "mask_rho": (RHO, 1.0 * wet, mask),
            "zeta": (("time", *RHO), 0 * lon[None], {"units": "meter"}),
            "sc_r": ("s_rho", s), "Cs_r": ("s_rho", stretching), "hc": 20.0, "Vtransform": 2.0,
            "time": ("time", [0.0], {"units": "second"}),
        }
    )  # fmt: skip
    for (name, is_open), speed in zip(open_faces(wet).items(), (u, v), strict=True):
        flow = np.broadcast_to(speed, levels)[part][None, :, None, None] * is_open
        dataset[name] = ("time", "s_rho", *FACES[name]), flow, {"units": "meter second-1"}
    return dataset


def oscar_old():
    """A third of a degree, from 20 to 420 degrees East and from the North, at 15 m."""
    lon, lat = np.arange(20, 420.1, 20.0), 80.0 - 20 * np.arange(9)
    i = np.arange(lon.size) % 18  # beyond 380 degrees the first come again
    u = np.broadcast_to((i + 1) / 32 + np.arange(9)[:, None] / 64, (1, 1, 9, lon.size))
    dims = ("time", "depth", "latitude", "longitude")
    about = {"units": "meter/sec", "long_name": "Ocean Surface Zonal Currents"}
    return xr.Dataset(
        {name: (dims, values, about) for name, values in
         {"u": u, "v": -u, "um": 2 * u, "vm": 2 * u}.items()},
        {
            "time": ("time", [10000], {"units": "day since 1992-10-05 00:00:00"}),
            "year": ("time", [2020.0], {"units": "time in years"}),
            "depth": ("depth", [15.0], {"units": "meter"}),
            "latitude": ("latitude", lat, {"units": "degrees-north"}),
            "longitude": ("longitude", lon, {"units": "degrees-east"}),
        },
    )  # fmt: skip


def oscar_new(geostrophic_only=False):
    """Version 2: longitude before latitude, positions of other names, the Julian calendar."""
    lon, lat = np.arange(0, 360, 45.0), -60.0 + 30 * np.arange(5)
    u, v = (values.transpose(0, 2, 1) for values in numbers(1, 5, 8))
    dims = ("time", "longitude", "latitude")
    names = {"ug": u, "vg": v} if geostrophic_only else {"u": u, "v": v, "ug": 0 * u, "vg": 0 * v}
    days = {"units": "days since 1990-01-01", "calendar": "julian"}
    return xr.Dataset(
        {name: (dims, values, {"units": "m s-1"}) for name, values in names.items()},
        {
            "time": ("time", [10957.0], days),
            "lon": ("longitude", lon, {"units": "degrees_east", "standard_name": "longitude"}),
            "lat": ("latitude", lat, {"units": "degrees_north", "standard_name": "latitude"}),
        },
    )


def rtofs():
    """Positions on rows and columns, longitudes up to 434, and two variables of time."""
    lon, lat = np.meshgrid(74.16 + 60.0 * np.arange(7) / 7, LAT)
    u, v = numbers(1, ROWS, 7)
    dims, meaning = ("MT", "Y", "X"), "sea_water_velocity"
    about = {"units": "m/s", "coordinates": "Longitude Latitude Date"}
    return xr.Dataset(
        {
            "Date": ("MT", [20240101.0], {"units": "day as %Y%m%d.%f"}),
            "Latitude": (("Y", "X"), lat, {"standard_name": "latitude", "units": "degrees_north"}),
            "Longitude": (
                ("Y", "X"), lon + 360, {"standard_name": "longitude", "units": "degrees_east"}
            ),
            "u_velocity": (dims, u, about | {"standard_name": f"eastward_{meaning}"}),
            "v_velocity": (dims, v, about | {"standard_name": f"northward_{meaning}"}),
        },
        {
            "MT": ("MT", [44926.0], {"units": "days since 1900-12-31 00:00:00"}),
            "Y": ("Y", np.arange(1, ROWS + 1)),
            "X": ("X", np.arange(1, 8)),
        },
    )  # fmt: skip


def radar(flags=True, records=10):
    """A month of HF radar: at a few places no measurement, or a bad one."""
    dataset = regular("UCUR", "VCUR", dims=("TIME", "LATITUDE", "LONGITUDE"),
                      time=hours(count=records))  # fmt: skip
    flag = np.ones((records, ROWS, COLUMNS), "i1")
    flag[:3, 0, 0] = 4  # bad at 3 of 10
    flag[4, 1, 1] = 3
    dataset.UCUR[4, 1, 1] = 5.0
    dataset.UCUR[[0, 7], 2, 2] = np.nan
    dataset.VCUR[:3, 3, 3] = np.nan
    if flags:
        about = {
            "standard_name": "eastward_sea_water_velocity status_flag",
            "flag_values": np.arange(6, dtype="i1"),
            "flag_meanings": "no_qc_performed good_data probably_good_data "
            "bad_data_that_are_potentially_correctable bad_data value_changed",
        }
        for name in ("UCUR", "VCUR"):
            dataset[f"{name}_quality_control"] = dataset.UCUR.dims, flag, about
    return dataset


def nemo_mesh(rows=ROWS, columns=COLUMNS, levels=2, turn_deg=30.0, land=((0, 0), (3, 4))):
    """The file mesh_mask.nc of a grid of 10 km, turned against the North; land is dry."""
    points = {"t": (0, 0), "u": (0, 0.5), "v": (0.5, 0), "f": (0.5, 0.5)}
    j, i = np.indices((rows, columns))
    dims, dataset = ("t", "y", "x"), xr.Dataset()
    wet = np.ones((levels, rows, columns), bool)
    for cell in land:
        wet[(slice(None), *cell)] = False
    wet[-1, :, -1] = False  # a shelf
    beside = {"t": wet, "u": np.zeros_like(wet), "v": np.zeros_like(wet)}
    beside["u"][..., :-1], beside["v"][:, :-1] = open_faces(wet).values()
    for point, (north, east) in points.items():
        lon, lat = positions(j + north, i + east, 10_000, turn_deg, 5, 40)
        dataset[f"glam{point}"], dataset[f"gphi{point}"] = (dims, lon[None]), (dims, lat[None])
        dataset[f"e1{point}"] = dataset[f"e2{point}"] = dims, np.full((1, rows, columns), 1e4)
        if point in beside:
            mask = beside[point].astype("i1")
            dataset[f"{point}mask"] = ("t", "z", "y", "x"), mask[None]
            dataset[f"{point}maskutil"] = dims, mask[None, 0]
    dataset["nav_lon"], dataset["nav_lat"] = dataset.glamt[0], dataset.gphit[0]
    dataset["nav_lev"] = "z", 5.0 + 10 * np.arange(levels)
    return dataset


def nemo(mesh, point, name, values, *, surface=False, first=0):
    """The file of one velocity on its points, as XIOS writes it; land has 0."""
    depth = f"depth{point}"
    mask = mesh[f"{point}mask"].values[0]
    values = np.where(mask, np.broadcast_to(values, (RECORDS, *mask.shape)), 0.0)
    dims = ("time_counter", depth, "y", "x")
    times = first + 3600 * np.arange(RECORDS)
    dataset = xr.Dataset(
        {name: (dims, values, {"units": "m/s"})},
        {
            "time_counter": ("time_counter", times, {"units": "seconds since 2010-01-01"}),
            depth: (depth, mesh.nav_lev.values, {"units": "m", "positive": "down"}),
        },
    )
    for which, there in (("nav_lon", "glam"), ("nav_lat", "gphi")):
        dataset[which] = ("y", "x"), mesh[f"{there}{point}"].values[0]
    return dataset.isel({depth: 0}, drop=True) if surface else dataset


def tripolar(pivot, rows=6, columns=12):
    """A grid whose last rows repeat others, on a plane at the North Pole.

    It goes East on one side of a line and back on the other. Beyond the line there is nothing new;
    it is at centres if `pivot` is "T", and between them if it is "F".
    """
    j, i = np.indices((rows, columns))
    quarter = columns / 4
    if pivot == "F":
        before, away = i < columns / 2, rows - 1.5 - j
        along = np.where(before, i, columns - 1 - i) + 0.5 - quarter
        across = np.where(before, -away, away)
    else:  # the columns at both ends of the line are on its continuation
        before, away = i <= columns / 2, rows - 2 - j
        ends = np.select([i == 0, i == columns / 2], [-1, 1])
        along = np.where(before, i, columns - i) - quarter + ends * np.abs(away)
        across = np.where(ends != 0, 0, np.where(before, -away, away))
    along = along + 0.3  # no centre is at the pole
    lon, lat = np.degrees(np.arctan2(across, along)), 90 - np.hypot(along, across)
    u, v = numbers(1, rows, columns)
    dims, meaning = ("time", "Y", "X"), "sea_water_velocity"
    return xr.Dataset(
        {
            "u": (dims, u, {"standard_name": f"eastward_{meaning}"}),
            "v": (dims, v, {"standard_name": f"northward_{meaning}"}),
            "lon": (("Y", "X"), lon),
            "lat": (("Y", "X"), lat),
        },
        {"time": ("time", *hours(count=1))},
    )


def fvcom():
    """Triangles: u and v at their centres."""
    dims = ("time", "siglay", "nele")
    return xr.Dataset(
        {
            "u": (dims, np.zeros((1, 2, 4)), {"standard_name": "eastward_sea_water_velocity"}),
            "v": (dims, np.zeros((1, 2, 4)), {"standard_name": "northward_sea_water_velocity"}),
            "lonc": ("nele", np.arange(4.0), {"units": "degrees_east"}),
            "latc": ("nele", np.arange(4.0), {"units": "degrees_north"}),
            "nv": (("three", "nele"), np.zeros((3, 4), int)),
        },
        {"time": ("time", [0.0], {"units": "days since 1858-11-17"})},
    )


def schism():
    """Triangles and quadrangles: a mesh, and a horizontal velocity of two components."""
    dims = ("time", "nSCHISM_hgrid_node", "nSCHISM_vgrid_layers", "two")
    return xr.Dataset(
        {
            "SCHISM_hgrid": ((), 0, {"cf_role": "mesh_topology", "topology_dimension": 2}),
            "SCHISM_hgrid_node_x": (dims[1], np.arange(4.0), {"units": "degrees_east"}),
            "SCHISM_hgrid_node_y": (dims[1], np.arange(4.0), {"units": "degrees_north"}),
            "hvel": (dims, np.zeros((1, 4, 2, 2))),
        },
        {"time": ("time", [0.0], {"units": "seconds since 2020-01-01"})},
    )
