"""Results in a notebook: plots, HTML and short texts."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import pytest
from matplotlib import pyplot

from jaxcell import record, space
from jaxcell.base.quantities import Result, derived, quantity


ROOM = space.Workspace([(0, 0), (3, 0), (3, 2), (0, 2)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
CELLS = space.CellSpace.of(ROOM, cell=1.0, directions=4)


@dataclasses.dataclass(frozen=True, eq=False)
class Visits(Result):
    title: ClassVar[str] = "Visits of a robot"
    cells: space.CellSpace
    bounce: Annotated[np.ndarray, quantity("bounce", "bouncing angle", "degree", kind="coordinate")]
    share: Annotated[np.ndarray, quantity("bounce position", "share of time", "1", kind="share")]
    group: Annotated[np.ndarray, quantity("position", "group", kind="index")]
    path: Annotated[np.ndarray, quantity("time", "cells on the way", kind="cell")]
    steps: Annotated[int, quantity("", "steps", kind="count")]
    absent: Annotated[np.ndarray | None, quantity("position", "never asked for")] = None

    @derived("", "an expensive number")
    def costly(self) -> float:
        raise AssertionError("it was computed")


@pytest.fixture
def visits():
    share = np.linspace(0, 1, 10).reshape(2, 5)
    group = np.array([0, 0, 1, -1, 0])
    yield Visits(CELLS, np.array([45.0, 90.0]), share, group, np.array([0, 1, 2]), 7)
    pyplot.close("all")


def drawn(ax):
    """The squares of the first picture in axes, the lowest row first."""
    return ax.images[0].get_array()


def test_numbers_over_positions_lie_on_the_squares_of_the_room(visits):
    ax = record.plot(visits, "share", bounce=1)
    squares = drawn(ax)
    assert squares.shape == CELLS.free.shape
    np.testing.assert_array_equal(squares.mask, ~CELLS.free)
    for position in range(CELLS.positions):
        x, y, _ = CELLS.centre(position)
        assert squares[int(y), int(x)] == visits.share[1, position]
    assert ax.images[0].get_extent() == [0, 3, 0, 2]
    assert ax.get_title() == "share of time, bounce 90"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")


@pytest.mark.parametrize(("groups", "named"), [(10, 10), (14, 14), (30, 13)])
def test_each_color_is_one_group_or_is_said_to_be_several(groups, named):
    room = space.CellSpace.of_grid(np.ones((1, 60), bool), 1)
    group = np.minimum(np.arange(60), groups - 1)[::-1].copy()
    ax = Visits(room, np.zeros(1), np.zeros((1, 60)), group, np.zeros(1, int), 0).plot("group")
    image, legend = ax.images[0], ax.get_legend()
    seen = [tuple(color) for color in image.cmap(image.norm(image.get_array()[0]))]
    labels = [text.get_text() for text in legend.get_texts()]
    shown = [patch.get_facecolor() for patch in legend.get_patches()]
    assert len(set(shown)) == len(shown)
    assert len(labels) == named + (groups > named)
    more = {color for color, number in zip(seen, group, strict=True) if str(number) not in labels}
    assert len(more) == (groups > named)
    if more:
        assert dict(zip(labels, shown, strict=True))[f"{groups - named} more"] in more
    for label, color in zip(labels[:named], shown, strict=False):
        assert {str(n) for n, one in zip(group, seen, strict=True) if one == color} == {label}


def test_labels_of_equal_number_have_equal_colours_and_a_legend(visits):
    ax = record.plot(visits, "group")
    squares = drawn(ax).compressed()
    by_label = {label: set(squares[visits.group == label]) for label in (-1, 0, 1)}
    assert all(len(colours) == 1 for colours in by_label.values())
    assert len(set.union(*by_label.values())) == 3
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["0", "1", "none"]


def test_cells_over_time_are_a_path(visits):
    ax = record.plot(visits, "path", linestyle="--")
    x, y, _ = CELLS.centre(visits.path)
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), x)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), y)
    assert ax.lines[0].get_linestyle() == "--"


def test_the_given_axes_are_used(visits):
    ax = pyplot.figure().add_subplot()
    assert visits.plot("share", ax=ax) is ax


@dataclasses.dataclass(frozen=True, eq=False)
class Curves(Result):
    title: ClassVar[str] = "Curves & <b>lines</b>"
    size: Annotated[np.ndarray, quantity("size", "number of drifters", kind="coordinate")]
    covered: Annotated[np.ndarray, quantity("size", "cells that they visit", "cells")]
    each: Annotated[np.ndarray, quantity("robot size", "cells of each robot", "cells")]
    grid: Annotated[np.ndarray, quantity("row column", "a large table")]


def test_arrays_without_a_map_are_curves_lines_or_an_image():
    rng = np.random.default_rng(0)
    curves = Curves(np.array([1, 5, 20]), *map(rng.random, ((3,), (2, 3), (20, 30))))
    ax = curves.plot("covered")
    assert ax.get_xlabel() == "number of drifters"
    assert ax.get_ylabel() == "cells"
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), curves.size)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), curves.covered)
    lines = curves.plot("each").lines
    np.testing.assert_array_equal([line.get_ydata() for line in lines], curves.each)
    np.testing.assert_array_equal(drawn(curves.plot("grid")), curves.grid)
    pyplot.close("all")


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("shares", {}, ValueError, "shares: not an array of the result; expected one of share"),
        ("steps", {}, ValueError, "steps: not an array"),
        ("absent", {}, ValueError, "absent: not an array"),
        ("share", {"bounce": 2}, IndexError, "range"),
    ],
)
def test_quantities_without_a_plot_are_refused(visits, name, options, error, message):
    with pytest.raises(error, match=message):
        record.plot(visits, name, **options)


def test_html_is_escaped_and_needs_nothing_else():
    curves = Curves(np.array([1, 2]), np.zeros(2), np.zeros((1, 2)), np.zeros((9, 9)))
    text = curves._repr_html_()
    assert "Curves &amp; &lt;b&gt;lines&lt;/b&gt;" in text
    assert "cells that they visit [cells]" in text
    assert 'src="data:image/png;base64,' in text
    assert "http" not in text


def test_text_of_a_result_is_short_and_computes_nothing(visits):
    text = repr(visits)
    assert text.splitlines()[1:] == ["    steps: 7", "    arrays: bounce, share, group, path"]
    assert text.startswith("<Visits: Visits")


def test_without_the_viewer_a_plot_is_shown(visits, monkeypatch):
    monkeypatch.setattr("jaxcell.record.recordings.has_module", lambda name: False)
    assert record.show(visits).get_title().startswith("share of time")
