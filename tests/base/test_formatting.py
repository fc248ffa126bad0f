import math

import pytest

from jaxcell import examples
from jaxcell.base.formatting import format_value
from jaxcell.base.quantities import quantity


@pytest.mark.parametrize(
    ("value", "kind", "units", "text"),
    [
        (0, "position", None, "position 0"),
        (-1, "position", None, "none"),
        (-1, "count", None, "-1"),
        (1234567, "count", None, "1,234,567"),
        (2.5, "number", "m", "2.5 m"),
        (22.2868, "number", "steps", "22.3 steps"),
        (22_286.8, "number", "m", "22,287 m"),
        (-118.0126, "number", "degrees_east", "-118.013°"),
        (33.3333, "coordinate", "m", "33.3333 m"),
        (0.999_96, "share", "1", "over 99.9 %"),
        (1 - 1e-16, "share", "1", "100 %"),
        (90.0, "time", "s", "90 s"),
        (7200.0, "time", "s", "2 h"),
        (30.0, "time", "h", "30 h"),
        (360.0, "time", "h", "15 days"),
        (0.25, "share", "1", "25 %"),
        (-0.0, "number", "m", "0 m"),
        (-0.0, "share", "1", "0 %"),
        (-1e-17, "share", "1", "0 %"),
        (-0.0, "residual", None, "0.0e+00"),
        (math.inf, "time", "h", "never"),
        (math.nan, "time", "h", "none"),
        (1e-13, "residual", None, "1.0e-13"),
        (True, "flag", None, "yes"),
    ],
)
def test_a_value_as_people_read_it(value, kind, units, text):
    assert format_value(value, quantity("", "what it is", units, kind=kind)) == text


def test_places_in_cells_have_their_poses():
    cells = examples.corridor()
    of_kind = {
        kind: format_value([0, -1], quantity("k", "where", kind=kind), cells)
        for kind in ("cell", "position", "place")
    }
    assert of_kind == {
        "cell": "0.5 m, 0.5 m, heading 0° (cell 0); none",
        "position": "0.5 m, 0.5 m (position 0); none",
        "place": "(0.5 m, 0.5 m), none",
    }


def test_a_long_list_is_cut_between_values():
    about = quantity("k", "numbers", kind="count")
    text = format_value(list(range(1000)), about)
    *shown, rest = text.split(", ")
    assert shown == [str(k) for k in range(len(shown))]
    assert rest == f"and {1000 - len(shown)} more"
    assert format_value([], about) == "none"
