import numpy as np
import pytest
from helpers import run

from jaxcell.base.bundled import bundled, bundled_names
from jaxcell.cli import main
from jaxcell.cli.maps import picture
from jaxcell.space import CellSpace


@pytest.mark.parametrize("name", ["lab_a", "lab_b", "maze"])
def test_a_picture_has_the_squares_of_a_map_in_a_frame(name):
    free = CellSpace.load(bundled(name)).free
    halves = {" ": (0, 0), "▄": (0, 1), "▀": (1, 0), "█": (1, 1)}
    lines = [[halves[one] for one in line] for line in picture(bundled(name)).splitlines()]
    walls = np.concatenate([np.transpose(line) for line in lines])[: free.shape[0] + 2]
    np.testing.assert_array_equal(walls[1:-1, 1:-1], ~free[::-1])
    walls[1:-1, 1:-1] = 1
    assert walls.all()


def test_all_bundled_data_are_listed(capsys):
    listed = [name for kind in run(capsys, "maps")[1].values() for name in kind]
    assert sorted(listed) == sorted(f"@{name}" for name in bundled_names())
    assert main(["maps"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in listed)
    assert "8 x 4 m" in said
