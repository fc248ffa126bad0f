"""Robots that patrol a map, and an adversary that attacks one cell of it again and again."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int, UInt8

from ...patrol import PatrolledMap, Policy
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap
from ..canvas.marks import log_frame, points
from ..canvas.page import log_tab
from ..canvas.palette import (
    CATEGORIES,
    CLEAR,
    FREE,
    KNOWN,
    PLAIN,
    ROBOTS,
    TARGET,
    TEXT,
    Color,
    PictureClass,
    mix,
    robot_color,
)
from ..canvas.prose import made_with
from .sight import BASE_VIEW, log_sight, place


WAITING, ATTACKING, CAUGHT, SUCCEEDED = range(4)
_STATES: list[tuple[str, Color]] = [
    ("the target: nobody attacks it", PLAIN),
    ("an attack goes on", CATEGORIES["yellow"]),
    ("it was caught", KNOWN),
    ("it succeeded", TARGET),
]
# About so many attacks are shown, as far as there are steps.
_ATTACKS = 30
_MIN_STEPS, _MAX_STEPS = 600, 1500
# Over all robots: an outline at each step is some hundreds of bytes.
_MAX_OUTLINES = 12_000
# How long it is shown how an attack ended, and the longest wait for the next.
_PAUSE, _WAIT = 8, 40
# Where a robot has been in its last steps.
_TRAIL = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Attacks:
    """Robots on patrol, and what the adversary does meanwhile."""

    place: Int[np.ndarray, "times robots"]
    "The cell of each robot."
    state: UInt8[np.ndarray, "times"]
    "Whether the adversary waits, attacks, has been caught or has succeeded."
    since: Int[np.ndarray, "times"]
    "The steps since the last attack began."
    caught: Int[np.ndarray, "times"]
    "How many attacks have failed by then."
    succeeded: Int[np.ndarray, "times"]
    "How many have not."


def simulate_attacks(patrol: PatrolledMap, seed: int) -> Attacks:
    """Move robots at random; attack the target, for the first attack time, when nobody looks.

    An attack fails if a robot has the target in view within the attack time.

    **Arguments:**

    - `patrol`: the patrol.
    - `seed`: of the robots and the adversary.
    """
    attack_time = int(patrol.attack.attack_times[0])
    steps = int(np.clip(_ATTACKS * (attack_time + _PAUSE + _WAIT // 2), _MIN_STEPS, _MAX_STEPS))
    steps = min(steps, max(_MAX_OUTLINES // patrol.robots, attack_time))
    random = np.random.default_rng(seed)
    place = np.stack([_walk(policy, random, steps) for policy in patrol.policies], axis=1)
    seen = patrol.attack.view[place].any(axis=1)
    state, since = np.zeros(steps + 1, np.uint8), np.zeros(steps + 1, np.int64)
    now, count, wait = WAITING, 0, int(random.integers(_WAIT))
    for time in range(steps + 1):
        if now == ATTACKING:
            count += 1
            if seen[time] or count == attack_time:
                now, wait = CAUGHT if seen[time] else SUCCEEDED, _PAUSE
        elif wait:
            wait -= 1
        elif now != WAITING:
            now, count, wait = WAITING, 0, int(random.integers(_WAIT))
        elif not seen[time]:
            now = ATTACKING
        state[time], since[time] = now, count
    begins = np.diff(state, prepend=np.uint8(WAITING)) != 0
    caught, succeeded = (np.cumsum(begins & (state == end)) for end in (CAUGHT, SUCCEEDED))
    return Attacks(place, state, since, caught, succeeded)


def log_attacks(
    map: CellMap, patrol: PatrolledMap, attacks: Attacks, spec: Mapping[str, Any]
) -> rrb.Container:
    """Log the tab of the patrol: the robots with what they see, the target, the attacks so far."""
    stream, times = map.stream, np.arange(len(attacks.place))
    _log_seen(map, patrol, attacks)
    for robot, here in enumerate(attacks.place.T):
        color = robot_color(robot)[1]
        log_sight(map, patrol, f"map/sight/{robot}", here, color, ("step", times))
        _log_robot(map, f"map/robots/{robot}", here, color)
    _log_target(map, patrol, attacks)
    for name, values, end in (
        ("caught", attacks.caught, CAUGHT),
        ("succeeded", attacks.succeeded, SUCCEEDED),
    ):
        log_curve(stream, f"attacks/{name}", values, color=_STATES[end][1], name=name)
    seen = ["grid/seen", "sight/**", "robots/**", "target", "attack", "attack_label", "base"]
    most = float(max(attacks.caught[-1], attacks.succeeded[-1]))
    views = rrb.Vertical(
        map.view("The patrol", seen),
        curve_view("attacks", "Attacks so far", int(times[-1]), most, legend=True),
        row_shares=[4, 1],
    )
    text = _text(patrol, attacks, spec)
    return log_tab(stream, "", "Patrol", views, text, _legend(patrol), shares=(3, 2), rows=(5, 3))


def _log_robot(map: CellMap, path: str, here: Int[np.ndarray, "times"], color: Color) -> None:
    """Log a robot as a dot with its last steps behind it."""
    index = [rr.TimeColumn("step", sequence=np.arange(here.size))]
    xy = map.xy(here)
    trail = [xy[max(0, time - _TRAIL) : time + 1] for time in range(here.size)]
    # A strip of one point is none.
    trail[0] = xy[[0, 0]]
    map.stream.send_columns(f"{path}/trail", index, rr.LineStrips2D.columns(strips=trail))
    line = rr.LineStrips2D.from_fields(colors=color, radii=points(3.0), draw_order=30)
    map.stream.log(f"{path}/trail", line, static=True)
    map.stream.send_columns(f"{path}/here", index, rr.Points2D.columns(positions=xy))
    dot = rr.Points2D.from_fields(colors=color, radii=0.35 * map.cells.cell, draw_order=40)
    map.stream.log(f"{path}/here", dot, static=True)


def _log_target(map: CellMap, patrol: PatrolledMap, attacks: Attacks) -> None:
    """Log the target, whose colour and label say how an attack goes."""
    stream, side = map.stream, patrol.cells.cell
    target, steps = patrol.xy[patrol.attack.target], patrol.attack.attack_times[0]
    ended = {WAITING: "target", CAUGHT: "caught", SUCCEEDED: "succeeded"}
    states, since = attacks.state.tolist(), attacks.since.tolist()
    labels = [
        ended.get(state, f"attack: step {count} of {steps}")
        for state, count in zip(states, since, strict=True)
    ]
    index = [rr.TimeColumn("step", sequence=np.arange(len(states)))]
    colors = [(*_STATES[state][1], 255) for state in states]
    stream.send_columns("map/attack", index, rr.Points2D.columns(colors=colors))
    dot = rr.Points2D.from_fields(positions=[target], radii=0.3 * side, draw_order=50)
    stream.log("map/attack", dot, static=True)
    log_frame(stream, "map/target", target, 0.5 * side, TARGET, 2.0, 49.0)
    stream.send_columns("map/attack_label", index, rr.Points2D.columns(labels=labels))
    # It hangs above the target.
    text = rr.Points2D.from_fields(
        positions=target + np.array([0, 1.5 * side]),
        colors=TEXT,
        radii=0.001,
        show_labels=True,
        draw_order=60,
    )
    stream.log("map/attack_label", text, static=True)


def _log_seen(map: CellMap, patrol: PatrolledMap, attacks: Attacks) -> None:
    """Log which robot sees each square."""
    colors = min(patrol.robots, len(ROBOTS))
    classes = [PictureClass("not free", CLEAR), PictureClass("nobody sees it", FREE)]
    for robot in range(colors):
        name, color = robot_color(robot)
        classes.append(PictureClass(f"robot {robot} ({name}) sees it", mix(color, FREE, 0.6)))
    classes.append(PictureClass("several robots see it", mix(PLAIN, FREE, 0.3)))
    classes.append(PictureClass("the base station sees it", BASE_VIEW))
    kind = np.ones((len(attacks.place), patrol.cells.positions), np.uint8)
    if patrol.regions is not None:
        kind[:, patrol.regions.view] = colors + 3
    seen = patrol.visible[attacks.place]
    by = seen.sum(axis=1)
    kind = np.where(by == 1, (2 + seen.argmax(axis=1) % colors).astype(np.uint8), kind)
    kind = np.where(by > 1, np.uint8(colors + 2), kind)
    map.picture("seen", classes, kind, "step", np.arange(len(kind)))


def _legend(patrol: PatrolledMap) -> list[tuple[str, Color]]:
    legend = [
        (f"robot {robot}, its last steps and sight", robot_color(robot)[1])
        for robot in range(min(patrol.robots, len(ROBOTS)))
    ]
    if patrol.robots > 1:
        legend.append(("in view of several robots", mix(PLAIN, FREE, 0.3)))
    if patrol.regions is not None:
        legend.append(("in view of the base station", BASE_VIEW))
    return legend + _STATES


def _text(patrol: PatrolledMap, attacks: Attacks, spec: Mapping[str, Any]) -> str:
    attack = patrol.attack
    caught, done = int(attacks.caught[-1]), int(attacks.caught[-1] + attacks.succeeded[-1])
    who = "A robot patrols" if patrol.robots == 1 else f"{patrol.robots} robots patrol"
    divided, base_tab = "Each walks over the whole map, and needs to hear of no other.", ""
    if patrol.regions is not None:
        divided = "Each has a region of its own, and reports to a base station."
        base_tab = (
            "\n- The tab **Base and regions**: who patrols where, and what the base station sees."
        )
    assert patrol.cells.workspace is not None
    return f"""# Patrolling with limited visibility

{who} a map and see {patrol.reach:g} m far, and not through walls. At each cell a robot draws its
next step at random, so that nobody can know where it will be. {divided}

The map is {patrol.cells.workspace.describe()}. Squares of {patrol.cells.cell:g} m make
{patrol.cells.positions:,} cells, and {patrol.edges:,} edges lead from one to the next.

An adversary attacks the cell at {place(patrol, attack.target)} when nobody looks, and needs
{attack.attack_times[0]:,} steps. It is caught if a robot sees that cell by then:
**{attack.exact[0]:.3f}** is the probability, if the robots may be anywhere out of view when it
begins. In this run it was caught
{caught} times in {done}. Successive attacks are not independent: a robot that was near still is.

## How to look

Press play, or drag the slider `step` at the bottom.

- **dots**: the robots, with their last steps and the outline of what they see. The squares that
  they see wholly have their colours.
- **the pink frame**: the target. The dot in it is yellow during an attack, then green if that was
  caught, and pink if not.
- **the curves**: the attacks so far.
- The tab **Cover**: cells from which a robot sees everything, one by one.
- The tab **Policies**: how often a robot takes each edge.{base_tab}
- The tab **The target**: how soon a robot sees it, simulated, exact, and fitted.
- The tab **Vulnerability**: the same question for every cell.

{made_with(spec)}"""


def _walk(policy: Policy, random: np.random.Generator, steps: int) -> Int[np.ndarray, "times"]:
    image, probability = np.asarray(policy.chain.image), np.asarray(policy.chain.probability)
    up_to = np.cumsum(probability, axis=0)
    here = int(random.choice(policy.cells))
    walk = [here]
    for drawn in random.random(steps).tolist():
        chances = up_to[:, here]
        # Sums of probabilities are 1 only to rounding.
        here = int(image[np.searchsorted(chances, drawn * chances[-1], side="right"), here])
        walk.append(here)
    return np.array(walk, np.int32)
