import numpy as np
import pytest

from jaxcell import dynamics, study
from jaxcell.study.escape import region


def test_study_answers_as_the_function():
    found = study.Escape(
        system="well", noise=(0.5,), start=(-1.0,), into=("x>0",), cells=(60,)
    ).run()
    expected = dynamics.escape(
        study.Escape(system="well", noise=(0.5,), cells=(60,)).chosen,
        noise=0.5,
        start=[-1],
        into=lambda x: x[:, 0] > 0,
    )
    assert found.mean_time == expected.mean_time
    assert found.end == ("x>0",)


def test_leaving_a_region_is_entering_the_rest():
    about = {"system": "well", "noise": (0.5,), "start": (-1.0,), "cells": (60,)}
    one = study.Escape(leave="x<0", **about).run()
    other = study.Escape(into=("x>0",), **about).run()
    assert one.mean_time == pytest.approx(other.mean_time, rel=1e-6)


def test_conditions_of_a_region_hold_together():
    inside = region("angle<1, speed (rad/s)>2", ("angle (rad)", "speed (rad/s)"), "into")
    points = np.array([[0.0, 3.0], [0.0, 1.0], [2.0, 3.0]])
    assert inside(points).tolist() == [True, False, False]


def test_a_single_axis_is_also_called_x():
    inside = region("x<-2.995732", ("x0",), "into")
    assert inside(np.array([[-3.0], [0.0]])).tolist() == [True, False]
    with pytest.raises(ValueError, match="expected an axis among x0, x1, got 'x'"):
        region("x<1", ("x0", "x1"), "into")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x=0", "into: expected conditions NAME>NUMBER or NAME<NUMBER, got 'x=0'"),
        ("x>one", "into: expected conditions NAME>NUMBER or NAME<NUMBER, got 'x>one'"),
        ("y>0", "into: expected an axis among x, got 'y'"),
    ],
)
def test_wrong_conditions_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        study.Escape(system="well", noise=(0.5,), into=(text,)).run()


def test_lists_of_parameters_are_refused():
    with pytest.raises(ValueError, match="params: a: expected one value, got 3"):
        study.Escape(system="well", noise=(0.5,), into=("x>0",), params=("a=1:2:3",)).run()
