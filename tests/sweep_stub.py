"""A task without JAX for tests of sweeps: slow, failing or deadly where its parameters say so."""

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import xarray as xr


def stub(batch, fixed, seed):
    """A few numbers of each member.

    `fixed` may have `seconds` that a chunk takes, and `folder`, where each call leaves a file.
    Members with `x == fixed["fail"]` fail; those with `x == fixed["kill"]` kill their process,
    and with `fixed["once"]` only the first time; those with `x == fixed["hang"]` take minutes, as
    does a program that each call starts, with its number in the file `fixed["starts"]`.
    """
    x = np.asarray(batch["x"], float)
    if "starts" in fixed:
        Path(fixed["starts"]).write_text(str(subprocess.Popen(["sleep", "300"]).pid))
    time.sleep(fixed.get("seconds", 0))
    if "folder" in fixed:
        folder = Path(fixed["folder"])
        numbers = "_".join(f"{each:g}" for each in x)
        (folder / f"{os.getpid()}-{time.monotonic_ns()}-{numbers}").touch()
    if (x == fixed.get("fail")).any():
        raise RuntimeError(f"x is {fixed['fail']}")
    if (x == fixed.get("kill")).any() and not _seen(fixed):
        os.kill(os.getpid(), signal.SIGKILL)
    if (x == fixed.get("hang")).any():
        time.sleep(300)
    value = x**2 + seed
    if "y" in batch:
        value = value + np.asarray(batch["y"], float)
    noise = [np.random.default_rng([seed, abs(hash(float(each)))]).normal() for each in x]
    return xr.Dataset(
        {
            "value": ("member", value, {"units": "m", "long_name": "a value"}),
            "noise": ("member", np.array(noise)),
            "count": ("member", x.astype(np.int32)),
            "even": ("member", x.astype(int) % 2 == 0),
            "power": (("member", "exponent"), x[:, None] ** np.arange(3)),
        },
        {"exponent": np.arange(3)},
    )


def chatty(batch, fixed, seed):
    """Prints, as some do."""
    print("from Python", flush=True)
    os.write(1, b"from elsewhere\n")
    return stub(batch, fixed, seed)


def who(batch, fixed, seed):
    """The name of the worker of Dask that computes it."""
    from distributed import get_worker

    time.sleep(fixed["seconds"])
    return xr.Dataset({"name": ("member", [int(get_worker().name)])})


def _seen(fixed):
    if "once" not in fixed:
        return False
    path = Path(fixed["once"])
    seen = path.exists()
    path.touch()
    return seen
