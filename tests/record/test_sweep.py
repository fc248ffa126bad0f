import hypothesis.strategies as st
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from recordings import written

from jaxcell.record import log_sweep
from jaxcell.record.sweep.axes import QUANTILES, axes, means, pairs, statistics


def result(shape, coords, **variables):
    """The result of a sweep whose members are all done."""
    dims = tuple(shape)
    sizes = tuple(shape.values())
    arrays = {"status": (dims, np.ones(sizes, np.int8))}
    arrays |= {name: (dims, np.reshape(values, sizes)) for name, values in variables.items()}
    return xr.Dataset(arrays, coords, {"title": "Sweep of a test"})


def axis_of(values, most=1000):
    (axis,) = axes(result({"x": len(values)}, {"x": values}), most)
    return axis


def test_times_follow_from_values():
    whole = axis_of([30, -10, 20])
    assert (whole.timeline.name, whole.timeline.meaning) == ("x", "the value")
    assert whole.timeline.times.tolist() == [-10, 20, 30]
    assert whole.step.tolist() == [2, 0, 1]
    texts = axis_of(["b", "a"])
    assert (texts.labels, texts.step.tolist()) == (("b", "a"), [0, 1])
    for values, name, times in (
        ([0.1, 0.2, 1.5], "x x 10", [1, 2, 15]),
        (["b", "a"], "x number", [0, 1]),
        ([1e-30, 1e30], "x number", [0, 1]),
        ([1 / 3, 2 / 3], "x x 100000", [33333, 66667]),
    ):
        timeline = axis_of(values).timeline
        assert (timeline.name, timeline.times.tolist()) == (name, times)


def test_many_values_share_steps():
    axis = axis_of(np.arange(25)[::-1], most=10)
    assert axis.timeline.times.tolist() == list(range(0, 25, 3))
    assert axis.step.tolist() == [value // 3 for value in range(24, -1, -1)]
    shared = "the value; 3 neighbouring values share a step, at the first of them"
    assert axis.timeline.meaning == shared


def test_pairs_of_a_grid_with_samples():
    n = np.arange(4)
    coords = {"angle": [0, 1, 2], "sample": n, "a": ("sample", n / 2), "b": ("sample", n)}
    dimensions = axes(result({"angle": 3, "sample": 4}, coords), 1000)
    assert {axis.name for axis in dimensions[:3]} == {"angle", "a", "b"}
    assert dimensions[3].name == "sample"
    spanned = [{a.name, b.name} for a, b in pairs(dimensions, 9)]
    # The number of a sample comes last, and not with its own parameters.
    expected = [{"angle", "a"}, {"angle", "b"}, {"a", "b"}, {"angle", "sample"}]
    assert spanned[-1] == expected[-1]
    assert all(spanned.count(one) == 1 for one in expected)
    assert len(spanned) == 4
    assert pairs(dimensions, 2) == pairs(dimensions, 9)[:2]


@given(st.integers(0, 2**32), st.integers(1, 6), st.integers(1, 7), st.integers(1, 8))
def test_statistics_are_those_of_numpy(seed, rows, columns, most):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(rows, columns))
    known = rng.random((rows, columns)) < 0.7
    coords = {"x": rng.permutation(rows), "y": rng.permutation(columns) / 4}
    dimensions = axes(result({"x": rows, "y": columns}, coords), most)
    masked = np.where(known, values, np.nan)
    for place, axis in enumerate(dimensions):
        steps, quantiles, alone = statistics(values, known, place, axis)
        every = [np.compress(axis.step == k, masked, axis=place) for k in range(axis.steps)]
        members = {k: one[~np.isnan(one)] for k, one in enumerate(every) if not np.isnan(one).all()}
        assert steps.tolist() == list(members)
        assert alone == all(one.size < 2 for one in members.values())
        for column, one in zip(quantiles.T, members.values(), strict=True):
            np.testing.assert_allclose(column, np.quantile(one, [*QUANTILES.values()]))
    across, up = dimensions
    heat = means(values, known, (0, 1), (across, up))
    for i, j in np.ndindex(heat.shape):
        some = masked[np.ix_(across.step == j, up.step == i)]
        expected = np.nan if np.isnan(some).all() else np.nanmean(some)
        np.testing.assert_allclose(heat[i, j], expected, atol=1e-12)


@pytest.fixture(scope="module")
def sweep():
    """A grid of two parameters, with one member failed, one not computed, and one that is inf."""
    x, y = np.arange(0, 360, 30), [0.5, 1.5, 2.5]
    value = np.add.outer(x / 30, np.array(y) * 100)
    dataset = result({"x": 12, "y": 3}, {"x": x, "y": y}, value=value, other=value > 100)
    dataset["other"].attrs["units"] = "m"
    dataset["vector"] = (("x", "y", "z"), np.zeros((12, 3, 2)))
    dataset["status"][3, 1], dataset["status"][4, 1], dataset["value"][5, 1] = 2, 0, np.inf
    dataset.attrs["spec"] = '{"task": "test", "grid": {"x": [1, 2]}}'
    return dataset


@pytest.fixture(scope="module")
def recorded(sweep):
    return written(log_sweep, sweep, failures=["chunk 7: no luck"])


def test_series_run_along_each_parameter(sweep, recorded):
    assert recorded.timelines >= {"x", "y x 10"}
    known = sweep["value"].where((sweep["status"] == 1) & np.isfinite(sweep["value"]))
    for timeline, along, over, scale in ("x", "x", "y", 1), ("y x 10", "y", "x", 10):
        for name, share in QUANTILES.items():
            path = f"/series/value/{name.replace(' ', '_')}"
            curve = recorded.over(timeline, path, "Scalars:scalars")
            expected = known.quantile(share, over)
            np.testing.assert_allclose(
                [curve[at][0] for at in np.rint(sweep[along].values * scale)], expected
            )


def test_heat_maps_have_a_square_for_each_member(sweep, recorded):
    labels = recorded.labels("/heat/value/0/picture")
    for i in range(12):
        for j in range(3):
            # The greatest value of the parameter is on top.
            label = labels[2 - j, i]
            value = float(sweep["value"][i, j])
            if (i, j) in ((3, 1), (4, 1), (5, 1)):
                assert label == "none is done"
            else:
                low, high = map(float, label.split(" to "))
                assert low - 1 <= value <= high + 1
    sliders = recorded.over("x", "/pairs/0/slider_x", "LineStrips2D:strips")
    assert sorted(sliders) == sweep["x"].values.tolist()
    assert sliders[90][0][0][0] == pytest.approx(160 * 3.5 / 12)


def test_the_text_says_what_there_is(recorded):
    text = recorded.text()
    for part in (
        "**36 members** (12 x x 3 y)",
        "34 are done, **1 failed**, **1 are not computed yet**",
        "| `x` | the value | 0 | 330 |",
        "| `y x 10` | the value times 10 | 0.5 | 2.5 |",
        "| `value` | 50 | 261 |  (not finite, and not shown, for 1 members) |",
        "| `other` | 0 | 1 | in m |",
        "`vector`",
        "- chunk 7: no luck",
        "| grid.x | [1, 2] |",
    ):
        assert part in text


def test_recordings_of_large_sweeps_stay_small(monkeypatch):
    """Pictures and series are bounded, however many members there are."""
    monkeypatch.setattr("jaxcell.record.sweep.overview.PICTURE_BYTES", 40_000)
    rng = np.random.default_rng(0)
    n = 3000
    coords = {name: ("sample", rng.random(n)) for name in "abc"}
    names = [f"v{i}" for i in range(20)]
    dataset = result({"sample": n}, coords, **dict.fromkeys(names, rng.random(n)))
    recorded = written(log_sweep, dataset)
    pictures = [one for one in recorded.entities if one.endswith("/picture")]
    # Three pairs of parameters, of the variables that are shown.
    assert len(pictures) == 3 * 16
    layouts = [recorded.static(one, "SegmentationImage:format")[0] for one in pictures]
    size = sum(one["width"] * one["height"] for one in layouts)
    assert 0.9 * 40_000 < size <= 40_000
    (timeline,) = (one for one in recorded.timelines if one.startswith("a x "))
    assert len(recorded.over(timeline, "/series/v0/median", "Scalars:scalars")) == 1000
    text = recorded.text()
    assert "or are too many: `v16`, `v17`, `v18`, `v19`." in text


def test_other_datasets_than_sweeps_are_refused(tmp_path, sweep):
    path = tmp_path / "none.rrd"
    with pytest.raises(ValueError, match="which has a variable status"):
        log_sweep(path, sweep.drop_vars("status"))
    with pytest.raises(ValueError, match="expected a variable with a number for each member"):
        log_sweep(path, sweep[["status", "vector"]])
    assert not path.exists()


def test_nothing_done_and_one_value_alone():
    """A parameter of one value spans no picture; a variable without values has no series."""
    dataset = result({"x": 1, "y": 2}, {"x": [7], "y": ["a", "b"]}, value=[1.0, np.nan])
    one = written(log_sweep, dataset)
    assert one.over("y number", "/series/value/value", "Scalars:scalars") == {0: [1.0]}
    assert not any(entity.startswith("/heat") for entity in one.entities)
    dataset["status"][:] = 0
    assert written(log_sweep, dataset).entities
