"""A table of the names that CF, ocean models, radars and data products give to variables."""

import dataclasses
import re
from collections.abc import Iterable, Iterator
from typing import Any, Literal, TypeAlias

import xarray as xr


Role: TypeAlias = Literal[
    "velocity", "wind", "stokes", "time", "depth", "y", "x",
    "lon", "lat", "side", "mask", "bed", "surface", "flag", "speed", "direction",
]  # fmt: skip
Along: TypeAlias = Literal["earth", "grid", "dims"]


@dataclasses.dataclass(frozen=True)
class Convention:
    """Names that identify a variable or a dimension."""

    role: Role
    "A velocity, a wind and a Stokes drift have two variables: to the East or x, to the North or y."
    names: tuple[str, ...] = ()
    """Names of the variable or dimension in lower case, the preferred name first. In the name of a
    flag, `{}` stands for the name of the flagged variable."""
    standard_names: tuple[str, ...] = ()
    "CF standard names that identify the variable or dimension."
    units: tuple[str, ...] = ()
    "Units that identify the variable, because no other role has them."
    along: Along = "dims"
    """The directions of a velocity: East and North (`"earth"`), or x and y of the grid (`"grid"`).
    With `"dims"` the dimensions decide: x and y for cell faces, East and North for longitude and
    latitude. On cell faces, a velocity without a known standard name is always along x and y."""
    point: Literal["t", "u", "v", ""] = ""
    'Of NEMO: at cell centres (`"t"`), or eastern (`"u"`) or northern (`"v"`) cell faces.'
    water: int = 1
    "The value of a mask that means water."


def _row(
    role: Role, names: str = "", standard_names: str = "", units: str = "", **meaning: Any
) -> Convention:
    standard = tuple(standard_names.split())
    return Convention(role, tuple(names.split()), standard, tuple(units.split()), **meaning)


def _pairs(role: Role, along: Along, pairs: str) -> Iterator[Convention]:
    """Yield a row for each pair of components: `u/v`, or `{}ward_wind` for standard names."""
    words = ("east", "north") if along == "earth" else ("x", "y")
    for pair in pairs.split():
        if "/" in pair:
            yield Convention(role, tuple(pair.split("/")), along=along)
        else:
            yield Convention(role, (), tuple(map(pair.format, words)), along=along)


# The preferred names come first: standard names before names, all depths before the surface.
CONVENTIONS: tuple[Convention, ...] = (
    *_pairs("velocity", "earth", "{}ward_sea_water_velocity surface_{}ward_sea_water_velocity"),
    *_pairs("velocity", "grid", "sea_water_{}_velocity {}_sea_water_velocity "
            "sea_water_surface_{}_velocity"),
    *_pairs("velocity", "earth", "surface_geostrophic_{}ward_sea_water_velocity"),
    # ROMS, HYCOM, CMEMS and NEMO by CMIP, ROMS, ECCO, CMEMS with tides, IMOS, EMODnet, DUACS
    *_pairs("velocity", "earth", "u_eastward/v_northward water_u/water_v uo/vo "
            "u_sur_eastward/v_sur_northward evel/nvel utotal/vtotal ucur/vcur ewct/nsct ugos/vgos"),
    # ROMS, CROCO, OSCAR and radars; ROMS; NEMO; RTOFS; MITgcm and ECCO; ROMS; OSCAR
    *_pairs("velocity", "dims", "u/v u_sur/v_sur vozocrtx/vomecrty uos/vos ssu/ssv "
            "sozocrtx/somecrty u_velocity/v_velocity uvel/vvel ubar/vbar ug/vg"),
    # NCEP and CCMP, ERA5; CMEMS
    *_pairs("wind", "earth", "{}ward_wind eastward_wind/northward_wind uwnd/vwnd u10/v10"),
    *_pairs("stokes", "earth", "sea_surface_wave_stokes_drift_{}ward_velocity vsdx/vsdy"),
    _row("speed", "speed current_speed cspd spd", "sea_water_speed"),
    _row("direction", "direction current_direction cdir",
         "sea_water_velocity_to_direction direction_of_sea_water_velocity "
         "sea_water_velocity_from_direction", "degree degrees degrees_true"),
    _row("time", "time ocean_time scrum_time time_counter obs_time mt t", "time"),
    _row("depth", "depth depthu depthv deptht z lev level k z_t z_l zl s_rho sc_r z_slice",
         "depth"),
    _row("y", "lat latitude y nj j nlat eta_rho eta_u eta_v y_rho y_v rlat",
         "latitude projection_y_coordinate"),
    _row("x", "lon longitude x ni i nlon xi_rho xi_u xi_v x_rho x_u rlon",
         "longitude projection_x_coordinate"),
    _row("lon", "glamt", point="t"),
    _row("lat", "gphit", point="t"),
    _row("lon", "lon_rho nav_lon_rho lon longitude nav_lon nav_lon_grid_t ulong ulon geolon",
         "longitude", "degrees_east degree_east degrees_e degree_e"),
    _row("lat", "lat_rho nav_lat_rho lat latitude nav_lat nav_lat_grid_t ulat geolat",
         "latitude", "degrees_north degree_north degrees_n degree_n"),
    _row("side", "e1t e2t", point="t"),
    # The name decides, because the standard name in files of CROCO may be wrong.
    _row("mask", "mask_rho mask_u mask_v"),
    _row("mask", "tmask tmaskutil", point="t"),
    _row("mask", "umask umaskutil", point="u"),
    _row("mask", "vmask vmaskutil", point="v"),
    _row("mask", "", "sea_binary_mask"),
    _row("mask", "", "land_binary_mask", water=0),
    _row("bed", "h", "sea_floor_depth_below_sea_level sea_floor_depth_below_geoid sea_floor_depth"),
    _row("surface", "zeta"),
    _row("flag", "{}_qc {}_quality_control qcflag qc_flag primary_flag"),
)  # fmt: skip

# The dimension of the cell centres (rho points) for each dimension of staggered points of a C-grid,
# as named by ROMS and CROCO, and by XIOS for CROCO.
STAGGERED = {"xi_u": "xi_rho", "eta_u": "eta_rho", "xi_v": "xi_rho", "eta_v": "eta_rho",
             "x_u": "x_rho", "y_v": "y_rho"}  # fmt: skip

TERRAIN = ("ocean_s_coordinate", "ocean_sigma_coordinate")
"The beginnings of the standard names of levels that follow the sea bed."

LENGTHS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 0.001),
    **dict.fromkeys(("dm", "decimeter", "decimeters", "decimetre", "decimetres"), 0.1),
    **dict.fromkeys(("km", "kilometer", "kilometers", "kilometre", "kilometres"), 1000.0),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("mi", "mile", "miles"), 1609.344),
    **dict.fromkeys(("nmi", "nautical mile", "nautical miles", "nautical_mile"), 1852.0),
}
"The units of length, in metres."

# NEMO may name a dimension after the points of its grid: x_grid_U, y_grid_V_inner.
POINTS = re.compile(r"_grid_([tuvwf])(_inner)?$")


def table(role: Role) -> Iterator[Convention]:
    """Return the conventions for a role, the preferred first."""
    return (row for row in CONVENTIONS if row.role == role)


def find(dataset: xr.Dataset, role: Role, among: Iterable[str]) -> str | None:
    """Find which variable in the list `among` has a role, by its name, standard name or unit."""
    among = list(among)
    by_name = {name.lower(): name for name in reversed(among)}
    for row in table(role):
        for name in row.names:
            if name in by_name:
                return by_name[name]
        for key, known in (("standard_name", row.standard_names), ("units", row.units)):
            for name in among:
                if str(dataset[name].attrs.get(key, "")).lower() in known:
                    return name
    return None


def find_pairs(dataset: xr.Dataset, role: Role) -> Iterator[tuple[Convention, list[list[str]]]]:
    """Yield the conventions for two components that a dataset follows, with the variables of each.

    Names exist for both components, in any case; a standard name may have no variable, or several.
    """
    variables = [(str(name), v.attrs.get("standard_name")) for name, v in dataset.data_vars.items()]
    for row in table(role):
        if row.names:
            found = [[name for name, _ in variables if name.lower() == one] for one in row.names]
        else:
            found = [[name for name, own in variables if own == one] for one in row.standard_names]
        if all(found) or (any(found) and not row.names):
            yield row, found
