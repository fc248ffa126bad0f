"""The first line of a command on standard output is the answer, in units and with three digits."""

import re

import pytest

from jaxcell.base.doubts import Doubt
from jaxcell.base.formatting import counted, percent
from jaxcell.cli import main
from jaxcell.currents.sphere import warn_if_wide


ANSWERS = r"""
drifters @drifters --cell 5 --samples 2
    In the long run 0 % of the drifters have left the map \(90 % of estimates: 0 % to 0 %\).
morse henon --depth 4
    The recurrent points whose orbits stay in the box are in \d Morse sets? with .* % of the box.
patrol graph @eight --game --emphasis 2 5
    The best mixture .* pays the patroller 8, and .* alone 3.56; the adversary attacks vertex 5.
patrol graph @eight --strategy toward --vertex 3
    The walk takes 1.57 steps to vertex 3 in the mean.
"""
ROWS = ANSWERS.strip().splitlines()
PAIRS = [(line, answer.strip()) for line, answer in zip(ROWS[::2], ROWS[1::2], strict=True)]


@pytest.mark.parametrize(("line", "answer"), PAIRS, ids=ROWS[::2])
def test_the_first_line_is_the_answer(line, answer, capsys):
    assert main(line.split()) == 0
    first, *_ = capsys.readouterr().out.splitlines()
    assert re.fullmatch(answer, first), first


def test_a_share_is_100_percent_only_if_nothing_is_missing():
    assert [percent(share) for share in (0, 0.00123, 0.9996, 1)] == [
        *("0 %", "0.123 %", "over 99.9 %", "100 %")
    ]


def test_one_thing_is_in_the_singular():
    assert [counted(number, "bump") for number in (0, 1, 1.0, 2.5, 2000)] == [
        *("0 bumps", "1 bump", "1 bump", "2.5 bumps", "2,000 bumps")
    ]


def test_bounds_that_go_round_the_earth_are_doubted(recwarn):
    warn_if_wide((170, -60, -170, 60))
    warn_if_wide((-170, -60, 170, 60))
    assert not recwarn
    with pytest.warns(Doubt, match="from 20 eastward to 10 degrees goes 350 degrees round"):
        warn_if_wide((20, -60, 10, 60))
