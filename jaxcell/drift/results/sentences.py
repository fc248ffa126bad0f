"""Results in words: where drifters end, when, how accurate the map is, and doubts about it."""

from typing import Any

import numpy as np

from ...base.formatting import in_time
from ..validation.distance import compared_hours


# The period of the principal lunar tide and of a day, in hours, and the tolerance of a multiple.
_CYCLES, _NEAR = (12.4206, 24.0), 0.05
# The numbers of drifters whose reach is named, and the largest number of named sets.
_FEW, _NAMED = (1, 2, 5, 10, 20, 50), 4
# The least share of drifters that leave by a way out for it to be named.
_NAMED_SHARE = 0.005
# Squares of shorter sides, in metres, are finer than the bundled coastline.
_FINE = 2000.0
# The largest number of remarks that are shown.
_MAX_REMARKS = 4


def answer(drift: Any) -> tuple[str, ...]:
    """Summarize the first layer of a [`SeaDrift`][jaxcell.drift.SeaDrift] in a few lines."""
    lines = [_dropped(drift), _beyond(drift), _whole_steps(drift)]
    lines += [_gathering(drift), _leaving(drift), _certainty(drift)]
    lines += [_diffusion(drift), _forever(drift), _reach(drift)]
    return tuple(line for line in lines if line is not None)


def _beyond(drift: Any) -> str | None:
    """Explain which current follows the last record; `None` if records cover the time asked for."""
    covered, asked = drift.covered_hours, drift.asked_hours
    if covered == 0:
        return f"There is one record: the answer is for {in_time(asked)} of a steady current."
    if asked <= covered * (1 + 1e-9):
        return None
    mean = drift.layers[0].by.period is None
    first, last = map(name_day, drift.currents.time.values[[0, -1]])
    begins = f"The records cover {in_time(covered)}, {first} to {last}, and the answer is about "
    begins += in_time(asked)
    if mean:
        return f"{begins} in the mean of the records."
    whole = any(abs(covered / cycle - round(covered / cycle)) <= _NEAR and covered >= cycle * 0.9
                for cycle in _CYCLES)  # fmt: skip
    period = "" if whole else "; this period is no multiple of a day or of a tide (12.4 h)"
    return f"{begins}, as if the current repeated itself after them{period}."


def _whole_steps(drift: Any) -> str | None:
    """Explain why the answer is not for the time asked for; `None` if it is."""
    wanted, hours = drift.until, drift.asked_hours
    if wanted is None or in_time(hours) == in_time(wanted):
        return None
    steps, step = round(3600 * hours / drift.step), in_time(drift.step / 3600)
    return (
        f"The answer is for {in_time(hours)}, not {in_time(wanted)}: {steps:,} whole steps of "
        f"{step}; --duration sets the step."
    )


def _dropped(drift: Any) -> str | None:
    """Describe where drifters from the start are at `asked_hours`; `None` without a start."""
    if drift.start is None:
        return None
    surface, sets = drift.layers[0], drift.nearly_closed_sets
    share = surface.by_release.replay.share(drift.asked_hours, surface.cells)
    label = np.full(surface.cells, -1) if sets is None else sets.labels[0]
    parts = []
    for number in np.unique(label).tolist():
        within = np.where(label == number, share, 0.0)
        if (held := within.sum()) >= _NAMED_SHARE:
            kind = f" in set {sets.rank[number]}" if number >= 0 else ""
            parts.append(
                (held, f"{held:.0%} are{kind} around {name_place(*surface.water.centre(within))}")
            )
    listed = "; ".join([text for _, text in sorted(parts, reverse=True)] or ["none is on the map"])
    gone = f"{1 - share.sum():.0%} have left the map"
    return f"Dropped at the start, after {in_time(drift.asked_hours)} {listed}; {gone}."


def _gathering(drift: Any) -> str:
    """Describe the shares of drifters in nearly closed sets and off the map at `asked_hours`."""
    surface = drift.layers[0]
    share = surface.compared.replay.share(drift.asked_hours, surface.cells)
    where = f"After {in_time(drift.asked_hours)} of drifters released in all cells"
    gone = f"{1 - share.sum():z.0%} have left the map"
    sets = drift.nearly_closed_sets
    if sets is None or not sets.layers[0].count:
        return f"{where} {share.sum():.0%} are on the map, and {gone}."
    label, parts = sets.labels[0], []
    shown, window = min(sets.layers[0].count, _NAMED), in_time(sets.window_hours)
    for number in range(shown):
        within = np.where(label == number, share, 0.0)
        held = float(within.sum())
        at = surface.water.centre(within) if held else (sets.lon[number], sets.lat[number])
        place = name_place(*at)
        parts.append(
            f"{held:.0%} in set {sets.rank[number]} around {place} (of its own drifters "
            f"{sets.leakage[number]:.1%} are outside it after {window})"
        )
    listed = "; ".join(parts)
    elsewhere = share.sum() - share[(label >= 0) & (label < shown)].sum()
    return f"{where}, {listed}; {elsewhere:.0%} elsewhere, and {gone}."


def _leaving(drift: Any) -> str:
    """Describe the shares that left the map of drifters that are released in all cells."""
    of, cells = drift.layers[0].compared, drift.layers[0].cells
    times = [
        f"{1 - of.replay.share(hour, cells).sum():z.0%} after {in_time(hour)}"
        for hour in compared_hours(drift.asked_hours)
        if hour < of.hours[0] * (1 - _NEAR)
    ]
    pairs = zip(of.hours.tolist(), of.drifters_left, of.map_left, strict=True)
    times += [
        f"{left:z.0%} after {in_time(hour)} (by the map {map:.0%})" for hour, left, map in pairs
    ]
    return f"What leaves the map: {', '.join(times)}."


def _certainty(drift: Any) -> str:
    """Describe the difference between the distributions of the map and of simulated drifters."""
    surface, test = drift.layers[0], drift.markov_test
    of, by = surface.compared, surface.by_release

    def wrong(variation: np.ndarray, noise: np.ndarray) -> str:
        trios = zip(of.hours.tolist(), variation, noise, strict=True)
        return ", ".join(
            f"{share:.0%} after {in_time(hour)} (by chance {chance:.1%})"
            for hour, share, chance in trios
        )

    one = wrong(*(np.median(shares, axis=0) for shares in (by.total_variation, by.noise)))
    where = (
        "at the start" if drift.start is not None else f"in one of {by.cells.size} cells, median"
    )
    sets = (
        ""
        if test is None or not test.hours.size
        else f"; shares that stay in a set are wrong by up to {test.apart:.0%}"
    )
    return (
        f"How sure: the map has drifters in a wrong cell: released {where}, {one}; released "
        f"everywhere, {wrong(of.total_variation, of.noise)}{sets}."
    )


def _forever(drift: Any) -> str:
    """Describe groups, times to reach them and ways out, without a limit of time."""
    surface = drift.layers[0]
    count = surface.persistent_groups
    text = f"{_always(drift)}: {count:,} persistent group{'s' * (count != 1)}"
    if surface.transient_hours.size:
        text += f", {in_time(surface.median_hours)} to a group or off the map (median)"
    by_step = drift.step_sensitivity
    if by_step is not None and by_step.duration is not None and by_step.groups is not None:
        steps = zip(by_step.duration.tolist(), by_step.groups, by_step.median_hours, strict=True)
        other = [
            f"{group:,} and {in_time(hours)} by a step of {in_time(seconds / 3600)}"
            for seconds, group, hours in steps
            if not np.isclose(seconds, drift.step)
        ]
        text += f" by a step of {in_time(drift.step / 3600)}; {'; '.join(other)}"
    ways = zip(drift.exit, surface.mean_by_way, strict=True)
    out = [f"{name} {share:.0%}" for name, share in ways if share >= _NAMED_SHARE]
    return f"{text}; ways out of the map: {', '.join(out)}." if out else f"{text}."


def _always(drift: Any) -> str:
    """Describe the current without a limit of time."""
    steady = drift.layers[0].by.period is None
    return f"If the {'mean current lasts' if steady else 'records repeat'} forever"


def _reach(drift: Any) -> str | None:
    """Describe the shares of cells that 1, 2, ... drifters can ever reach; `None` if unknown."""
    if (curve := drift.curve) is None:
        return None
    cells, last = drift.layers[0].cells, curve.covered.size
    counts = [count for count in _FEW if curve.covered[min(count, last) - 1] < curve.covered[-1]]
    shares = [
        f"from {count:,} cell{'s' * (count != 1)} {curve.covered[count - 1] / cells:.0%}"
        for count in [*counts[:4], last]
    ]
    return (
        f"{_always(drift)}, drifters can ever reach, with any probability and after any time: "
        f"{', '.join(shares)} of the cells."
    )


def _diffusion(drift: Any) -> str | None:
    """Compare the requested diffusivity with what the grid adds; `None` if none is requested."""
    wanted, grid = drift.diffusivity, drift.grid_diffusivity
    if wanted is None:
        return None
    if wanted < grid:
        return (
            f"This map does not show a diffusion of {wanted:g} m²/s: the grid alone spreads "
            f"drifters by {grid:.3g} m²/s; take smaller cells or a longer --duration."
        )
    return f"Drifters diffuse by {wanted:g} m²/s, to which the grid adds {grid:.3g} m²/s."


def name_place(lon: float, lat: float) -> str:
    """Format a position in degrees, to a hundredth, with its hemispheres."""
    lon = (lon + 180) % 360 - 180
    east, north = "W" if lon < 0 else "E", "S" if lat < 0 else "N"
    return f"{abs(lat):.2f}° {north} {abs(lon):.2f}° {east}"


def name_day(moment: np.datetime64) -> str:
    """Format a time to the minute."""
    return str(np.datetime_as_string(moment, unit="m")).replace("T", " ")


def name_length(kilometres: float) -> str:
    """Format a length in km, with three digits."""
    return f"{kilometres:.3g} km" if kilometres >= 0.01 else "under 10 m"


def remarks_on(drift: Any) -> tuple[str, ...]:
    """Describe the doubts about a result, those that change the answer most first."""
    of_layers = [remark for layer in drift.layers for remark in layer.remarks]
    remarks = [*drift.notices, *_coastline(drift), *of_layers]
    if len(remarks) > _MAX_REMARKS:
        more = f"and {len(remarks) - _MAX_REMARKS} more of that kind, at other depths."
        remarks[_MAX_REMARKS:] = [more]
    groups, known = drift.sensitivity_groups, drift.sensitivity_groups_if_known
    if groups is not None and known is not None and known[1] > groups[1] > 0:
        remarks.append(
            f"At {drift.depths[0]:g} m: by the centres of cells alone there are {known[1]} "
            f"persistent groups in place of {groups[1]}: their number depends on the grid; nearly "
            "closed sets depend on it less."
        )
    if drift.curve is None:
        remarks.append(
            "The numbers of cells that 1, 2, ... drifters can ever reach are left out: they take "
            f"about {drift.curve_seconds / 60:.0f} minutes; jaxcell.drift.coverage_curve computes "
            "them."
        )
    sets = drift.nearly_closed_sets
    if drift.sets_listed and sets is not None and not sets.leakage.size:
        remarks.append(
            "No nearly closed set was found: each part of the water that was tried loses half of "
            f"its drifters or more in {in_time(sets.window_hours)}; --until takes a shorter time."
        )
    voyages = [voyage for voyage in (drift.voyage, drift.surest) if voyage is not None]
    if not all(voyage.policy_certified and voyage.times_certified for voyage in voyages):
        remarks.append(
            "Results of voyages that are not certified exceed 64-bit numbers in some cells, "
            "because an eddy holds drifters almost forever; another duration may avoid this."
        )
    if not drift.answered:
        remarks.append("No policy brings a drifter from the start to the goal.")
    return tuple(remarks)


def _coastline(drift: Any) -> tuple[str, ...]:
    """Remark on a bundled coastline that is coarser than the squares of the grid."""
    side, notes = float(np.median(drift.waters[0].sides)), drift.currents.attrs.get("notes", "")
    if side >= _FINE or "Natural Earth" not in notes:
        return ()
    return (
        f"The squares of {side:.3g} m are finer than the bundled coastline, which is off by some "
        "kilometres: islands without data may count as open sea, through which drifters leave the "
        "map; give a finer coastline by --land, or --gaps land.",
    )
