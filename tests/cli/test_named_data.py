"""Studies in Python take the names of bundled data, as the command does."""

import pytest

from jaxcell import bundled, study


ROBOT = {"bounces": (45,), "error": 45.0, "reliability": 0.8}


def test_a_study_takes_the_name_of_a_map():
    named = study.Cover(map="@lab_a", **ROBOT)
    assert named == study.Cover(map=bundled("lab_a"), **ROBOT)
    assert named.cells().positions == 19


def test_a_name_that_does_not_exist_is_refused():
    with pytest.raises(FileNotFoundError, match="not among the bundled data"):
        study.Cover(map="@lab_z", **ROBOT)
