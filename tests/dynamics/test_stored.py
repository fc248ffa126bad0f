"""Basins in files equal basins in memory, also after a computation that was killed."""

import os
import signal
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.dynamics import batches, imaging, systems
from jaxcell.dynamics.large import passes, stored
from jaxcell.dynamics.large.folder import Folder
from jaxcell.mapping.groups import doubled_groups
from jaxcell.space import Box


HENON = systems.henon.map, Box([-2, -2], [2, 2], [61, 61]), dict(systems.henon.params)
ARRAYS = "image", "basin", "group", "step", "several", "left", "group_period", "orbit", "sampled"


def same(one, other):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    assert one.remarks == other.remarks


def make_parts_small(setattr):
    """Divide the work into parts of few cells; cells that passes can drop are not walked."""
    setattr(stored, "PART", 1000)
    setattr(batches, "CHUNK", 700)
    setattr(imaging, "CHUNK", 500)
    setattr(passes, "FEW", 0)


@pytest.fixture
def few(monkeypatch):
    make_parts_small(monkeypatch.setattr)


IMAGES = {
    "dissipative": lambda rng, n: np.maximum(np.arange(n) - rng.integers(0, 9, n), 0),
    "random": lambda rng, n: rng.integers(0, n, n),
    "permutation": lambda rng, n: rng.permutation(n),
    "chain": lambda rng, n: np.maximum(np.arange(n) - 1, 0),
}


@pytest.mark.parametrize("kind", IMAGES)
def test_groups_in_passes_equal_doubling(kind, tmp_path, few):
    image = IMAGES[kind](np.random.default_rng(0), 5000).astype(np.int32)
    groups = passes.groups_in_passes(image, Folder(tmp_path, ""))
    expected = jax.device_get(doubled_groups(jnp.asarray(image)))
    np.testing.assert_array_equal(groups.group, expected.group)
    np.testing.assert_array_equal(groups.step, expected.step)
    np.testing.assert_array_equal(groups.group_period, expected.group_period[: expected.count])


@pytest.mark.parametrize("chunks", [1, 20, 40, 75, 110])
def test_interrupted_passes_are_repeated_to_the_same_groups(chunks, tmp_path, few, monkeypatch):
    image = IMAGES["dissipative"](np.random.default_rng(1), 5000).astype(np.int32)
    whole = passes.groups_in_passes(image, Folder(tmp_path / "whole", ""))
    left = iter(range(chunks))

    def interrupted(size):
        for part in usual(size):
            if next(left, None) is None:
                raise KeyboardInterrupt
            yield part

    usual = passes.slices
    monkeypatch.setattr(passes, "slices", interrupted)
    with pytest.raises(KeyboardInterrupt):
        passes.groups_in_passes(image, Folder(tmp_path / "parts", ""))
    monkeypatch.setattr(passes, "slices", usual)
    groups = passes.groups_in_passes(image, Folder(tmp_path / "parts", ""))
    for part, other in zip(jax.tree.leaves(groups), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(part, other)


KILLED = """
import os, signal, sys
from test_stored import HENON, dynamics, make_parts_small

def say(doing, done, total):
    if doing == "mapping cells" and done > 2000:
        os.kill(os.getpid(), signal.SIGKILL)

make_parts_small(setattr)
dynamics.stored_basins(*HENON, folder=sys.argv[1], say=say)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a process is killed by a signal of POSIX")
def test_killed_computation_continues_to_the_basins_in_memory(tmp_path, few):
    paths = os.pathsep.join([os.path.dirname(__file__), *sys.path])
    environment = {**os.environ, "PYTHONPATH": paths, "JAX_ENABLE_X64": "1"}
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    killed = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    steps = []
    basins = dynamics.stored_basins(*HENON, folder=tmp_path, say=lambda *step: steps.append(step))
    assert steps[0][1] > 2000, "cells were mapped twice"
    same(basins, dynamics.basins(*HENON))


def test_stored_basins_are_opened_without_mapping(tmp_path, few, monkeypatch):
    basins = dynamics.stored_basins(*HENON, folder=tmp_path)

    def refuse(*_, **__):
        raise AssertionError("mapped again")

    monkeypatch.setattr(stored, "images_of_each", refuse)
    same(dynamics.stored_basins(*HENON, folder=tmp_path), basins)
    assert np.load(tmp_path / "basin.npy", mmap_mode="r").tolist() == basins.basin.tolist()
    with pytest.raises(ValueError, match=r"folder: .* has arrays of another map, box or options"):
        dynamics.stored_basins(*HENON[:2], {"a": 1.3, "b": 0.3}, folder=tmp_path)


def test_files_beyond_the_disk_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 10**9}))
    box = Box([-2, -2], [2, 2], [10_000, 10_000])
    with pytest.raises(ValueError, match=r"folder: .* needs 1.9 GB more of disk, and 1.0 GB are"):
        dynamics.stored_basins(HENON[0], box, HENON[2], folder=tmp_path)
