"""Import optional modules, which an extra installs, or which a robot's computer may lack."""

import importlib
import importlib.util
from types import ModuleType


# The feature that needs a module, and the extra of jaxcell that installs the module.
_EXTRAS = {
    "PIL": ("images need Pillow", "robot"),
    "cftime": ("calendars need cftime", "ocean"),
    "cv2": ("finding crosses needs OpenCV", "vision"),
    "cvxpy": ("this check needs cvxpy", "verify"),
    "highspy": ("this search needs HiGHS", "patrol"),
    "matplotlib": ("plots need matplotlib", "plot"),
    "msgspec": ("sweeps need msgspec", "sweep"),
    "mujoco": ("the physics engine needs MuJoCo", "physics"),
    "netCDF4": ("NetCDF needs netCDF4", "ocean"),
    "networkx": ("graphs need networkx", "patrol"),
    "numcodecs": ("sweeps need numcodecs", "sweep"),
    "optax": ("this search needs optax", "patrol"),
    "pandas": ("tables need pandas", "ocean"),
    "pyarrow": ("Parquet needs PyArrow", "parquet"),
    "pysat": ("proving a least filter needs python-sat", "smallest"),
    "rerun": ("recordings need Rerun", "view"),
    "rich": ("commands need rich", "app"),
    "serial": ("a serial line needs pyserial", "robot"),
    "shapefile": ("shapefiles need pyshp", "land"),
    "tyro": ("commands and studies need tyro", "app"),
    "xarray": ("currents and tables need xarray", "ocean"),
    "yaml": ("YAML needs PyYAML", "robot"),
    "zarr": ("this file needs Zarr", "ocean"),
}
_OTHERS = {
    "irobot_create_msgs": "a Create 3 needs ros-$ROS_DISTRO-irobot-create-msgs, by apt",
    "rclpy": "ROS 2 is not set up; first run: source /opt/ros/$ROS_DISTRO/setup.bash",
    "scipy": "beliefs need SciPy; install it with: pip install scipy",
}


def has_module(name: str) -> bool:
    """Check whether a module is installed, without importing it."""
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def missing_module(name: str, reason: object = None) -> ModuleNotFoundError:
    """Return an error with the feature that needs a module, how to install it, and the `reason`."""
    text = _OTHERS.get(name)
    if text is None:
        feature, extra = _EXTRAS[name]
        text = f"{feature}; install it with: pip install 'jaxcell[{extra}]'"
    why = "" if reason is None else f" ({reason})"
    return ModuleNotFoundError(f"{text}{why}", name=name)


def explained(error: ModuleNotFoundError) -> ModuleNotFoundError:
    """Return an error for the error of a missing module; it names the extra if there is one."""
    name = (error.name or "").partition(".")[0]
    plain = str(error).startswith(("No module named", "import of "))
    return missing_module(name) if plain and name in _EXTRAS else error


def import_module(name: str) -> ModuleType:
    """Import an optional module, or raise an error that explains how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise missing_module(name.partition(".")[0], error) from None
