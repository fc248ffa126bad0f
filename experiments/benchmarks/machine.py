"""Describe the machine and the packages of a benchmark."""

import datetime
import os
import platform
import re
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import psutil


# jaxcell, its main dependencies, and the peers of all benchmarks.
PACKAGES = (
    "jaxcell",
    "jax",
    "numpy",
    "scipy",
    "shapely",
    "numba",
    "automata-lib",
    "cvxpy",
    "quantecon",
    "pymdptoolbox",
    "deeptime",
    "gldpy",
    "cmgdb",
    "distributed",
)


def version(package: str) -> str | None:
    """Find the version of a package by its name on PyPI; `None` if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def versions() -> dict[str, str | None]:
    """Find the version of each package; `None` if it is not installed."""
    return {package: version(package) for package in PACKAGES}


def machine() -> dict[str, Any]:
    """Describe the machine, the date, and the load."""
    return {
        "cpu": cpu(),
        "cores": os.cpu_count(),
        "device": jax.devices()[0].device_kind,
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "load": round(os.getloadavg()[0], 1),
    }


def cpu() -> str:
    """Name the model of the processor."""
    file = Path("/proc/cpuinfo")
    if file.exists() and (found := re.search(r"^model name\s*:\s*(.+)$", file.read_text(), re.M)):
        return found[1].strip()
    return platform.processor() or platform.machine()
