"""Objects that public functions return have a short text, HTML and plots."""

import ast
import dataclasses
import importlib
import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot

from jaxcell import (
    bounce,
    drift,
    dynamics,
    examples,
    mapping,
    markov,
    optimize,
    space,
    study,
)
from jaxcell.base.shown import Pictured, Shown


PACKAGES = [
    *("automata", "bounce", "drift", "dynamics", "mapping", "markov", "optimize", "patrol"),
    *("patrol.files", "patrol.law", "patrol.map", "patrol.perimeter", "patrol.team"),
    *("patrol.walks", "record", "robot", "space", "study", "sweep", "verify", "walls"),
]
# A random walk on a line of 5 cells.
P = np.diag([0.5, 0, 0, 0, 0.5]) + np.diag([0.5] * 4, 1) + np.diag([0.5] * 4, -1)
LAB = examples.lab()
GROUPS = bounce.bounce_groups(LAB, math.pi / 4)
THINGS = [
    LAB,
    LAB.room,
    GROUPS,
    bounce.bounce_map(LAB, math.pi / 4),
    mapping.Chain.from_scipy(P),
    mapping.persistent_groups(P),
    markov.hitting_times(P, 4),
    markov.leading_modes(P, 2),
    markov.limiting_distribution(P),
    optimize.Graph([[0, 1], [1, 2], [2, 0]]),
    optimize.minimum_commute([[0, 1], [1, 2], [2, 0]]),
    study.Cover(map=LAB, bounce=(45.0, 90.0), errors=("turn=45",), reliability=0.7).run(),
    examples.ring(),
    space.Box([-2, -2], [2, 2], [200, 200]),
    space.Motion(0.5),
]


def public_values():
    for package in PACKAGES:
        module = importlib.import_module(f"jaxcell.{package}")
        for name in dir(module):
            if not name.startswith("_"):
                yield getattr(module, name)


def returned():
    """The public dataclasses in the return annotations of public functions and methods."""
    values = [*public_values()]
    classes = {one.__name__: one for one in values if inspect.isclass(one)}
    classes = {
        name: one
        for name, one in classes.items()
        if dataclasses.is_dataclass(one) and not issubclass(one, study.Study)
    }
    functions = [one for one in values if inspect.isroutine(one)]
    for one in classes.values():
        functions += [
            getattr(member, "fget", None) or getattr(member, "func", None) or member
            for name, member in inspect.getmembers(one)
            if not name.startswith("_")
        ]
    words = {
        word
        for function in functions
        if callable(function)
        for word in re.findall(
            r"\w+", str(getattr(inspect.unwrap(function), "__annotations__", {}).get("return"))
        )
    }
    return [classes[name] for name in sorted(words & set(classes))]


def test_every_returned_class_has_a_short_text_and_html():
    kinds = returned()
    assert len(kinds) > 100
    assert [kind for kind in kinds if not issubclass(kind, Shown)] == []


@pytest.mark.parametrize("thing", THINGS, ids=lambda one: type(one).__name__)
def test_texts_are_short_and_html_describes_the_fields(thing):
    lines = repr(thing).splitlines()
    assert len(lines) <= 5
    assert all(len(line) <= 104 for line in lines)
    assert type(thing).__name__ in lines[0]
    assert "<table>" in thing._repr_html_()
    assert ("<img" in thing._repr_html_()) == isinstance(thing, Pictured)
    pyplot.close("all")


def test_small_arrays_are_shown_and_large_ones_are_named():
    assert "group=int32[152]" in repr(GROUPS)
    assert "value=[0.2, 0.2, 0.2, 0.2, 0.2]" in repr(markov.limiting_distribution(P))


def test_groups_are_drawn_on_the_room_of_their_cells():
    ax = pyplot.figure().add_subplot()
    assert GROUPS.plot("step", ax=ax, on=LAB, direction=1) is ax
    squares = ax.images[0].get_array()
    np.testing.assert_array_equal(squares.mask, ~LAB.free)
    x, y, heading = LAB.centre(np.arange(LAB.size))
    east = np.isclose(heading, math.pi / 4)
    drawn = squares[y[east].astype(int), x[east].astype(int)]
    np.testing.assert_array_equal(drawn, np.asarray(GROUPS.step)[east])
    with pytest.raises(ValueError, match="on: expected a CellSpace, a Box or a Graph of 152 cells"):
        GROUPS.plot("step", on=examples.corridor())
    pyplot.close("all")


@pytest.mark.parametrize("package", ["examples", *PACKAGES])
def test_packages_list_only_what_they_define_or_export(package):
    module = importlib.import_module(f"jaxcell.{package}")
    path = Path(module.__file__)
    path = stub if (stub := path.with_suffix(".pyi")).exists() else path
    nodes = ast.parse(path.read_text()).body
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.level]
    own = {part.asname for node in imports for part in node.names if part.asname == part.name}
    own |= {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    own |= {node.target.id for node in nodes if isinstance(node, ast.AnnAssign)}
    listed = {name for name in dir(module) if not name.startswith("_")}
    assert listed == {name for name in own if not name.startswith("_")}


@pytest.mark.parametrize("package", ["examples", "markov.dense", "space.estimates"])
def test_modules_of_functions_list_only_these(package):
    module = importlib.import_module(f"jaxcell.{package}")
    nodes = ast.parse(Path(module.__file__).read_text()).body
    own = {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
    assert set(dir(module)) == {name for name in own if not name.startswith("_")}


def test_a_plan_names_its_ends_and_its_length():
    plan = bounce.plan(examples.corridor(), [math.pi], 0, 4)
    assert repr(plan).startswith("<Plan: 3 steps and 1 bump, turns by 180°, lead from 0.5 m")
    assert "(cell 0) to 1.5 m, 0.5 m, heading 180° (cell 4)" in repr(plan)


def test_systems_and_flows_are_shown_with_types_of_arrays():
    system = dynamics.System(math.sin, space.Box([0], [1], [9]), {"edge": 0.5}, about="A well.")
    flow = drift.Flow(np.zeros((1, 2, 21, 29)), np.zeros(1))
    assert "rate=float64[1, 2, 21, 29]" in repr(flow)
    for shown in (system, flow):
        assert "<table>" in shown._repr_html_()
