"""Robots that patrol a map, and an adversary that attacks one cell of it again and again."""

import dataclasses

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int, UInt8

from ..patrol import Policy
from .blueprint import (
    legend_view,
    log_classes,
    log_legend_style,
    log_legends,
    log_pictures,
    map_view,
)
from .canvas.palette import (
    CATEGORIES,
    CLEAR,
    FREE,
    KNOWN,
    PLAIN,
    ROBOTS,
    TARGET,
    TEXT,
    Color,
    LegendEntry,
    PictureClass,
    mix,
    robot_color,
)
from .map_patrol import BASE_VIEW, MapPatrol
from .outlines import log_outline_style, log_outlines, outlines
from .pictures import on_squares


WAITING, ATTACKING, CAUGHT, SUCCEEDED = range(4)
_STATES: list[tuple[str, Color]] = [
    ("the target: nobody attacks it", PLAIN),
    ("an attack goes on", CATEGORIES["yellow"]),
    ("it was caught", KNOWN),
    ("it succeeded", TARGET),
]
# About so many attacks are shown, as far as there are steps.
_ATTACKS = 30
_FEWEST_STEPS, _MOST_STEPS = 600, 1500
# Over all robots: an outline at each step is some hundreds of bytes.
_MOST_OUTLINES = 12_000
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


def simulate_attacks(patrol: MapPatrol, seed: int) -> Attacks:
    """Moves robots at random, and attacks the target, for the first attack time, when nobody looks.

    An attack fails if a robot has the target in view within the attack time.

    **Arguments:**

    - `patrol`: the patrol.
    - `seed`: of the robots and the adversary.
    """
    attack_time = int(patrol.attack.attack_times[0])
    steps = int(np.clip(_ATTACKS * (attack_time + _PAUSE + _WAIT // 2), _FEWEST_STEPS, _MOST_STEPS))
    steps = min(steps, max(_MOST_OUTLINES // patrol.robots, attack_time))
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


def log_attacks(stream: rr.RecordingStream, patrol: MapPatrol, attacks: Attacks) -> None:
    """Logs the robots with what they see, the target, and the attacks so far."""
    times = np.arange(len(attacks.place))
    index = [rr.TimeColumn("step", sequence=times)]
    xy, cell = patrol.xy, patrol.cells.cell
    _log_seen(stream, patrol, attacks)
    for robot in range(patrol.robots):
        color = robot_color(robot)[1]
        here = attacks.place[:, robot]
        log_outlines(stream, f"map/sight/{robot}", "step", times, outlines(patrol, here))
        log_outline_style(stream, f"map/sight/{robot}", color)
        trail = [xy[here[max(0, time - _TRAIL) : time + 1]] for time in times.tolist()]
        # A strip of one point is none.
        trail[0] = xy[here[[0, 0]]]
        strips = rr.LineStrips2D.columns(strips=trail)
        stream.send_columns(f"map/robots/{robot}/trail", index, strips)
        line = rr.LineStrips2D.from_fields(
            colors=color, radii=rr.Radius.ui_points(3), draw_order=30
        )
        stream.log(f"map/robots/{robot}/trail", line, static=True)
        stream.send_columns(
            f"map/robots/{robot}/here", index, rr.Points2D.columns(positions=xy[here])
        )
        dot = rr.Points2D.from_fields(colors=color, radii=0.35 * cell, draw_order=40)
        stream.log(f"map/robots/{robot}/here", dot, static=True)

    colors = [_rgba(_STATES[state][1]) for state in attacks.state.tolist()]
    stream.send_columns("map/attack", index, rr.Points2D.columns(colors=colors))
    target = xy[patrol.attack.target]
    style = rr.Points2D.from_fields(positions=[target], radii=0.3 * cell, draw_order=50)
    stream.log("map/attack", style, static=True)
    frame = rr.Boxes2D(
        centers=[target],
        half_sizes=[[0.5 * cell, 0.5 * cell]],
        colors=TARGET,
        radii=rr.Radius.ui_points(2),
        draw_order=49,
    )
    stream.log("map/target", frame, static=True)
    label = rr.Points2D.columns(labels=_labels(patrol, attacks))
    stream.send_columns("map/attack_label", index, label)
    # It hangs above the target.
    style = rr.Points2D.from_fields(
        positions=[target + np.array([0, 1.5 * cell])],
        colors=TEXT,
        radii=0.001,
        show_labels=True,
        draw_order=60,
    )
    stream.log("map/attack_label", style, static=True)
    for name, values in (("caught", attacks.caught), ("succeeded", attacks.succeeded)):
        path = f"attacks/{name}"
        stream.send_columns(path, index, rr.Scalars.columns(scalars=values))
        color = _STATES[CAUGHT if name == "caught" else SUCCEEDED][1]
        curve = rr.SeriesLines(colors=color, widths=2, names=name, interpolation_mode="StepAfter")
        stream.log(path, curve, static=True)
    log_legend_style(stream, "patrol/legend")
    log_legends(stream, "patrol/legend", "step", np.zeros(1, np.int64), [_legend(patrol)])


def attacks_layout(patrol: MapPatrol, attacks: Attacks) -> rrb.Container:
    """The tab of the patrol."""
    boundary = rrb.TimeRangeBoundary.absolute
    # From the start to the end, not what is near the time that is shown.
    last = len(attacks.place) - 1
    whole = rrb.TimeRange(start=boundary(seq=0), end=boundary(seq=last))
    most = max(int(attacks.caught[-1]), int(attacks.succeeded[-1]), 1)
    seen = ["grid/seen", "sight/**", "robots/**", "target", "attack", "attack_label"]
    return rrb.Horizontal(
        rrb.Vertical(
            map_view(patrol.cells, "The patrol", [*seen, "base"]),
            rrb.TimeSeriesView(
                origin="attacks",
                name="Attacks so far",
                axis_x=rrb.TimeAxis(view_range=whole),
                axis_y=rrb.ScalarAxis(range=(0, 1.05 * most)),
                plot_legend=rrb.PlotLegend(visible=True),
            ),
            row_shares=[4, 1],
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="text", name="What you see"),
            legend_view("patrol/legend", _legend(patrol)[-1].row + 1),
            row_shares=[5, 3],
        ),
        column_shares=[3, 2],
        name="Patrol",
    )


def _walk(policy: Policy, random: np.random.Generator, steps: int) -> Int[np.ndarray, "times"]:
    image, probability = np.asarray(policy.chain.image), np.asarray(policy.chain.probability)
    up_to = np.cumsum(probability, axis=0)
    here = int(random.choice(policy.cells))
    walk = [here]
    for drawn in random.random(steps).tolist():
        ways = up_to[:, here]
        # Sums of probabilities are 1 only to rounding.
        here = int(image[np.searchsorted(ways, drawn * ways[-1], side="right"), here])
        walk.append(here)
    return np.array(walk, np.int32)


def _log_seen(stream: rr.RecordingStream, patrol: MapPatrol, attacks: Attacks) -> None:
    """Logs which robot sees each square."""
    colors = min(patrol.robots, len(ROBOTS))
    classes = [PictureClass("not free", CLEAR), PictureClass("nobody sees it", FREE)]
    for robot in range(colors):
        name, color = robot_color(robot)
        classes.append(PictureClass(f"robot {robot} ({name}) sees it", mix(color, FREE, 0.6)))
    classes.append(PictureClass("several robots see it", mix(PLAIN, FREE, 0.3)))
    classes.append(PictureClass("the base station sees it", BASE_VIEW))
    log_classes(stream, "map/grid/seen", classes)
    kind = np.ones((len(attacks.place), patrol.cells.positions), np.uint8)
    if patrol.regions is not None:
        kind[:, patrol.regions.view] = colors + 3
    seen = patrol.visible[attacks.place]
    by = seen.sum(axis=1)
    kind = np.where(by == 1, (2 + seen.argmax(axis=1) % colors).astype(np.uint8), kind)
    kind = np.where(by > 1, np.uint8(colors + 2), kind)
    pictures = on_squares(patrol.cells, kind)
    log_pictures(stream, "map/grid/seen", "step", np.arange(len(pictures)), pictures)


def _labels(patrol: MapPatrol, attacks: Attacks) -> list[str]:
    attack_time = patrol.attack.attack_times[0]
    said = {WAITING: "target", CAUGHT: "caught", SUCCEEDED: "succeeded"}
    return [
        said.get(state, f"attack: step {since} of {attack_time}")
        for state, since in zip(attacks.state.tolist(), attacks.since.tolist(), strict=True)
    ]


def _legend(patrol: MapPatrol) -> list[LegendEntry]:
    entries = [
        (f"robot {robot}, its last steps and sight", robot_color(robot)[1])
        for robot in range(min(patrol.robots, len(ROBOTS)))
    ]
    if patrol.robots > 1:
        entries.append(("in view of several robots", mix(PLAIN, FREE, 0.3)))
    if patrol.regions is not None:
        entries.append(("in view of the base station", BASE_VIEW))
    entries += _STATES
    return [LegendEntry(row, *entry) for row, entry in enumerate(entries)]


def _rgba(color: Color) -> tuple[int, ...]:
    return (*color, 255) if len(color) == 3 else color
