"""What CF, ocean models, radars and products call what is in their files, as one table."""

import dataclasses
import re
from collections.abc import Iterable, Iterator
from typing import Any, Literal, TypeAlias

import xarray as xr


Role: TypeAlias = Literal[
    "velocity",
    "wind",
    "stokes",
    "time",
    "depth",
    "y",
    "x",
    "lon",
    "lat",
    "side",
    "mask",
    "bed",
    "surface",
    "flag",
]
Along: TypeAlias = Literal["earth", "grid", "dims"]


@dataclasses.dataclass(frozen=True)
class Convention:
    """Names by which one knows what a variable or a dimension is.

    **Attributes:**

    - `role`: what it is. A `"velocity"`, a `"wind"` and a drift by waves (`"stokes"`) have two
        names, the first towards the East or along x.
    - `names`: of the variable or dimension in small letters, the preferred first; in that of a
        flag, `{}` stands for the name of what it is about.
    - `standard_names`: of CF.
    - `units`: that nothing else has.
    - `along`: of a velocity: the axes of the `"earth"`; those of the `"grid"`; or, as the
        dimensions say (`"dims"`), those of the grid on the sides of cells, and of the Earth on
        longitudes and latitudes. On the sides of cells a name alone never stands for the Earth.
    - `point`: where it stands in NEMO, whose dimensions do not say it: at the centres of cells
        (`"t"`), or on their eastern (`"u"`) or northern sides (`"v"`).
    - `water`: the value of a mask where there is water.
    """

    role: Role
    names: tuple[str, ...] = ()
    standard_names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    along: Along = "dims"
    point: Literal["t", "u", "v", ""] = ""
    water: int = 1


def _row(
    role: Role, names: str = "", standard_names: str = "", units: str = "", **meaning: Any
) -> Convention:
    standard = tuple(standard_names.split())
    return Convention(role, tuple(names.split()), standard, tuple(units.split()), **meaning)


# The preferred first: standard names before names, three-dimensional fields before the surface.
CONVENTIONS: tuple[Convention, ...] = (
    _row("velocity", "", "eastward_sea_water_velocity northward_sea_water_velocity", along="earth"),
    _row("velocity", "", "surface_eastward_sea_water_velocity surface_northward_sea_water_velocity",
         along="earth"),
    _row("velocity", "", "sea_water_x_velocity sea_water_y_velocity", along="grid"),
    _row("velocity", "", "x_sea_water_velocity y_sea_water_velocity", along="grid"),
    _row("velocity", "", "sea_water_surface_x_velocity sea_water_surface_y_velocity", along="grid"),
    _row("velocity", "", "surface_geostrophic_eastward_sea_water_velocity "
         "surface_geostrophic_northward_sea_water_velocity", along="earth"),
    _row("velocity", "u_eastward v_northward", along="earth"),  # ROMS
    _row("velocity", "water_u water_v", along="earth"),  # HYCOM
    _row("velocity", "uo vo", along="earth"),  # CMEMS; NEMO by the names of CMIP
    _row("velocity", "u_sur_eastward v_sur_northward", along="earth"),  # ROMS
    _row("velocity", "utotal vtotal", along="earth"),  # CMEMS, with tides and waves
    _row("velocity", "ucur vcur", along="earth"),  # HF radar of IMOS
    _row("velocity", "ewct nsct", along="earth"),  # HF radar of EMODnet
    _row("velocity", "ugos vgos", along="earth"),  # DUACS
    _row("velocity", "u v"),  # ROMS, CROCO, OSCAR, HF radar
    _row("velocity", "u_sur v_sur"),  # ROMS
    _row("velocity", "vozocrtx vomecrty"),  # NEMO
    _row("velocity", "uos vos"),  # NEMO by the names of CMIP
    _row("velocity", "ssu ssv"),  # NEMO
    _row("velocity", "sozocrtx somecrty"),  # NEMO
    _row("velocity", "u_velocity v_velocity"),  # RTOFS
    _row("velocity", "ubar vbar"),  # ROMS
    _row("velocity", "ug vg"),  # OSCAR
    _row("wind", "", "eastward_wind northward_wind", along="earth"),
    _row("wind", "eastward_wind northward_wind", along="earth"),
    _row("wind", "uwnd vwnd", along="earth"),  # NCEP, CCMP
    _row("wind", "u10 v10", along="earth"),  # ERA5
    _row("stokes", "", "sea_surface_wave_stokes_drift_eastward_velocity "
         "sea_surface_wave_stokes_drift_northward_velocity", along="earth"),
    _row("stokes", "vsdx vsdy", along="earth"),  # CMEMS
    _row("time", "time ocean_time scrum_time time_counter obs_time mt t", "time"),
    _row("depth", "depth depthu depthv deptht z lev level s_rho sc_r z_slice", "depth"),
    _row("y", "lat latitude y nj j eta_rho eta_u eta_v y_rho y_v rlat",
         "latitude projection_y_coordinate"),
    _row("x", "lon longitude x ni i xi_rho xi_u xi_v x_rho x_u rlon",
         "longitude projection_x_coordinate"),
    _row("lon", "glamt", point="t"),
    _row("lat", "gphit", point="t"),
    _row("lon", "lon_rho nav_lon_rho lon longitude nav_lon nav_lon_grid_t", "longitude",
         "degrees_east degree_east degrees_e degree_e"),
    _row("lat", "lat_rho nav_lat_rho lat latitude nav_lat nav_lat_grid_t", "latitude",
         "degrees_north degree_north degrees_n degree_n"),
    _row("side", "e1t e2t", point="t"),
    # The standard name of CROCO may say otherwise.
    _row("mask", "mask_rho mask_u mask_v", water=1),
    _row("mask", "tmask tmaskutil", point="t", water=1),
    _row("mask", "umask umaskutil", point="u", water=1),
    _row("mask", "vmask vmaskutil", point="v", water=1),
    _row("mask", "", "sea_binary_mask", water=1),
    _row("mask", "", "land_binary_mask", water=0),
    _row("bed", "h", "sea_floor_depth_below_sea_level sea_floor_depth_below_geoid sea_floor_depth"),
    _row("surface", "zeta"),
    _row("flag", "{}_qc {}_quality_control qcflag qc_flag primary_flag"),
)  # fmt: skip

# Dimensions of the staggered points of a C-grid, and of the cell centres (rho points) between them,
# as ROMS and CROCO name them, and CROCO where XIOS writes its files.
STAGGERED = {
    "xi_u": "xi_rho",
    "eta_u": "eta_rho",
    "xi_v": "xi_rho",
    "eta_v": "eta_rho",
    "x_u": "x_rho",
    "y_v": "y_rho",
}


# NEMO may name a dimension after the points of its grid: x_grid_U, y_grid_V_inner.
POINTS = re.compile(r"_grid_([tuvwf])(_inner)?$")


def table(role: Role) -> Iterator[Convention]:
    """The conventions on one role, the preferred first."""
    return (one for one in CONVENTIONS if one.role == role)


def find(dataset: xr.Dataset, role: Role, among: Iterable[str]) -> str | None:
    """The variable with a role: by name, then by standard name, then by unit."""
    among = list(among)
    by_name = {name.lower(): name for name in reversed(among)}
    attributes = {name: dataset[name].attrs for name in among}
    for one in table(role):
        for name in one.names:
            if name in by_name:
                return by_name[name]
        for key, known in (("standard_name", one.standard_names), ("units", one.units)):
            for name in among:
                if str(attributes[name].get(key, "")).lower() in known:
                    return name
    return None
