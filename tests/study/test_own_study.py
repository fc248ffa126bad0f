"""A study in a file of the user is served like a study of jaxcell."""

import dataclasses
import json
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from recordings import read_back

from jaxcell import bundled
from jaxcell.cli import main
from jaxcell.record import dataset, summary
from jaxcell.study import Cover, Study
from jaxcell.study.loading import load_study
from jaxcell.sweep.study_task import read_study, study_task


SOURCE = '''
import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from jaxcell.base.quantities import Result, derived, quantity
from jaxcell.study import AtLeastOne, Limit, Metres, Study, silent


@dataclasses.dataclass(frozen=True, eq=False)
class Fall(Result):
    title = "A stone that falls"
    tables = {"moment": "moments"}

    height: Annotated[np.ndarray, quantity("step", "height of the stone", "m")]
    speed: Annotated[np.ndarray, quantity("moment", "speed of the stone", "m s-1")]
    lost: Annotated[float, quantity("", "energy that is lost", kind="share")]

    @derived("", "time of the fall", "s", kind="time")
    def seconds_down(self):
        return float(np.sqrt(2 * self.height[0] / 9.81))

    @property
    def answered(self):
        return self.lost < 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drop(Study):
    """Drop a stone."""

    name = "drop"

    height: Annotated[Metres, Limit(gt=0)]
    """From how high, in metres."""
    lost: float = 0.25
    """Energy that is lost."""
    winds: tuple[Annotated[float, Limit(le=9)], ...] = ()
    """Gusts on the way."""
    stones: AtLeastOne | Literal["all"] | None = None
    """How many at once."""
    kinds: tuple[str, ...] = ("stone",)
    """What is dropped."""
    photographs: tuple[Path, ...] = ()
    """Pictures of the fall."""

    def run(self, say=silent):
        say("dropping")
        if self.height > 1000:
            raise RuntimeError("it burns up")
        t = np.linspace(0, 1, 5)
        return Fall(self.height * (1 - t**2), t[:2], self.lost)
'''


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "stones.py"
    path.write_text(textwrap.dedent(SOURCE))
    yield path
    sys.modules.pop("stones", None)


@pytest.fixture
def drop(file) -> type[Study]:
    return load_study(f"{file}:Drop")


def test_its_summary_has_numbers_and_tables(drop):
    assert summary(drop(height=20.0).run()) == {
        "lost": 0.25,
        "seconds_down": pytest.approx(2.0193, abs=1e-4),
        "moments": [{"speed": 0.0}, {"speed": 0.25}],
    }


def test_quantities_are_described_and_checked_by_their_kind(drop):
    found = dataset(drop(height=20.0).run(), spec={"height_m": 20})
    assert found.height.dims == ("step",)
    described = {"long_name": "height of the stone", "units": "m", "kind": "number"}
    assert found.height.attrs == described
    assert found.seconds_down.item() == pytest.approx(2.0193, abs=1e-4)
    assert json.loads(found.attrs["spec"]) == {"height_m": 20}
    with pytest.raises(RuntimeError, match=r"lost_out_of_0_to_1 is 0\.5"):
        dataset(drop(height=20.0, lost=1.5).run())


def test_its_command_prints_and_writes_its_result(file, tmp_path, capsys):
    out = tmp_path / "out"
    args = ["run", f"{file}:Drop", "--height", "20", "--out", str(out)]
    assert main(args) == 0
    shown = capsys.readouterr().out
    assert "energy that is lost" in shown
    assert "25 %" in shown
    assert "0.25 m s-1" in shown
    with xr.open_dataset(out / "drop.nc") as found:
        np.testing.assert_allclose(found.height[[0, -1]], [20, 0])
    kept = json.loads((out / "summary.json").read_text())
    assert main([*args, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {**printed, "seconds": 0} == {**kept, "seconds": 0}
    assert printed["command"] == f"jaxcell run {file}:Drop"
    assert (printed["height_m"], printed["kinds"]) == (20, ["stone"])


@pytest.mark.parametrize(
    ("args", "status", "message"),
    [
        (("--height", "-1"), 2, "--height: expected more than 0 m, got -1"),
        (("--height", "2", "--winds", "3", "10"), 2, "--winds: expected at most 9, got 10"),
        (("--height", "2", "--stones", "0"), 2, "--stones: expected at least 1, got 0"),
        (("--height", "2000"), 1, "it burns up"),
        (("--height", "2", "--lost", "1"), 1, ""),
    ],
)
def test_its_command_refuses_bad_parameters(file, capsys, args, status, message):
    assert main(["run", f"{file}:Drop", *args]) == status
    assert message in capsys.readouterr().err


def test_its_recording_shows_curves_and_numbers(drop):
    found = read_back(drop(height=20.0).run(), {"height_m": 20})
    curve = found.over("step", "/curves/height", "Scalars:scalars")
    assert curve[0] == [20.0]
    assert curve[4] == [0.0]
    (text,) = found.static("/text", "TextDocument:text")
    assert "| energy that is lost | 25 % |" in text
    assert "| height_m | 20 |" in text


def test_its_sweep_has_its_single_numbers(drop):
    found = study_task(drop, {"height": np.array([5, 20])}, {"lost": 0.5}, seed=0)
    np.testing.assert_allclose(found.seconds_down, np.sqrt([10 / 9.81, 40 / 9.81]))
    assert found.seconds_down.attrs == {"long_name": "time of the fall", "units": "s"}
    assert set(found.data_vars) == {"lost", "seconds_down"}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "height: Drop needs this"),
        ({"height": "high"}, "height: expected float, got str: 'high'"),
        ({"height": 1, "weight": 2}, "weight: expected a parameter of Drop, one of height"),
        ({"height": 1, "kinds": [1]}, r"kinds: expected str, got int: \[1\]"),
    ],
)
def test_parameters_of_another_type_are_refused(drop, given, message):
    with pytest.raises(ValueError, match=message):
        read_study(drop, given)


def test_a_single_value_will_do_for_several(drop):
    asked = read_study(drop, {"height": 1, "kinds": "feather"})
    assert asked == dataclasses.replace(drop(height=1.0), kinds=("feather",))


def test_a_study_takes_the_name_of_bundled_data():
    robot = {"bounces": (45.0,), "error": 45.0, "reliability": 0.8}
    assert Cover(map=Path("@lab_a"), **robot) == Cover(map=bundled("lab_a"), **robot)
    with pytest.raises(FileNotFoundError, match="not among the bundled data"):
        Cover(map=Path("@lab_z"), **robot)


def test_a_parameter_of_several_values_accepts_one(drop):
    single = drop(height=1.0, kinds="feather", photographs="@gyres")
    assert single == drop(height=1.0, kinds=("feather",), photographs=(bundled("gyres"),))
