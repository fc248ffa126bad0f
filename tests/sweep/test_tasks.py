import math
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, strategies as st

from jaxcell import bounce
from jaxcell.automata import minimize
from jaxcell.space import ENDPOINT, CellSpace, Workspace
from jaxcell.space.maps.random_rooms import place, random_room
from jaxcell.sweep.workers.work import Job, compute, find_task


DATA = Path(__file__).parents[2] / "data"
LAB = str(DATA / "maps" / "lab_a.json")
DRIFTERS = str(DATA / "ocean" / "drifters.nc")


WIDTH = """
import jax.numpy as jnp
import numpy as np
import xarray as xr

def width(batch, fixed, seed):
    bits = np.full(batch["a"].size, jnp.zeros(()).dtype.itemsize * 8)
    return xr.Dataset({"bits": ("member", bits)})
"""


@pytest.mark.parametrize("wide", [True, False])
def test_a_worker_computes_with_the_precision_of_the_driver(wide, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_ENABLE_X64", "")
    path = tmp_path / "own.py"
    path.write_text(WIDTH)
    before = jax.config.jax_enable_x64
    try:
        jax.config.update("jax_enable_x64", not wide)
        job = Job(
            np.zeros(2, int), np.arange(2), f"{path}:width", {"a": np.arange(2.0)}, {}, 0, wide
        )
        computed = compute(job)
    finally:
        jax.config.update("jax_enable_x64", before)
    assert computed.variables["bits"].values.tolist() == [64 if wide else 32] * 2


def lab(**changes):
    workspace = Workspace.load(LAB)
    return CellSpace.of(workspace, workspace.cell, changes.get("directions", workspace.directions))


def test_filters_are_those_of_the_dissertation():
    batch = {"bounce": np.array([45.0, 135.0])}
    columns = columns_of("localize", batch, {"map": LAB, "collision": "endpoint"}, 0)
    # Tables 2.1 and 2.2.
    assert columns.nfa_states.values.tolist() == [153, 153]
    assert columns.dfa_states.values.tolist() == [129, 124]
    assert columns.knowledge_cycles.values.tolist()[0] == 3
    assert columns.least_uncertainty.values.tolist() == [1, 1]
    assert columns.largest_uncertainty.values.tolist() == [4, 2]
    filter = bounce.localization_filter(bounce.bounce_map(lab(), math.pi / 4, motion=ENDPOINT))
    assert columns.minimal_states[0] == len(minimize(filter).transition)


def columns_of(task, *given):
    return xr.Dataset(find_task(task)(*given))


ROOMS = {"columns": 9, "rows": 7, "obstacles": 2, "directions": 24}


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 23)), min_size=1, max_size=8), st.data()
)
def test_rooms_do_not_depend_on_the_batch(pairs, data):
    def run(some):
        batch = {
            "room": np.array([r for r, _ in some]),
            "bounce": np.array([15 * a for _, a in some]),
        }
        return columns_of("rooms", batch, ROOMS, 7)

    whole = run(pairs)
    cut = data.draw(st.integers(1, len(pairs)))
    order = data.draw(st.permutations(range(len(pairs))))
    shuffled = [pairs[i] for i in order]
    parts = [run(some) for some in (shuffled[:cut], shuffled[cut:]) if some]
    for name in whole:
        together = np.concatenate([part[name].values for part in parts])
        np.testing.assert_array_equal(together, whole[name].values[order])


def test_rooms_are_the_rooms_of_their_numbers():
    columns = columns_of("rooms", {"room": np.array([0, 5])}, {**ROOMS, "bounce": 90}, 3)
    for i, number in enumerate((0, 5)):
        free = random_room(3, number, 9, 7, 2)
        cells = CellSpace.of_grid(free, 24)
        expected = bounce.bounce_groups(cells, math.pi / 2)
        assert columns.positions[i] == free.sum()
        assert columns["count"][i] == int(expected.count)
        assert columns.longest_transient[i] == int(expected.step.max())
    environment = columns_of(
        "rooms", {"room": np.array([2])}, {"environment": "E3", "bounce": 90, "directions": 4}, 0
    )
    assert environment.positions[0] == place(0, "E3", 2).free.sum()


def test_observed_drifters_give_one_number_per_member():
    batch, fixed = {"lag": np.array([5.0, 10.0])}, {"file": DRIFTERS, "cell": 3, "samples": 2}
    columns = columns_of("drifters", batch, fixed, 0)
    assert columns.cells.values.tolist() == [40, 40]
    assert columns.moves.values[1] < columns.moves.values[0] == 3722
    assert columns.drifters.values.tolist() == [200, 200]
    assert columns.observations.values.tolist() == [3922, 3922]
    # Quantities with several numbers per member are left to `jaxcell drifters`.
    assert "estimates_value" not in columns


def test_drawing_rooms_that_cannot_be_connected_ends():
    with pytest.raises(
        ValueError, match=r"obstacles: 60 obstacles leave .* in several pieces; expected fewer"
    ):
        random_room(0, 0, 4, 1, 60)
