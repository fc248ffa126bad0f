"""The first lines of an answer about drifters."""

import numpy as np
import pytest
from seas import sea

from jaxcell import drift
from jaxcell.mapping import ChainSequence


DAY = 24.0


def stream(records, hours, speed=0.02):
    """Water that goes to the East, faster in the North, in some records."""
    east = np.broadcast_to(np.linspace(0.5, 1.5, 6)[:, None] * speed, (records, 6, 9))
    return sea(east * (1 + 0.1 * np.arange(records)[:, None, None]), 0 * east, hours=hours)


def answer_of(currents, duration=None, **options):
    step = drift.METHODS["drifters"].lasting(duration)
    return drift.SeaDrift.of(currents, step, **options).with_closed_sets(2)


@pytest.mark.parametrize(
    ("records", "hours", "options", "beginning", "end"),
    [
        (1, 1.0, {}, "There is one record: the answer is for 4 days of a steady", " current."),
        (4, 1.0, {}, "The records cover 4 h, and the answer is about 4 days, as if the current "
         "repeated itself after them", "is no multiple of a day or of a tide (12.4 h)."),
        (4, 6.0, {}, "The records cover 24 h", "the current repeated itself after them."),
        (5, 2.5, {}, "The records cover 12.5 h, ", "the current repeated itself after them."),
        (4, 1.0, {"mean": True}, "The records cover 4 h, ", " in the mean of the records."),
        (16, 6.0, {}, "After 4 days of drifters released in all cells, ", "have left the map."),
    ],
)  # fmt: skip
def test_an_answer_beyond_the_records_begins_with_that(records, hours, options, beginning, end):
    found = answer_of(stream(records, hours), until=4 * DAY, **options)
    assert found.answer[0].startswith(beginning)
    assert found.answer[0].endswith(end)


def test_until_is_the_time_of_the_answer():
    currents = stream(4, 6.0)
    whole, limited = answer_of(currents), answer_of(currents, until=2 * DAY)
    assert limited.asked_hours == 48 < whole.asked_hours
    assert limited.compared_hours[-1] == 48
    assert any("(median)" in line for line in whole.answer)
    assert not any("(median)" in line for line in limited.answer)


def test_the_answer_says_where_drifters_go_and_how_sure_that_is():
    found = answer_of(stream(4, 6.0), until=4 * DAY)
    assert len(found.answer) == 6
    gathering, leaving, sure, groups, drops = found.answer[1:]
    gone = found.layers[0].compared.drifters_left[-1]
    assert f"{gone:.0%} have left the map" in gathering
    assert "in set 0 around 33" in gathering
    assert "a day)" in gathering
    assert f"{gone:.0%} after 4 days" in leaving
    assert f"{found.distance:.0%} after 4 days (by chance {found.distance_noise:.1%})" in sure
    assert f"{found.markov_test.apart:.0%}" in sure
    assert groups.count("by a step of") == 3
    covered = found.curve.covered
    assert f"1 reaches {covered[0] / found.cells:.0%}" in drops
    assert "reach 100% of the cells" in drops


def test_the_answer_says_what_leaves_within_a_long_first_step():
    found = answer_of(stream(1, 1.0), duration=3600 * DAY, until=4 * DAY)
    surface = found.layers[0]
    alone = drift.Replay.of(surface.water, surface.flow, [6.0])
    gone = 1 - alone.share(6.0, surface.cells).sum()
    leaving = found.answer[2]
    assert gone > 0.01
    assert leaving.startswith(f"What leaves the map: {gone:.0%} after 6 h, ")
    assert "after 24 h (by the map" in leaving


def test_groups_and_times_of_half_and_double_the_step_are_those_of_their_maps():
    found = answer_of(stream(1, 1.0), until=4 * DAY)
    surface = found.layers[0]
    table = found.sensitivity_duration, found.sensitivity_groups, found.sensitivity_median_hours
    np.testing.assert_allclose(table[0], np.array([0.5, 1, 2]) * found.step)
    for seconds, groups, hours in zip(*table, strict=True):
        chain = drift.drift_maps(surface.water, surface.by, surface.step.lasting(seconds))
        behaviour = drift.long_term_behaviour(chain, seconds)
        assert groups == behaviour.groups.count
        transient = np.asarray(behaviour.groups.group) < 0
        assert hours == pytest.approx(np.median(np.asarray(behaviour.hours)[transient]))


@pytest.mark.parametrize("wanted", [0.1, 200.0])
def test_a_diffusivity_below_that_of_the_grid_is_not_called_diffusion(wanted):
    step = drift.METHODS["drifters"].lasting(6 * 3600.0)
    found = drift.SeaDrift.of(stream(1, 1.0), step, diffusivity=wanted, until=2 * DAY)
    assert found.grid_diffusivity == pytest.approx(1000**2 / (12 * 6 * 3600))
    assert found.diffusivity == wanted
    begins = {
        0.1: "This map does not show a diffusion of 0.1 m²/s: the grid alone",
        200.0: "Drifters diffuse by 200 m²/s, to which the grid adds 3.86 m²/s.",
    }
    assert found.answer[-1].startswith(begins[wanted])


def test_the_grid_spreads_drifters_as_its_diffusivity_says():
    # Over all parts of a cell by which drifters may go in a step.
    seconds, steps, spread = 6 * 3600.0, 60, []
    for part in (0.05, 0.25, 0.45, 0.65, 0.85):
        currents = sea(np.full((3, 90), part * 1000 / seconds), np.zeros((3, 90)))
        water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        layer = drift.Layer.of(water, flow, drift.METHODS["drifters"].lasting(seconds))
        begin = np.zeros(water.cells)
        begin[water.number[1, 2]] = 1
        *_, later = ChainSequence.of([layer.behaviour.chain]).pushed(begin, steps)
        mean = later @ water.column
        spread.append(later @ (water.column - mean) ** 2 * 1000**2 / (2 * steps * seconds))
    assert np.mean(spread) == pytest.approx(layer.grid_diffusivity, rel=0.05)
