import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ...patrol.map.intruder import Attacks, AttackState, simulate_attacks
from ..canvas import palette
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap
from ..canvas.marks import log_walker, send_labels
from ..canvas.page import log_tab
from ..canvas.palette import Color, PictureClass
from ..canvas.prose import Spec, made_with, numbers
from ..canvas.stream import send_changing
from .sight import BASE_VIEW, SEEN, log_sight, place


# For each state of an attack, the label of the target, the text of the legend, and the colour.
_STATES: dict[AttackState, tuple[str, str, Color]] = {
    AttackState.WAITING: ("target", "the target, not attacked", palette.PLAIN),
    AttackState.ATTACKING: (
        "attack: step {} of {}",
        "an attack goes on",
        palette.CATEGORIES["yellow"],
    ),
    AttackState.CAUGHT: ("caught", "it was caught", palette.KNOWN),
    AttackState.SUCCEEDED: ("succeeded", "it succeeded", palette.TARGET),
}
_SEVERAL = palette.tint(palette.PLAIN, 0.3)


def log_attacks(map: CellMap, patrol: PatrolledMap, spec: Spec) -> rrb.Container:
    """Log a tab that shows the robots, the cells in their view, the target and the attacks."""
    attacks = simulate_attacks(patrol, patrol.seed)
    stream, times = map.stream, np.arange(len(attacks.place))
    _log_seen(map, patrol, attacks)
    for robot, here in enumerate(attacks.place.T):
        color = palette.robot_color(robot)[1]
        log_sight(map, patrol, f"map/sight/{robot}", here, color, ("step", times))
        radius = 0.35 * map.cells.cell
        log_walker(stream, f"map/robots/{robot}", map.xy(here), color, radius)
    _log_target(map, patrol, attacks)
    ends = {AttackState.CAUGHT: attacks.caught, AttackState.SUCCEEDED: attacks.succeeded}
    for end, values in ends.items():
        name = end.name.lower()
        log_curve(stream, f"attacks/{name}", values, color=_STATES[end][2], name=name)
    seen = ["grid/seen", "sight/**", "robots/**", "target", "attack", "attack_label", "base"]
    most = int(max(attacks.caught[-1], attacks.succeeded[-1]))
    views = rrb.Vertical(
        map.view("The patrol", seen),
        curve_view("attacks", "Attacks so far", int(times[-1]), most, legend=True),
        row_shares=[4, 1],
    )
    text = _text(patrol, attacks, spec)
    return log_tab(stream, "", "Patrol", views, text, _legend(patrol), shares=(3, 2), rows=(5, 3))


def _log_target(map: CellMap, patrol: PatrolledMap, attacks: Attacks) -> None:
    """Log the target; its colour and label show the state of the attack."""
    stream, side, times = map.stream, patrol.cells.cell, np.arange(len(attacks.state))
    target, steps = patrol.xy[patrol.attack.target], patrol.attack.attack_time[0]
    states = [_STATES[AttackState(state)] for state in attacks.state.tolist()]
    since = zip(states, attacks.since.tolist(), strict=True)
    shown = [label.format(count, steps) for (label, _, _), count in since]
    colors = [(*color, 255) for _, _, color in states]
    style = {"positions": [target], "radii": 0.3 * side, "draw_order": 50}
    send_changing(stream, "map/attack", rr.Points2D, times, style=style, colors=colors)
    cell = np.array([patrol.attack.target])
    map.frames("target", cell, palette.TARGET, half=0.5 * side, width=2.0, order=49.0)
    at, ground = map.below(target, 0.6 * side)
    places = np.tile(at, (len(shown), 1))
    send_labels(stream, "map/attack_label", shown, times, ground=ground, positions=places)


def _log_seen(map: CellMap, patrol: PatrolledMap, attacks: Attacks) -> None:
    """Log a picture at each step that shows which robots see each square."""
    shared = palette.robots_by_color(patrol.robots)
    colors = len(shared)
    classes = [palette.NOT_FREE, PictureClass("no robot sees it", palette.FREE)]
    classes += [
        PictureClass(f"robot {alike} ({name}) sees it", palette.tint(color, 0.6))
        for alike, name, color in shared
    ]
    several = PictureClass("several robots see it", _SEVERAL)
    classes += [several, PictureClass("the base station sees it", BASE_VIEW)]
    seen = patrol.visible[attacks.place]
    by = seen.sum(axis=1)
    kind = np.select([by == 1, by > 1], [2 + seen.argmax(axis=1) % colors, colors + 2], 1)
    if patrol.regions is not None:
        kind[(by == 0) & patrol.regions.view] = colors + 3
    map.picture("seen", classes, kind.astype(np.uint8), "step", np.arange(len(kind)))


def _legend(patrol: PatrolledMap) -> list[tuple[str, Color]]:
    legend = [
        (f"robot {alike}, last steps and sight", color)
        for alike, _, color in palette.robots_by_color(patrol.robots)
    ]
    if patrol.robots > 1:
        legend.append(("in view of several robots", _SEVERAL))
    if patrol.regions is not None:
        legend.append(("in view of the base station", BASE_VIEW))
    return [*legend, *((text, color) for _, text, color in _STATES.values())]


def _text(patrol: PatrolledMap, attacks: Attacks, spec: Spec) -> str:
    attack = patrol.attack
    caught, done = int(attacks.caught[-1]), int(attacks.caught[-1] + attacks.succeeded[-1])
    who = "A robot patrols" if patrol.robots == 1 else f"{patrol.robots} robots patrol"
    divided = ""
    if patrol.regions is not None:
        divided = " Each has its own region, and reports to a base station."
    return f"""# Patrolling with limited visibility

{who} a map at random and see {patrol.reach:g} m far.{divided}

An intruder that stays for {attack.attack_time[0]:,} steps is caught with probability
**{patrol.least_capture:.3f}** at least, at {place(patrol, patrol.least_captured)}, if the robots
{patrol.begun}.

Here it attacks {place(patrol, attack.target)} when no robot sees it. It is caught with probability
**{attack.exact[0]:.3f}**; in this run {caught} times in {done}.

## How to look

Press play, or drag `step` at the bottom.

- **dots**: the robots, with their last steps, the outline of what they see, and the squares that
  count as seen: {SEEN[patrol.sight]}.
- **pink frame**: the target. Its dot is yellow during an attack, then green if that was caught, and
  pink if not.

{numbers(patrol)}

{made_with(spec, patrol.cells)}"""
