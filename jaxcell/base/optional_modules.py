"""Import optional modules, which an extra installs, or which a robot's computer may lack."""

import importlib
import importlib.util
from types import ModuleType


# The feature that needs a module, and how to install the module.
_NEEDS = {
    "cv2": "finding crosses needs OpenCV; install it with: pip install 'jaxcell[vision]'",
    "irobot_create_msgs": "a Create 3 needs ros-$ROS_DISTRO-irobot-create-msgs, by apt",
    "matplotlib": "plots need matplotlib; install it with: pip install 'jaxcell[plot]'",
    "mujoco": "the physics engine needs MuJoCo; install it with: pip install 'jaxcell[physics]'",
    "pysat": "proving a least filter needs python-sat; install it with: "
    "pip install 'jaxcell[smallest]'",
    "pyarrow": "Parquet needs PyArrow; install it with: pip install 'jaxcell[parquet]'",
    "rclpy": "ROS 2 is not set up; first run: source /opt/ros/$ROS_DISTRO/setup.bash",
    "rerun": "recordings need Rerun; install it with: pip install 'jaxcell[view]'",
    "scipy": "beliefs need SciPy; install it with: pip install scipy",
    "shapefile": "shapefiles need pyshp; install it with: pip install 'jaxcell[land]'",
}


def has_module(name: str) -> bool:
    """Check whether a module is installed, without importing it."""
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def missing_module(name: str, reason: object = None) -> ModuleNotFoundError:
    """Return an error with the feature that needs a module, how to install it, and the `reason`."""
    why = "" if reason is None else f" ({reason})"
    return ModuleNotFoundError(f"{_NEEDS[name]}{why}", name=name)


def import_module(name: str) -> ModuleType:
    """Import an optional module, or raise an error that explains how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise missing_module(name.partition(".")[0], error) from None
