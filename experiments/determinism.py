"""Test if the same specification gives the same results, digit for digit.

The script runs every command with results, and a sweep, on small examples, and reads their files.
It takes a fingerprint of every variable: a digest of its bytes, and for floating-point numbers
three weighted sums with fixed random weights. These commands compare two runs:

    python experiments/determinism.py --write experiments/determinism.json
    python experiments/determinism.py --check experiments/determinism.json [--exact]

With the same Python, JAX and processor all bytes are equal, which `--exact` requires. Other
versions of JAX, NumPy or SciPy, or another processor, may add numbers in another order. Then whole
numbers must still be equal, and weighted sums must agree within 1e-9 of the sum of the absolute
values. The parameters of the generalized lambda distribution must agree within 1e-3, because their
search stops at a tolerance.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import platform
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxcell.cli import main as jaxcell


DATA = Path(__file__).parents[1] / "data"
LAB = str(DATA / "maps" / "lab_a.json")
GYRES = str(DATA / "ocean" / "gyres.nc")
SWEEP = f"""
task = "groups"
chunk = 5

[fixed]
map = {json.dumps(LAB)}
directions = 24

[grid]
bounce = {{ start = 15, stop = 345, step = 15 }}
"""
COMMANDS = {
    "groups": ["groups", LAB, "--bounce", "45", "90", "135"],
    "groups of slanted walls": ["groups", str(DATA / "maps" / "cafe.json"), "--bounce", "90"],
    "localize": ["localize", LAB, "--bounce", "135", "--seed", "3"],
    "navigate": ["navigate", LAB, "--bounce", "45", "135", "--start", "0", "--goal", "60"],
    "cover": f"cover {LAB} --bounce 45 90 135 --errors turn=2deg --reliability 0.8".split(),
    "team": ["team", LAB, "--bounce", "135", "--robots", "3", "--seed", "1"],
    "patrol graph": ["patrol", "graph", str(DATA / "graphs" / "eight.json"), "--game"],
    "patrol map": ["patrol", "map", LAB, "--range", "2", "--runs", "500", "--base", "auto"],
    "drift": [
        *("drift", GYRES, "--edge", "exit", "--duration", "3400", "--range", "6000"),
        *("--start", "-118.0,33.5", "--goal", "-118.1,33.45,5"),
    ],
}
# The packages with a recorded version.
PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "shapely", "optax", "networkx", "xarray")
# The tolerances of sums, relative to the sum of absolute values; the second by variable.
ROUNDING = 1e-9
SEARCHED = {"gld": 1e-3, "fitted": 1e-3}


def fingerprint(values: np.ndarray) -> dict[str, Any]:
    """Take the fingerprint of a variable."""
    values = np.ascontiguousarray(values)
    if values.dtype.kind in "OU":
        return {"sha256": digest(json.dumps(values.tolist()).encode())}
    described = f"{values.dtype.str} {values.shape} ".encode()
    fields: dict[str, Any] = {"sha256": digest(described + values.tobytes())}
    if values.dtype.kind == "f":
        flat = values.astype(float).ravel()
        finite = np.isfinite(flat)
        # Missing and infinite numbers must be at the same places.
        places = np.where(np.isnan(flat), 2, np.where(finite, 0, np.sign(flat))).astype(np.int8)
        numbers = np.where(finite, flat, 0)
        weights = np.random.default_rng(0).uniform(0.5, 1, (3, flat.size))
        weights *= np.random.default_rng(1).choice([-1, 1], weights.shape)
        fields["known"] = digest(described + places.tobytes())
        fields["sums"] = [float(row @ numbers) for row in weights]
        fields["size"] = float(np.abs(numbers).sum())
    return fields


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def run(name: str, args: list[str], folder: Path) -> dict[str, Any]:
    """Run a command, and take the fingerprints of all variables of its files."""
    out = folder / name.replace(" ", "-")
    with contextlib.redirect_stdout(io.StringIO()) as output:
        status = jaxcell([*args, "--out", str(out), "--json"])
    if status:
        raise SystemExit(f"{name}: exit status {status}: {output.getvalue()}")
    fingerprints = {}
    for file in sorted(out.rglob("*.nc")):
        with xr.open_dataset(file, decode_times=False) as dataset:
            for variable in sorted(dataset.variables):
                values = dataset.variables[variable].values
                fingerprints[f"{name}: {file.name}: {variable}"] = fingerprint(values)
    if not fingerprints:
        raise SystemExit(f"{name}: expected a NetCDF file in {out}, found none")
    return fingerprints


def run_all() -> dict[str, Any]:
    """Run all commands, and return their fingerprints with the versions of the packages."""
    variables: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        spec = Path(folder) / "angles.toml"
        spec.write_text(SWEEP, encoding="utf-8")
        for name, args in {**COMMANDS, "sweep": ["sweep", str(spec), "--netcdf"]}.items():
            print(f"{name} ...", file=sys.stderr, flush=True)
            variables |= run(name, args, Path(folder))
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "packages": {package: metadata.version(package) for package in PACKAGES},
        "variables": variables,
    }


def compare(
    now: dict[str, Any], then: dict[str, Any], *, exact: bool
) -> tuple[int, list[str], list[str]]:
    """Compare two runs.

    Returns the number of variables with the same bytes, and lists the variables that differ by
    rounding, and by more.
    """
    same, rounded, different = 0, [], []
    names = {*now["variables"], *then["variables"]}
    for name in sorted(names):
        one, other = (files["variables"].get(name) for files in (now, then))
        if one is None or other is None:
            different.append(f"{name}: only in the {'earlier' if one is None else 'new'} run")
        elif one["sha256"] == other["sha256"]:
            same += 1
        elif one.get("known") is None or one["known"] != other.get("known"):
            different.append(f"{name}: different bytes")
        else:
            size = max(one["size"], other["size"])
            apart = np.abs(np.subtract(one["sums"], other["sums"])).max() / size
            limit = SEARCHED.get(name.rsplit(" ", 1)[1], ROUNDING)
            close = apart <= limit and not exact
            (rounded if close else different).append(f"{name}: {apart:.1e} of the sum")
    return same, rounded, different


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", type=Path, help="file for the fingerprints")
    parser.add_argument("--check", type=Path, help="file of an earlier run for comparison")
    parser.add_argument("--exact", action="store_true", help="require the same bytes")
    options = parser.parse_args()
    # With several threads the order of additions varies.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    now = run_all()
    if options.write is not None:
        options.write.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    versions = ", ".join(f"{name} {number}" for name, number in now["packages"].items())
    print(f"{len(now['variables'])} variables, by Python {now['python']}, {versions}")
    if options.check is None:
        return 0
    then = json.loads(options.check.read_text(encoding="utf-8"))
    same, rounded, different = compare(now, then, exact=options.exact)
    versions = ", ".join(f"{name} {number}" for name, number in then["packages"].items())
    print(f"against {options.check}, by Python {then['python']}, {versions}:")
    print(f"{same} have the same bytes, {len(rounded)} differ by rounding, {len(different)} differ")
    for line in [*rounded, *(f"DIFFERENT: {line}" for line in different)]:
        print(f"  {line}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
