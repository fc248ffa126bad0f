import math

import numpy as np
from recordings import read_back

from jaxcell.bounce.coverage import coverage_policy
from jaxcell.record.bounce.coverage import heat_levels, heat_scale


def test_heat_has_two_classes_to_a_doubling():
    scale = heat_scale(20.0)
    classes = scale.classes
    heat = np.array([0.0, 1e-9, 1 / 16, 0.0885, 1.0, 1.42, 1.99, 2.0, 31.9])
    labels = [classes[i].label for i in heat_levels(scale, heat)]
    assert labels == [
        "no time at all",
        "less than 1/16 of an even share",
        "0.0625 to 0.0884 times an even share",
        "0.0884 to 0.125 times an even share",
        "1 to 1.41 times an even share",
        "1.41 to 2 times an even share",
        "1.41 to 2 times an even share",
        "2 to 2.83 times an even share",
        "22.6 to 32 times an even share",
    ]
    assert len({one.color for one in classes[1:]}) == len(classes) - 1


def test_the_recording_shows_the_policy(policy):
    cells, recording = policy.cells, read_back(policy, {"map": "a map"})
    names = [*(f"coverage_{i}" for i in range(3)), "mixture", "target"]
    shares = [*np.asarray(policy.coverage), np.asarray(policy.mixture), np.asarray(policy.target)]
    scale = heat_scale(max(float(share.max()) for share in shares) * cells.positions)
    for name, share in zip(names, shares, strict=True):
        picture = recording.picture(f"/map/grid/{name}")
        assert recording.classes(f"/map/grid/{name}") == [one.label for one in scale.classes]
        expected = heat_levels(scale, share * cells.positions)
        np.testing.assert_array_equal(picture[cells.free], expected)
        assert (picture[~cells.free] == 0).all()

    for i, (groups, limiting) in enumerate(zip(policy.groups, policy.limiting, strict=True)):
        pictures = recording.labels(f"/map/grid/angle_{i}/groups", "direction")
        assert sorted(pictures) == list(range(cells.directions))
        shown = np.stack([pictures[k][cells.free] for k in range(cells.directions)]).ravel()
        group = np.asarray(groups.group)
        np.testing.assert_array_equal(shown == "transient", group < 0)
        likeliest = int(np.argmax(limiting.weights))
        assert set(shown[group == likeliest]) == {"on the likeliest persistent group"}
        assert all(len(set(shown[group == number])) == 1 for number in range(groups.count))
        pictures = recording.pictures("direction", f"/map/grid/angle_{i}/limiting")
        heat = (np.asarray(limiting.value) * cells.size).reshape(cells.directions, -1)
        scale = heat_scale(float(heat.max()))
        for k, picture in pictures.items():
            np.testing.assert_array_equal(picture[cells.free], heat_levels(scale, heat[k]))

    bars, share = recording.picture("/alpha/share"), 100 * np.asarray(policy.alpha)
    heights = bars.sum(axis=0) / bars.shape[0] * share.max()
    np.testing.assert_allclose(heights[2::5], share, atol=share.max() / 250)
    labels = recording.static("/alpha/labels", "Points2D:labels")
    assert labels[: share.size] == [f"{one:g}" for one in policy.bounce_deg.tolist()]
    text = recording.text()
    assert f"| 90° | {100 * float(policy.alpha[1]):.3g} % |" in text
    assert "| map | a map |" in text


def test_of_many_angles_those_with_the_largest_shares_have_maps(lab):
    bounces = np.radians(np.arange(0, 360, 45))
    many = coverage_policy(lab.cells, bounces, math.pi / 4, 0.6)
    recording = read_back(many)
    shown = {i for i in range(8) if f"/map/grid/coverage_{i}" in recording.entities}
    assert len(shown) == 6
    alpha = np.asarray(many.alpha)
    assert alpha[sorted(shown)].min() >= np.delete(alpha, sorted(shown)).max()
    assert "those of the 6 largest shares" in recording.text()
