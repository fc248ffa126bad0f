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
        "cell": "cell 0 (0.5 m, 0.5 m, 0°), none",
        "position": "position 0 (0.5 m, 0.5 m), none",
        "place": "(0.5, 0.5), none",
    }


def test_a_long_list_is_cut_between_values():
    about = quantity("k", "numbers", kind="count")
    text = format_value(list(range(1000)), about)
    *shown, rest = text.split(", ")
    assert shown == [str(k) for k in range(len(shown))]
    assert rest == f"and {1000 - len(shown)} more"
    assert format_value([], about) == "none"
