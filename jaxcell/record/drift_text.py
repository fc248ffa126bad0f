"""What a stranger reads beside the pictures of drifters, in Markdown."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .sea_drift import ALMOST_FOR_EVER
from .sea_map import SeaMap, place_name
from .texts import made_with


_MOST_ROWS = 24


def groups_text(sea: SeaMap, spec: Mapping[str, Any]) -> str:
    """What the pictures of groups show."""
    drift = sea.drift
    rows = ["| depth | cells | persistent groups: cells | one end | several ends |"]
    rows.append("| --- | --- | --- | --- | --- |")
    for water, behaviour in zip(drift.waters, drift.behaviours, strict=True):
        sizes = sorted(np.asarray(behaviour.groups.size).tolist(), reverse=True)
        listed = ", ".join(map(str, sizes[:6])) + (", ..." if len(sizes) > 6 else "")
        size, single = np.asarray(behaviour.transient.size), behaviour.transient.single
        rows.append(
            f"| {water.depth:g} m | {water.cells:,} | {behaviour.groups.count}: "
            f"{listed or 'none'} | {int(size[single].sum()):,} | {int(size[~single].sum()):,} |"
        )
    table = "\n".join(rows)
    return f"""# Where drifters end up

{_currents(sea)} The water is cut into cells. In one step of
**{drift.duration / 3600:.3g} hours** a drifter moves from its cell to where the mean current takes
it, or, for the current is not known exactly, to a cell beside that. So the sea is a *Markov chain*.

Sooner or later a drifter is in a *persistent group* of cells, which it never leaves, or off the
map. All other cells are *transient*.

{table}

- **Full colours**: persistent groups. **Pale colours**: cells from which a drifter ends in the
  group of that colour for sure. **White**: it may end in several ways. Hover over a cell to
  read in which.
- **Black dots** are drifters, released everywhere alike, that the current itself carries while it
  changes, without cells or disturbances: press play, and watch whether they gather as foretold.

{_warnings(sea)}

{made_with(spec)}"""


def currents_text(sea: SeaMap) -> str:
    """What the pictures of currents show."""
    currents, clock = sea.drift.currents, sea.clock
    notes = [f"- {note}" for note in currents.attrs["notes"].splitlines()]
    return f"""# The current

{_currents(sea)} Arrows show the records one after the other; after the last, the current stays as
it is. Faster water has longer arrows. Dots are drifters with their ways in the last
{clock.frame * 6} {clock.unit}s.

- towards the East: {currents.attrs["east_from"]}
- towards the North: {currents.attrs["north_from"]}
{chr(10).join(notes)}

Time 0 of `{clock.unit}` is {_moment(currents.time.values[0])}.
"""


def absorption_text(sea: SeaMap) -> str:
    """What the pictures of absorption times show."""
    rows = ["| depth | half of them within | longest | almost for ever |"]
    rows.append("| --- | --- | --- | --- |")
    for layer, behaviour in enumerate(sea.drift.behaviours):
        hours = np.asarray(behaviour.hours)
        hours, late = hours[hours > 0], int(sea.drift.almost_for_ever(layer).sum())
        if hours.size:
            longest = ALMOST_FOR_EVER * behaviour.duration / 3600
            told = [
                f"{one:.3g} h" if one <= longest else "almost for ever"
                for one in (float(np.median(hours)), float(hours.max()))
            ]
            times = f"{told[0]} | {told[1]} | {late:,} cells"
        else:
            times = "all are persistent | |"
        rows.append(f"| {sea.drift.depths[layer]:g} m | {times} |")
    caught = ""
    if any(sea.drift.almost_for_ever(layer).any() for layer in range(len(sea.drift.depths))):
        caught = (
            f"*Almost for ever* is more than {ALMOST_FOR_EVER:,} steps. Such cells are transient "
            "only because of disturbances that hardly ever follow on one another; take what holds "
            "drifters there for a persistent group."
        )
    return f"""# How long it takes

The *absorption time* of a cell is the expected time until a drifter from there is in a persistent
group, or off the map. Blue is soon, yellow is late; persistent cells are light.

{chr(10).join(rows)}

{caught}
"""


def deployment_text(sea: SeaMap) -> str:
    """What the pictures of the deployment show."""
    drift = sea.drift
    found = drift.deployment
    persistent = int((found.group >= 0).sum())
    views = ""
    if drift.views is not None:
        views = (
            f"\n**To see the sea bed** with a camera that sees {drift.reach:g} m far, one looks "
            f"from {drift.views.cover.size:,} places. Of several in one persistent group the "
            f"first is enough, for a drifter gets to the others: **{drift.views.cells.size:,}** "
            "drifters.\n"
        )
    curve = ""
    if drift.curve is not None:
        curve = (
            "\n**The curve** tells how many cells so many drifters may visit, if each is dropped "
            "where it adds most.\n"
        )
    rows = ["| number | place | group |", "| --- | --- | --- |"]
    for number, cell in enumerate(found.cells[:_MOST_ROWS].tolist()):
        lon, lat, _ = drift.place(cell)
        group = int(found.group[number])
        of = f"persistent {group}" if group >= 0 else f"transient {found.transient_group[number]}"
        rows.append(f"| {number + 1} | {place_name(lon, lat)} | {of} |")
    if found.cells.size > _MOST_ROWS:
        rows.append(f"| {found.cells.size - _MOST_ROWS:,} more | | |")
    return f"""# Where to drop drifters

Dropped at the black circles of the surface, **{found.cells.size:,}** drifters may come to every
cell, each within its own group: {persistent:,} are in persistent groups, one in each, and the
others cover the transient cells, those first from where it takes longest.

If it is enough that each cell may be visited from some drifter, whatever its group,
**{np.size(drift.minimum):,}** will do, and no fewer.
{views}{curve}
{chr(10).join(rows)}
"""


def reach_text(sea: SeaMap) -> str:
    """What the pictures of reachable cells show."""
    drift = sea.drift
    assert drift.reached is not None
    assert drift.start is not None
    keeping, changing = drift.reached
    lon, lat, _ = drift.place(drift.start)
    rows = ["| depth | keeps its depth | goes up and down | of |", "| --- | --- | --- | --- |"]
    for layer, depth in enumerate(drift.depths):
        stays, moves = (int(drift.of_layer(one, layer).sum()) for one in (keeping, changing))
        rows.append(f"| {depth:g} m | {stays:,} | {moves:,} | {drift.waters[layer].cells:,} |")
    return f"""# What may be reached

A drifter is dropped at **{place_name(lon, lat)}** (the dark blue dot).

- **Pale blue**: it dives to a depth at once, and stays there.
- **Yellow**: it only gets there if it also goes up and down on its way.

{chr(10).join(rows)}
"""


def voyage_text(sea: SeaMap, steps: int) -> str:
    """What the pictures of a voyage show."""
    drift = sea.drift
    voyage = drift.voyage
    assert voyage is not None
    hours = drift.duration / 3600
    lon, lat, depth = drift.place(int(np.flatnonzero(voyage.goal)[0]))
    rows = ["| | discounted | surest |", "| --- | --- | --- |"]
    ways = [voyage, drift.surest] if drift.surest is not None else [voyage]
    chance = [np.asarray(one.probability) for one in ways]
    rows.append("| mean chance | " + " | ".join(f"{one.mean():.4f}" for one in chance) + " |")
    rows.append(
        "| cells that surely arrive | "
        + " | ".join(f"{(one == 1).sum():,}" for one in chance)
        + " |"
    )
    released = "everywhere alike"
    if drift.start is not None:
        begin = drift.place(drift.start)
        released = f"at {place_name(*begin[:2])}"
        here = [one[drift.start] for one in chance]
        rows.append("| chance from the start | " + " | ".join(f"{one:.4f}" for one in here) + " |")
        times = [float(one.conditional_time[drift.start]) * hours for one in ways]
        rows.append("| hours, if it arrives | " + " | ".join(f"{one:.4g}" for one in times) + " |")
    if len(ways) == 1:
        rows = [row.rsplit("|", 2)[0] + "|" if "surest" in row else row for row in rows]
        rows[1] = "| --- | --- |"
    return f"""# A way to a goal

A drifter can go up, go down, or drift, one step of {hours:.3g} hours each. It is to come to the
**green** goal at {place_name(lon, lat)}, {depth:g} m deep. Depths are drawn farther apart than they
are; drag to turn the view.

- **Left**: the *value* of each cell, by value iteration. Yellow is good: near in time, and sure.
- **Right**: what to do there. **Upright arrows**: go down (dark blue) or up (light blue).
  **Vermilion arrows**: drift; the current goes that way. Grey: from there it never arrives.
- **Black dots** follow this policy for {steps:,} steps, released {released}.

The *discounted* policy weighs being sure against being early; the *surest* arrives most likely, and
then soonest.

{chr(10).join(rows)}
"""


def _currents(sea: SeaMap) -> str:
    """Which currents these are."""
    currents = sea.drift.currents
    times = currents.time.values
    source = currents.attrs["source"]
    if times.size == 1:
        return f"The current of `{source}` at {_moment(times[0])}."
    return (
        f"The current of `{source}`, {times.size} records from {_moment(times[0])} to "
        f"{_moment(times[-1])}."
    )


def _moment(time: np.datetime64) -> str:
    return f"{np.datetime_as_string(time, unit='m').replace('T', ' ')} UTC"


def _warnings(sea: SeaMap) -> str:
    lines = [
        f"- **{water.depth:g} m**: {one.warning}."
        for water, one in zip(sea.drift.waters, sea.drift.diagnoses, strict=True)
        if one.warning
    ]
    return "\n".join(["## Beware", "", *lines]) if lines else ""
