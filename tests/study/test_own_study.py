"""A study in a file of the user is served like a study of jaxcell."""

import json
from pathlib import Path

import falling_stone
import pytest
from falling_stone import Drop
from helpers import run
from recordings import read_back

from jaxcell import bundled
from jaxcell.cli import main
from jaxcell.record import dataset, summary
from jaxcell.study import Cover
from jaxcell.sweep.study_task import read_study


FILE = Path(falling_stone.__file__)


def test_its_summary_has_numbers_and_tables():
    assert summary(Drop(height=20.0).run()) == {
        "lost": 0.25,
        "seconds_down": pytest.approx(2.0193, abs=1e-4),
        "moments": [{"speed": 0.0}, {"speed": 0.25}],
    }


def test_quantities_are_described_and_checked_by_their_kind():
    found = dataset(Drop(height=20.0).run(), spec={"height_m": 20})
    assert found.height.dims == ("step",)
    described = {"long_name": "height of the stone", "units": "m", "kind": "number"}
    assert found.height.attrs == described
    assert found.seconds_down.item() == pytest.approx(2.0193, abs=1e-4)
    assert json.loads(found.attrs["spec"]) == {"height_m": 20}
    with pytest.raises(RuntimeError, match=r"lost_out_of_0_to_1 is 0\.5"):
        dataset(Drop(height=20.0, lost=1.5).run())


def test_its_command_runs_it_from_its_file(capsys):
    status, printed, _ = run(capsys, "run", f"{FILE}:Drop", "--height 20")
    assert (status, printed["command"]) == (0, f"jaxcell run {FILE}:Drop")
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
def test_its_command_refuses_bad_parameters(capsys, args, status, message):
    assert main(["run", f"{FILE}:Drop", *args]) == status
    assert message in capsys.readouterr().err


def test_its_recording_shows_curves_and_numbers():
    found = read_back(Drop(height=20.0).run(), {"height_m": 20})
    curve = found.over("step", "/curves/height", "Scalars:scalars")
    assert curve[0] == [20.0]
    assert curve[4] == [0.0]
    text = found.text()
    assert "| energy that is lost | 25 % |" in text
    assert "| height_m | 20 |" in text


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "height: Drop needs this"),
        ({"height": "high"}, "height: expected float, got str: 'high'"),
        ({"height": 1, "weight": 2}, "weight: expected a parameter of Drop, one of height"),
        ({"height": 1, "kinds": [1]}, r"kinds: expected str, got int: \[1\]"),
    ],
)
def test_parameters_of_another_type_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        read_study(Drop, given)


def test_a_study_takes_the_name_of_bundled_data():
    robot = {"bounce": (45.0,), "errors": ("turn=45",), "reliability": 0.8}
    assert Cover(map=Path("@lab_a"), **robot) == Cover(map=bundled("lab_a"), **robot)
    with pytest.raises(FileNotFoundError, match="not among the bundled data"):
        Cover(map=Path("@lab_z"), **robot)


def test_a_parameter_of_several_values_accepts_one():
    assert read_study(Drop, {"height": 1, "kinds": "feather"}) == Drop(
        height=1.0, kinds=("feather",)
    )
    single = Drop(height=1.0, kinds="feather", photographs="@gyres")
    assert single == Drop(height=1.0, kinds=("feather",), photographs=(bundled("gyres"),))
