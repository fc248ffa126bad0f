"""The first lines of an answer about drifters."""

from pathlib import Path

import numpy as np
import pytest
from seas import double_gyre, sea

from jaxcell import drift, study
from jaxcell.base.formatting import in_time
from jaxcell.base.quantities import quantities
from jaxcell.mapping import ChainSequence


DAY = 24.0


class Studied(study.Drift):
    """The study of currents in memory."""

    def __init__(self, currents):
        super().__init__(file=(Path("memory"),))
        object.__setattr__(self, "_currents", currents)

    def currents(self):
        return self._currents


def stream(records, hours, speed=0.02):
    """Water that goes to the East, faster in the North, in some records."""
    east = np.broadcast_to(np.linspace(0.5, 1.5, 6)[:, None] * speed, (records, 6, 9))
    return sea(east * (1 + 0.1 * np.arange(records)[:, None, None]), 0 * east, hours=hours)


def basins(records, hours, speed=0.02):
    """Two slow gyres side by side, in some records."""
    gyres = double_gyre(8, 16)
    east, north = (speed * gyres[name].values[0] for name in "uv")
    season = 1 + 0.1 * np.arange(records)[:, None, None]
    return sea(season * east, season * north, hours=hours)


def answer_of(currents, duration=None, **options):
    step = drift.METHODS["drifters"].lasting(duration)
    return drift.SeaDrift.of(currents, step, **options).with_closed_sets(2)


@pytest.mark.parametrize(
    ("records", "hours", "options", "beginning", "end"),
    [
        (1, 1.0, {}, "There is one record: the answer is for 4 days of a steady", " current."),
        (4, 1.0, {}, "The records cover 4 h, 2011-07-01 00:00 to 2011-07-01 03:00, and the answer "
         "is about 4 days, as if the current repeated itself after them",
         "is no multiple of a day or of a tide (12.4 h)."),
        (4, 6.0, {}, "The records cover 24 h", "the current repeated itself after them."),
        (5, 2.5, {}, "The records cover 12.5 h, ", "the current repeated itself after them."),
        (4, 1.0, {"mean": True}, "The records cover 4 h, ", " in the mean of the records."),
        (16, 6.0, {}, "After 4 days of drifters released in all cells ", "have left the map."),
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
    for found in (whole, limited):
        (line,) = (line for line in found.answer if "(median)" in line)
        assert line.startswith("If the records repeat forever: ")


def test_a_time_that_is_no_whole_number_of_steps_is_explained():
    """Steps of 5 h: the nearest of them to 48 h is 50 h, ten steps."""
    currents = stream(4, 5.0)
    found = answer_of(currents, 5 * 3600.0, until=2 * DAY)
    assert found.asked_hours == 50
    assert "The answer is for 50 h, not 48 h: 10 whole steps of 5 h; --duration sets the step." in (
        found.answer
    )
    exact = answer_of(currents, 5 * 3600.0, until=50.0)
    assert not any("whole steps" in line for line in exact.answer)


def test_the_answer_says_where_drifters_go_and_how_sure_that_is():
    found = answer_of(basins(4, 6.0), until=4 * DAY)
    assert len(found.answer) == 6
    gathering, leaving, sure, forever, drops = found.answer[1:]
    gone = found.layers[0].compared.drifters_left[-1]
    assert f"{gone:.0%} have left the map" in gathering
    assert "in set 0 around 33" in gathering
    sets = found.nearly_closed_sets
    assert sets.window_hours == pytest.approx(found.asked_hours, abs=found.step / 3600)
    window = in_time(sets.window_hours)
    own = f"(of its own drifters {sets.leakage[0]:.1%} are outside it after {window})"
    assert own in gathering
    assert f"{gone:.0%} after 4 days" in leaving
    assert f"{found.distance:.0%} after 4 days (by chance {found.distance_noise:.1%})" in sure
    assert f"{found.markov_test.apart:.0%}" in sure
    assert forever.startswith("If the records repeat forever: ")
    assert forever.count("by a step of") == 3
    covered = found.curve.covered
    assert drops.startswith("If the records repeat forever, drifters can ever reach, ")
    assert f"from 1 cell {covered[0] / found.cells:.0%}" in drops
    assert drops.endswith("100% of the cells.")


def test_a_set_is_named_by_the_place_where_its_drifters_are():
    """In u = -k (x - a) each drifter comes to a, away from the middle of the sea.

    The closed form is x(t) = a + (x(0) - a) exp(-k t), which is within 90 m after three days.
    """
    column, row = np.meshgrid(np.arange(30), np.arange(20))
    east, north = (-2e-5 * 1000 * away for away in (column - 24.0, row - 4.0))
    found = answer_of(sea(east, north), 4 * 3600.0, until=3 * DAY, start=45)
    found = found.with_closed_sets(1)
    lon, lat = -118 + 24 * 0.0107, 33 + 4 * 0.009
    place = f"around {lat:.2f}° N {-lon:.2f}° W"
    dropped, _, gathering = found.answer[:3]
    assert dropped.startswith(f"Dropped at the start, after 3 days 100% are in set 0 {place}; 0%")
    assert f"100% in set 0 {place} (" in gathering
    sets = found.nearly_closed_sets
    np.testing.assert_allclose((sets.lon[0], sets.lat[0]), (lon, lat), atol=1e-3)


def test_nothing_about_the_long_run_is_said_without_that():
    described = quantities(drift.SeaDrift)
    for name in ("mean_leaving", "median_hours", "reached_cells", "sensitivity_median_hours"):
        assert described[name].meaning.startswith("in the long run: ")
    for name in ("drifter_count", "fewest_count", "curve_covered", "reached"):
        assert "can ever" in described[name].meaning


def test_daily_records_of_ordinary_size_have_sets_and_a_curve():
    # 1,600 cells at 46 records: 73,600 states.
    x, y = np.meshgrid(np.arange(40) / 10, np.arange(40) / 10)
    east = np.sin(np.pi * x / 2) * np.cos(np.pi * y / 2)
    north = -np.cos(np.pi * x / 2) * np.sin(np.pi * y / 2)
    season = 1 + 0.2 * np.sin(np.arange(46))[:, None, None]
    currents = sea(0.1 * season * east, 0.1 * season * north, hours=24.0)
    study = Studied(currents)
    found = study.run()
    assert found.layers[0].behaviour.unrolled.cells > 30_000
    assert found.nearly_closed_sets.leakage.size == 3
    assert found.curve is not None


def test_work_that_is_left_out_is_foretold_and_said(monkeypatch):
    monkeypatch.setattr("jaxcell.drift.results.sea_drift.LONGEST", 0.0)
    found = Studied(stream(4, 6.0)).run()
    assert found.curve is None
    assert found.nearly_closed_sets is None
    assert any("--nearly-closed 3 finds them" in remark for remark in found.remarks)
    assert any("jaxcell.drift.coverage_curve computes" in remark for remark in found.remarks)


def test_a_part_that_loses_half_of_its_drifters_is_not_called_nearly_closed():
    # In ten days water goes through the whole basin.
    found = answer_of(stream(4, 6.0), until=10 * DAY)
    assert not found.nearly_closed_sets.leakage.size
    assert any(remark.startswith("No nearly closed set was found") for remark in found.remarks)
    assert "set 0" not in found.answer[1]


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
    assert any(line.startswith(begins[wanted]) for line in found.answer)


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
