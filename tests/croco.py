"""A file as CROCO (ROMS_AGRIF) writes it, with a current that is known."""

import netCDF4
import numpy as np


RHO, SIDES = ("eta_rho", "xi_rho"), {"u": ("eta_rho", "xi_u"), "v": ("eta_v", "xi_rho")}
METRES = 2000.0
AGRIF = {"option_0": "land", "option_1": "water", "standard_name": "land_binary_mask"}


def island(rows=7, columns=9):
    """Water around an island of 2 x 3 cells, with a coast in the South of two rows."""
    wet = np.ones((rows, columns), bool)
    wet[:2] = wet[4:6, 3:6] = False
    return wet


def stretched(levels, theta):
    """The s-coordinate and its stretching curve towards the surface."""
    s = (np.arange(1, levels + 1) - levels - 0.5) / levels
    return s, np.sinh(theta * s) / np.sinh(theta)


def write(path, wet, *, u=0.3, v=-0.2, levels=4, theta=5.0, part=slice(None), depth=40.0,
          turn_deg=0.0, angle="radians", units=None, mask=AGRIF, change=None):  # fmt: skip
    """Writes a file in which `u[level]` and `v[level]` flow along the grid through all open sides.

    Land and coasts have 0, as in the files of CROCO; `part` chooses the levels that are kept, and
    `change` may alter the open file.
    """
    turn = np.radians(turn_deg)
    j, i = np.indices(wet.shape)
    degree = np.radians(6371000)
    lat = -33 + METRES * (i * np.sin(turn) + j * np.cos(turn)) / degree
    lon = 17 + METRES * (i * np.cos(turn) - j * np.sin(turn)) / degree / np.cos(np.radians(-33))
    s, stretching = (values[part] for values in stretched(levels, theta))
    is_open = {"u": wet[:, 1:] & wet[:, :-1], "v": wet[1:] & wet[:-1]}
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_OFFSET") as file:
        sizes = {"eta_rho": wet.shape[0], "xi_rho": wet.shape[1], "xi_u": wet.shape[1] - 1,
                 "eta_v": wet.shape[0] - 1, "s_rho": len(s), "time": 1}  # fmt: skip
        for name, size in sizes.items():
            file.createDimension(name, size)

        def put(name, dims, values, **attributes):
            variable = file.createVariable(name, "f8", dims)
            variable[...] = values
            variable.setncatts(attributes)

        put("time", ("time",), 0.0, units="second")
        put("lon_rho", RHO, lon, units="degree_east")
        put("lat_rho", RHO, lat, units="degree_north")
        put("h", RHO, np.where(wet, depth, 10.0), units="meter")
        put("pm", RHO, 1 / METRES)
        put("pn", RHO, 1 / METRES)
        put("angle", RHO, turn if angle == "radians" else turn_deg)
        if units is not None:
            file["angle"].units = units
        put("mask_rho", RHO, wet, **mask)
        put("zeta", ("time", *RHO), 0.0, units="meter")
        put("sc_r", ("s_rho",), s)
        put("Cs_r", ("s_rho",), stretching)
        put("hc", (), 20.0)
        put("Vtransform", (), 2)
        for name, speed in (("u", u), ("v", v)):
            speed = np.broadcast_to(speed, levels)[part]
            flow = speed[:, None, None] * is_open[name]
            put(name, ("time", "s_rho", *SIDES[name]), flow[None], units="meter second-1")
        if change is not None:
            change(file)
    return path


def centres(wet, speed, axis):
    """The velocity of each water cell: the mean of its two sides, 0 through a coast.

    At the edge of the grid only the inner side is in the file.
    """
    found = np.full(wet.shape, np.nan)
    for j, i in np.argwhere(wet):
        flows = []
        for step in (-1, 1):
            a, b = (j + step, i) if axis == 0 else (j, i + step)
            if 0 <= a < wet.shape[0] and 0 <= b < wet.shape[1]:
                flows.append(speed if wet[a, b] else 0.0)
        found[j, i] = np.mean(flows)
    return found
