"""The study of dynamics, its command, its files and its recording."""

import json
import os
import re
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from recordings import Recording

from jaxcell import dynamics, space, study
from jaxcell.cli.app import run


OWN = """
import jax.numpy as jnp
from jaxcell import dynamics, space

well = dynamics.System(
    lambda x, p: jnp.where(x > p["edge"], 0.95, 0.25),
    space.Box([0], [1], [20]),
    {"edge": 0.5},
)
"""

FOUR = """
import jax.numpy as jnp
from jaxcell import dynamics, space

wells = dynamics.System(
    lambda x, p: jnp.where(x > p["edge"], 1.0, -1.0) * jnp.ones(4),
    space.Box([-2] * 4, [2] * 4, [5, 4, 3, 9]),
    {"edge": 0.1},
    ("a", "b", "c", "d"),
)
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own_system.py"
    path.write_text(OWN)
    return f"{path}:well"


def test_two_of_four_axes_are_drawn_and_the_cut_is_reported(tmp_path, capsys):
    path = tmp_path / "four.py"
    path.write_text(FOUR)
    command = ["dynamics", f"{path}:wells", "--json", "--out", str(tmp_path)]
    assert run(command) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["attractors"] == len(found["basins"]) == 16
    with xr.open_dataset(tmp_path / "dynamics.nc") as saved:
        basin = saved.basin.values.reshape(saved.attrs["box_cells"])
    recorded = Recording(tmp_path / "dynamics.rrd")
    pictures = recorded.pictures("slice", "/box/basins")
    labels = recorded.classes("/box/basins")
    for third in range(3):
        named = [[int(labels[k].split()[-1]) for k in row] for row in pictures[third]]
        assert named == basin[:, :, third, 4].T.tolist()
    text = recorded.text()
    cut = "maps go along a and b, and the timeline `slice` through the 3 cells of c, from -1.333"
    assert cut in text
    assert "to 1.333; they are cut at d = 0." in text
    # The last axis has more cells than the third.
    assert run([*command, "--params", "edge=0.1:0.2:2"]) == 0
    recorded = Recording(tmp_path / "dynamics.rrd")
    last = recorded.pictures("edge x 10", "/box/basins")[2]
    labels = recorded.classes("/box/basins")
    shown = [[labels[k].split()[-1] for k in row] for row in last]
    assert shown == [[str(k) for k in row] for row in basin[:, :, 1, 4].T]
    text = recorded.text()
    assert "The maps go along a and b, at c = 0, d = 0." in text


def test_several_values_give_a_continuation(own, tmp_path, capsys):
    assert run(["dynamics", own, "--params", "edge=0.5:1:3", "--out", str(tmp_path), "--json"]) == 0
    capsys.readouterr()
    with xr.open_dataset(tmp_path / "dynamics.nc") as saved:
        np.testing.assert_allclose(saved.fraction, [[0.5, 0.5], [0.75, 0.25], [1, 0]])
    recorded = Recording(tmp_path / "dynamics.rrd")
    curve = recorded.over("edge x 100", "/fractions/attractor_1", "Scalars:scalars")
    assert list(curve) == [50, 75, 100], "the slider shows the parameter"
    np.testing.assert_allclose([value for (value,) in curve.values()], [0.5, 0.25, 0])
    assert len(recorded.pictures("edge x 100", "/box/basins")) == 3
    labels = recorded.over("edge x 100", "/box/parameters", "Points2D:labels")
    assert labels == {50: ["edge=0.5"], 75: ["edge=0.75"], 100: ["edge=1"]}
    text = recorded.text()
    assert "A time of the slider `edge x 100` is the value times 100." in text


def test_folder_keeps_the_arrays_and_gives_the_same_summary(own, tmp_path, capsys):
    summaries = []
    for more in ([], ["--folder", str(tmp_path / "cells")], ["--folder", str(tmp_path / "cells")]):
        assert run(["dynamics", own, "--json", "--out", str(tmp_path), *more]) == 0
        written = capsys.readouterr()
        found = json.loads(written.out)
        for name in ("seconds", "folder"):
            found.pop(name, None)
        summaries.append(found)
    assert summaries[0] == summaries[1] == summaries[2]
    assert "20 cells take about 1 min" in written.err
    with xr.open_dataset(tmp_path / "dynamics.nc") as saved:
        basin = np.load(tmp_path / "cells" / "basin.npy", mmap_mode="r")
        np.testing.assert_array_equal(saved.basin, basin)


MEASURED = """
import pathlib, psutil, re
from jaxcell import dynamics
from jaxcell.dynamics import systems
from jaxcell.space import Box

def found(cells):
    box = Box([-2, -2], [2, 2], [cells, cells])
    return dynamics.basins(systems.henon.map, box, systems.henon.params)

found(1100)
before = psutil.Process().memory_info().rss
one = found(2000)
# The peak of getrusage includes that of the process that started this one.
status = pathlib.Path("/proc/self/status").read_text()
peak = int(re.search(r"VmHWM:\\s*(\\d+) kB", status)[1]) * 1024
kept = one.image, one.basin, one.group, one.step, one.several, one.left
print((peak - before - sum(array.nbytes for array in kept)) / one.box.size)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is read on Linux")
def test_basins_take_16_bytes_per_cell_beside_the_result():
    # Programs without optimization keep intermediate arrays.
    run = subprocess.run(
        [sys.executable, "-c", MEASURED],
        env={**os.environ, "XLA_FLAGS": ""},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) <= 16


def test_boxes_beyond_the_memory_are_refused_with_the_number(own, monkeypatch):
    monkeypatch.setattr("jaxcell.base.memory.free", lambda: 10**9)
    small = study.Dynamics(system=own, cells=(1_000,))
    assert small.memory() < 10**9
    for large in ({"cells": (40_000_000,)}, {"params": ("edge=0:1:2000",), "cells": (30_000,)}):
        with pytest.raises(MemoryError, match=r"dynamics needs about \d\.\d GB of memory, and 1.0"):
            study.Dynamics(system=own, **large).run()


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"system": "none.py:duff"}, "system: none.py:duff: there is no file none.py"),
        ({"params": ("force=1:2:0",)}, "params: force: expected a number or FIRST:LAST:COUNT"),
        ({"cells": (3, 3, 3)}, "got 2, 2, 3 and 2"),
        ({"folder": "cells", "by": "orbits"}, "folder: expected basins by cells, not by orbits"),
        ({"params": ("force=1:2:2",), "edges": True}, "edges: expected one value of each"),
    ],
)
def test_bad_parameters_are_refused_in_one_line(parameters, message):
    with pytest.raises(ValueError, match=re.escape(message)) as refused:
        study.Dynamics(**{"system": "duffing", **parameters}).run()
    assert "\n" not in str(refused.value)


def wells(x, p):
    return jnp.where(x > p["edge"], 0.95, 0.25)


@pytest.mark.parametrize("kind", [study.Dynamics, study.Morse])
def test_studies_take_a_system_of_the_program(kind):
    system = dynamics.System(wells, space.Box([0], [1], [20]), {"edge": 0.5})
    own = kind(system, cells=(10,))
    result = own.run()
    assert own.chosen.box.size == 10
    assert own.headline(own.spec(result)) == "The system of the program"
    with pytest.raises(ValueError, match=r"system: expected a name or dynamics.System"):
        kind(wells).run()


def test_a_list_of_values_varies_the_only_parameter_of_a_map():
    box = space.Box([0], [1], [20])
    named = dynamics.continuation(wells, box, {"edge": [0.75, 0.5]})
    found = dynamics.continuation(lambda x, p: wells(x, {"edge": p}), box, [0.75, 0.5])
    assert found.fraction.tolist() == named.fraction.tolist()
    assert found.parameters == ["parameter=0.75", "parameter=0.5"]
