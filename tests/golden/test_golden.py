"""The output of commands equals its golden file; `record_golden.py` records it again."""

from itertools import islice

import pytest
from golden import record_golden
from golden.plain import differences, load


_SHOWN = 12


@pytest.mark.parametrize("name", record_golden.NAMES)
def test_all_is_as_it_was(name):
    expected = load(record_golden.GOLDEN / f"{name}.json")
    tolerance = record_golden.tolerance(name)
    found = list(differences(expected, record_golden.record(name), tolerance))
    assert not found, "\n".join([f"{len(found)} differences:", *islice(found, _SHOWN)])


def test_each_case_has_its_file_and_each_file_its_case():
    names = {path.stem for path in record_golden.GOLDEN.glob("*.json")}
    assert names == set(record_golden.NAMES)
