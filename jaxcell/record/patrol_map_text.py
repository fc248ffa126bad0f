"""What a stranger reads beside the pictures of robots that patrol a map, in Markdown."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .canvas.palette import robot_color
from .map_patrol import MapPatrol
from .patrol_attacks import Attacks
from .texts import made_with


_MOST_ROWS = 24


def patrol_text(patrol: MapPatrol, attacks: Attacks, spec: Mapping[str, Any]) -> str:
    """What the recording of a patrol shows."""
    attack = patrol.attack
    steps = int(attack.attack_times[0])
    caught, succeeded = int(attacks.caught[-1]), int(attacks.succeeded[-1])
    done = caught + succeeded
    who = "A robot patrols" if patrol.robots == 1 else f"{patrol.robots} robots patrol"
    assert patrol.cells.workspace is not None
    return f"""# Patrolling with limited visibility

{who} a map and see {patrol.reach:g} m far, but not through walls. At each cell a robot draws its
next step at random, so that nobody can know where it will be. {_divided(patrol)}

The map is {patrol.cells.workspace.describe()}. Squares of {patrol.cells.cell:g} m make
{patrol.cells.positions:,} cells, and {len(patrol.graph.edges):,} ways lead from one to the next.

An adversary attacks the cell at {_place(patrol, attack.target)} when nobody looks, and needs
{steps:,} steps. It is caught if a robot sees that cell by then: **{attack.exact[0]:.3f}** is the
probability, if the robots may be anywhere out of view when it begins. In this run it was caught
{caught} times in {done}. Successive attacks are not independent: a robot that was near still is.

## How to look

Press play, or drag the slider `step` at the bottom.

- **dots**: the robots, with their last steps and the outline of what they see. The squares that
  they see wholly have their colours.
- **the pink frame**: the target. The dot in it is yellow during an attack, then green if that was
  caught, and pink if not.
- **the curves**: the attacks so far.
- The tab **Cover**: cells from which a robot sees everything, one by one.
- The tab **Policies**: how often a robot takes each way.{_base_tab(patrol)}
- The tab **The target**: how soon a robot sees it, simulated, exact, and fitted.
- The tab **Vulnerability**: the same question for every cell.

{made_with(spec)}"""


def cover_text(patrol: MapPatrol, shown: int) -> str:
    """What the tab of the covers shows."""
    rows = ["| robot | cells of its cover | seen from none |", "| --- | --- | --- |"]
    for robot, policy in enumerate(patrol.policies[:_MOST_ROWS]):
        name = f"{robot} ({robot_color(robot)[0]})"
        rows.append(f"| {name} | {policy.cover.size} | {policy.uncovered.size} |")
    table = "\n".join(rows)
    how = (
        "Robot 0 takes, again and again, the cell from which most is seen that is not seen yet; "
        "robot 1 takes the second best one, and so on, so that their covers differ."
        if patrol.regions is None
        else "Each robot takes, again and again, the cell of its region from which most of it is "
        "seen that is not seen yet."
    )
    left = f" The first {shown} robots are shown." if shown < patrol.robots else ""
    return f"""# Cells from which all is seen

{how} The slider `step` goes through them, and faster the slider `cover`: choose it at the bottom
left, in the place of `step`.{left}

A square counts as seen if all that is free of it is within {patrol.reach:g} m and behind no wall:
it can lie partly in the outline and yet not be seen.

{table}
"""


def policies_text(patrol: MapPatrol, shown: int) -> str:
    """What the tab of the policies shows."""
    rows = [
        "| robot | steps there and back | its tour |",
        "| --- | --- | --- |",
    ]
    for robot, policy in enumerate(patrol.policies[:_MOST_ROWS]):
        tour = "none" if policy.tour is None else f"{policy.tour.size:,} steps"
        name = f"{robot} ({robot_color(robot)[0]})"
        rows.append(f"| {name} | {policy.commute_time:,.0f} | {tour} |")
    table = "\n".join(rows)
    left = f" The first {shown} robots are shown." if shown < patrol.robots else ""
    return f"""# How a robot walks

From a cell it takes each way with a probability in proportion to its weight. Wide yellow lines have
large weights.{left}

The shortest closed tour through the cells of the cover has at least a given share of the weight. Of
all such weights these are the ones with which it takes the fewest steps from one cell to another
and back, on average over all pairs of its cells.

{table}
"""


def regions_text(patrol: MapPatrol) -> str:
    """What the tab of the regions shows."""
    regions, after = patrol.regions, patrol.reassignment
    assert regions is not None
    rows = ["| robot | cells | of these in view of the base |", "| --- | --- | --- |"]
    for robot in range(min(patrol.robots, _MOST_ROWS)):
        cells = regions.cells(robot)
        name = f"{robot} ({robot_color(robot)[0]})"
        rows.append(f"| {name} | {cells.size} | {int(regions.view[cells].sum())} |")
    table = "\n".join(rows)
    text = f"""# A base station, and regions around it

The base station is at {_place(patrol, regions.base)}. It sees {int(regions.view.sum()):,} cells,
and nobody needs to patrol those, but for their rim, where robots come to report. The rest is
divided by the angle around the base station.

{table}
"""
    if after is None:
        return text
    (lost,) = set(range(patrol.robots)) - set(after.robot.tolist())
    return f"""{text}
## When robot {lost} is lost

A robot at work stays away from its contact cell for **{after.after:,}** steps or more with a
probability of 1 % at most. So much silence means that it is lost, and the others then divide the
map among themselves, as the second map shows. Each takes the region where it keeps most cells.
"""


def target_text(patrol: MapPatrol) -> str:
    """What the tab of the target shows."""
    attack = patrol.attack
    rows = ["| attack | exact | simulated | fitted |", "| --- | --- | --- | --- |"]
    columns = (attack.attack_times, attack.exact, attack.simulated, attack.fitted)
    for time, exact, simulated, fitted in zip(*(c.tolist() for c in columns), strict=True):
        last = "" if np.isnan(fitted) else f"{fitted:.4f}"
        rows.append(f"| {time} steps | {exact:.4f} | {simulated:.4f} | {last} |")
    table = "\n".join(rows)
    runs = np.asarray(attack.arrivals.time).size
    if attack.fit is None:
        fit = f"No generalized lambda distribution was fitted: {attack.failure}."
    else:
        law = attack.fit.law
        numbers = ", ".join(f"{x:.4g}" for x in (law.l1, law.l2, law.l3, law.l4))
        fit = (
            f"A generalized lambda distribution ({numbers}) was fitted to the runs, as in the "
            f"source. Its distribution function is up to {attack.fit.distance:.4f} from theirs, "
            "which is what the fit costs: the exact law needs neither."
        )
    return f"""# How soon a robot sees the target

The robots begin anywhere out of view of the cell at {_place(patrol, attack.target)}. The first
that comes into view catches the adversary.

The law of this time is computed **exactly**, and estimated by {runs:,} simulated runs. {fit}

## Probability of capture

{table}
"""


def vulnerability_text(patrol: MapPatrol) -> str:
    """What the tab of the vulnerability shows."""
    steps = int(patrol.attack.attack_times[0])
    caught, open_ = patrol.capture[0], patrol.contested
    worst = int(open_[caught[open_].argmin()])
    text = f"""# How vulnerable each cell is

The colour of a cell is the probability that an adversary who attacks it for {steps:,} steps is
caught, exactly. Dark cells are vulnerable.

The adversary knows how the robots walk, but not where they are. It would attack the cell at
{_place(patrol, worst)}, where it is caught with probability **{caught[worst]:.4f}**; the mean over
cells is {caught[open_].mean():.4f}.
"""
    game = patrol.game
    if game is None:
        return text
    rows = ["| share | how often | alone, at its worst cell |", "| --- | --- | --- |"]
    weights = np.asarray(game.commitment.weights).tolist()
    for share, often, least in zip(game.shares.tolist(), weights, game.least.tolist(), strict=True):
        rows.append(f"| {share:g} | {often:.4f} | {least:.4f} |")
    table = "\n".join(rows)
    return f"""{text}
## The best answer

The share of the weight on the tours can be chosen. The robots draw one of these shares each time;
the adversary knows how often each is drawn:

{table}

It attacks the cell at {_place(patrol, game.attacked)} and is caught with probability
**{game.commitment.value:.4f}**. No other mixture of these shares does better.
"""


def _divided(patrol: MapPatrol) -> str:
    if patrol.regions is None:
        return "Each walks over the whole map, and needs to hear of no other."
    return "Each has a region of its own, and reports to a base station."


def _base_tab(patrol: MapPatrol) -> str:
    if patrol.regions is None:
        return ""
    return "\n- The tab **Base and regions**: who patrols where, and what the base station sees."


def _place(patrol: MapPatrol, cell: int) -> str:
    x, y = patrol.xy[cell].tolist()
    return f"({x:g}, {y:g})"
