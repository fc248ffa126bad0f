"""Legends, texts and axes, of which all recordings are made."""

import numpy as np
import pytest
import rerun as rr
from hypothesis import given, strategies as st
from recordings import written

from jaxcell.record.canvas.curves import curve_view
from jaxcell.record.canvas.matrix import log_matrix
from jaxcell.record.canvas.page import log_legend, log_tab, log_text
from jaxcell.record.canvas.palette import FREE, Level
from jaxcell.record.canvas.plot import ticks
from jaxcell.record.canvas.scale import Scale
from jaxcell.record.canvas.stream import recording


def logged(log):
    """The recording of a function that logs."""

    def write(path):
        with recording(path, "page") as stream:
            log(stream)

    return written(write)


def test_a_label_stands_beside_its_color_however_long_it_is():
    names = "sea", "a vertex, larger with more time there"
    logged_page = logged(
        lambda stream: log_legend(stream, "legend", [(one, FREE) for one in names])
    )
    at = np.array(logged_page.static("/legend/text", "Points2D:positions"))[:, 0]
    lines = np.array(logged_page.static("/legend/swatch", "LineStrips2D:strips"))
    assert len(lines) == 2
    # The viewer centres a label, with letters some 6 points wide and a row 40 points high at most.
    begins = at - np.array([len(one) for one in names]) * 6 / 40 / 2
    np.testing.assert_allclose(begins, lines[:, 1, 0] + 0.4, atol=1e-6)


def test_levels_of_a_scale_make_one_bar_of_colors():
    scale = Scale.over(np.array([0.0, 8.0]), "{} h".format, special={"never": FREE})
    legend = scale.legend()
    assert [label for label, _ in legend] == ["8 h", "6 h", "4 h", "2 h", "0 h", "never"]
    assert [isinstance(one, Level) for one in legend] == [True] * 5 + [False]
    logged_page = logged(lambda stream: log_legend(stream, "legend", legend))
    height = np.array(logged_page.static("/legend/swatch", "LineStrips2D:strips"))[:, 0, 1]
    *bar, last = height.tolist()
    assert last == 5
    np.testing.assert_allclose(np.diff(bar), bar[1] - bar[0], rtol=1e-5)
    assert (bar[0] + bar[-1]) / 2 == 2
    colors = logged_page.static("/legend/swatch", "LineStrips2D:colors")
    assert len(set(colors[:-1])) > 20


@given(st.integers(0, 3), st.integers(0, 5000), st.sampled_from([8, 250]))
def test_levels_of_whole_numbers_are_named_by_those_that_they_hold(least, most, levels):
    scale = Scale.counting(least, most, levels=levels)
    classes, special = scale.classes, 1
    assert len(classes) <= special + levels
    every = np.arange(least, max(least, most) + 1)
    for number, level in zip(every.tolist(), scale.levels(every).tolist(), strict=True):
        label = classes[level].label.replace(",", "")
        first, _, last = label.partition(" to ")
        assert int(first) <= number <= int(last or first)
    if every.size <= levels:
        assert [one.label.replace(",", "") for one in classes[special:]] == [*map(str, every)]
    names = {one.label for one in classes}
    assert {label for label, _ in scale.legend()} <= names


def test_a_text_has_a_tab_for_each_section():
    views = []
    text = "# A run\n\nIt moves.\n\n## How to look\n\n- **dots**\n\n## Made with\n\na map"
    logged_page = logged(lambda stream: views.append(log_text(stream, "text", text)))
    assert logged_page.text() == text
    (tabs,) = views
    assert [one.name for one in tabs.contents] == ["What you see", "How to look", "Made with"]
    assert isinstance(
        log_text(rr.RecordingStream("page"), "text", "# A run"), type(tabs.contents[0])
    )


def test_a_tab_needs_no_text():
    logged_page = logged(lambda stream: log_tab(stream, "", "Tab", [], "", [("sea", FREE)]))
    assert not any(
        "text" in one.removeprefix("/legend") for one in logged_page.entities - {"/legend/text"}
    )


def test_a_matrix_of_one_number():
    legends, values = [], np.array([[2.0, np.nan]])
    matrix = "m", "times", values, ["a"], ["b", "c"], "steps"
    logged_page = logged(lambda stream: legends.append(log_matrix(stream, *matrix)[1]))
    assert [label for label, _ in legends[0]] == ["2 steps"]
    assert logged_page.static("/m/labels", "Points2D:labels") == ["a", "b", "c"]
    assert logged_page.static("/m/numbers", "Points2D:labels") == ["2"]


@pytest.mark.parametrize(("most", "end"), [(1, 10.5), (2.0, 2.1), (40, 42.0), (0.5, 1.05)])
def test_the_axis_of_a_count_is_long_enough_for_whole_numbers(most, end):
    view = curve_view("curve", "Bumps so far", 5, most)
    (axis,) = (one for name, one in view.properties.items() if name == "ScalarAxis")
    np.testing.assert_allclose(axis.range.as_arrow_array().to_pylist()[0], (0, end))


@pytest.mark.parametrize(
    ("most", "expected"),
    [(1, [0, 0.2, 0.4, 0.6, 0.8, 1]), (500, [0, 100, 200, 300, 400, 500]), (7, [0, 2, 4, 6])],
)
def test_ticks_are_round(most, expected):
    assert ticks(most) == pytest.approx(expected)
