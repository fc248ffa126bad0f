import math
from collections.abc import Sequence
from typing import Any

import networkx as nx
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int

from ...base.quantities import Result
from ...mapping import Chain
from ...markov import sample_walks
from ...patrol import GraphPatrol
from ...patrol.team import long_run, steps_between_visits
from ..canvas import palette
from ..canvas.curves import curve_view, log_curve
from ..canvas.marks import LABEL, log_lines, log_shares, log_walker
from ..canvas.matrix import log_matrix
from ..canvas.page import log_tab
from ..canvas.palette import FREE, PLAIN, Color, ramp
from ..canvas.plot import Plot, ticks
from ..canvas.prose import Spec, counted, described, made_with, numbers
from ..canvas.scale import Scale
from ..canvas.stream import plane, send_blueprint, send_changing
from .game import log_game


_STEPS = 1000
# Largest number of colours of vertices over all steps, which take a few MB.
_MAX_COLORS = 1_000_000
_MAX_NAMES = 80
_MAX_CHANCES = 60


def log_patrol_graph(stream: rr.RecordingStream, patrol: GraphPatrol, spec: Spec) -> None:
    """Record the random walk of a patroller on a graph, over the timeline `step`.

    Vertices without positions are placed as if each edge were a spring.
    """
    xy = patrol.graph.xy
    if xy is None:
        graph = nx.Graph(patrol.graph.edges.tolist())
        places = nx.spring_layout(graph, seed=0, scale=math.sqrt(patrol.graph.vertices))
        xy = np.array([places[vertex] for vertex in range(patrol.graph.vertices)])
    drawing = _Drawing(stream, patrol, xy)
    tabs = [_log_walk(drawing, spec), _log_waits(drawing), _log_next(drawing)]
    if patrol.hitting_time is not None and patrol.mean_time_to is not None:
        times = patrol.hitting_time.copy()
        np.fill_diagonal(times, np.nan)
        matrix, rows = np.vstack([times, patrol.mean_time_to]), [*patrol.names, "mean"]
        title, named = "Expected steps from a row to a column", (rows, patrol.names)
        view, legend = log_matrix(stream, "times/matrix", title, matrix, *named, "steps")
        shares = 3, 1
        tabs.append(log_tab(stream, "times", "Hitting times", view, "", legend, shares=shares))
    if patrol.game is not None:
        tabs.append(log_game(stream, patrol.game))
    send_blueprint(stream, tabs, "step", 4.0)


class _Drawing:
    """A graph in a recording, with y up, below the entity `graph`. The constructor logs edges."""

    def __init__(
        self, stream: rr.RecordingStream, patrol: GraphPatrol, xy: Float[np.ndarray, "vertices 2"]
    ) -> None:
        self.stream, self.patrol, self.xy = stream, patrol, xy
        self.ends = xy[patrol.graph.edges]
        self.low, self.high = xy.min(axis=0), xy.max(axis=0)
        # Vertices may all be in one place.
        self.extent = float((self.high - self.low).max()) or 1.0
        lengths = patrol.graph.lengths
        typical = float(np.median(lengths[lengths > 0])) if lengths.any() else self.extent
        self.mark = min(0.035 * self.extent, 0.16 * typical)
        "The radius of a large vertex."
        stream.log("graph", rr.Transform3D(scale=[1, -1, 1]), static=True)
        self.labels("names", xy - [0, self.mark], patrol.names, len(xy) <= _MAX_NAMES)
        log_lines(stream, "graph/edges", list(self.ends), PLAIN, 1.0, 1.0)

    def view(self, title: str, *contents: str) -> rrb.Spatial2DView:
        """Create a view of entities of the graph, with a margin around it."""
        margin = 0.06 * self.extent + 2 * self.mark
        (left, bottom), (right, top) = self.low - margin, self.high + margin
        box = left, -top, right, -bottom
        return plane("/", title, box, [f"/graph/{one}" for one in contents])

    def labels(
        self, name: str, at: Float[np.ndarray, "labels 2"], labels: Sequence[str], shown: bool
    ) -> None:
        """Log texts at points; they are always visible if `shown`, and otherwise on hovering."""
        style = {**LABEL, "show_labels": shown}
        text = rr.Points2D(at, labels=labels, draw_order=60, **style)
        self.stream.log(f"graph/{name}", text, static=True)

    def discs(self, name: str, radii: Any, colors: Any, labels: Sequence[str]) -> None:
        """Log the vertices as discs, with labels that are visible on hovering."""
        style = {"colors": colors, "radii": radii, "show_labels": False, "draw_order": 20}
        discs = rr.Points2D(self.xy, labels=labels, **style)
        self.stream.log(f"graph/{name}", discs, static=True)


def _log_walk(drawing: _Drawing, spec: Spec) -> rrb.Container:
    """Log walking patrollers, the share of steps per edge, and the share of time per vertex."""
    patrol, stream, walks = drawing.patrol, drawing.stream, _walks(drawing.patrol)
    flow, (tails, heads) = _flow(patrol), patrol.graph.edges.T
    weight, share = flow[tails, heads] + flow[heads, tails], flow.sum(axis=1)
    most, robots = float(weight.max()), patrol.robots
    log_shares(stream, "graph/shares", drawing.ends, weight / most, 0.45 * drawing.mark)
    size = np.sqrt(share / share.max())
    shares = [f"{100 * one:.3g} % of the time" for one in share.tolist()]
    drawing.discs("vertices", drawing.mark * np.maximum(size, 0.1), FREE, shares)
    for robot in range(robots):
        path, color = f"graph/patrollers/{robot}", palette.robot_color(robot)[1]
        place = drawing.xy[walks[:, robot]]
        # A light rim is needed because an edge may have the colour of the patroller.
        log_walker(stream, path, place, color, 0.9 * drawing.mark, width=2.0, rim=3.5)
    longest = _log_idle(drawing, walks)
    legend = _scale(most, "of the steps").legend()
    legend.append(("a vertex, larger with more time there", FREE))
    if robots == 1:
        legend.append(("the patroller", palette.ROBOT))
    else:
        shared = palette.robots_by_color(robots)
        legend += [(f"patroller {alike}", color) for alike, _, color in shared]
    views = rrb.Vertical(
        rrb.Horizontal(
            drawing.view("The walk", "shares", "vertices", "names", "patrollers/**"),
            drawing.view("Time since a visit", "edges", "idle", "names"),
        ),
        curve_view(longest, "The longest time since a visit (steps)", len(walks) - 1),
        row_shares=[3, 1],
    )
    text = _text(patrol, spec)
    return log_tab(stream, "", "The walk", views, text, legend, shares=(3, 2), rows=(2, 1))


def _flow(patrol: GraphPatrol) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the share of all robots' steps that lead from each vertex to each vertex."""
    vertices, walks = patrol.stationary.size, patrol.walks
    flow = (long_run(walks)[:, :, None] * walks).mean(axis=0)
    return flow.reshape(-1, vertices, flow.shape[0] // vertices, vertices).sum(axis=(0, 2))


def _walks(patrol: GraphPatrol) -> Int[np.ndarray, "times robots"]:
    """Simulate the vertex of each patroller over time, from the stationary distribution."""
    random, walks = np.random.default_rng(patrol.seed), []
    vertices = patrol.stationary.size
    steps = max(1, min(_STEPS, _MAX_COLORS // vertices))
    for matrix, share in zip(patrol.walks, long_run(patrol.walks), strict=True):
        start = random.choice(share.size, 1, p=share / share.sum())
        walks.append(sample_walks(Chain.from_scipy(matrix), start, steps, random) % vertices)
    return np.concatenate(walks, axis=1)


def _log_idle(drawing: _Drawing, walks: Int[np.ndarray, "times robots"]) -> str:
    """Log the steps since a visit to each vertex, and a curve of the maximum; return its entity."""
    stream, vertices = drawing.stream, len(drawing.xy)
    # Before the first visit, use the time since the beginning.
    idle, now = np.empty((len(walks), vertices), np.int64), np.zeros(vertices, np.int64)
    for time, here in enumerate(walks):
        now += 1
        now[here] = 0
        idle[time] = now
    level = 1 - np.log1p(idle.ravel()) / np.log1p(max(int(idle.max()), 1))
    times, counts = np.arange(len(walks)), np.full(len(walks), vertices)
    style = {"positions": drawing.xy, "radii": drawing.mark, "draw_order": 20, "show_labels": False}
    colors = ramp(level)
    send_changing(stream, "graph/idle", rr.Points2D, times, counts, style=style, colors=colors)
    log_curve(stream, "walk/longest", idle.max(axis=1), color=palette.ROBOT)
    return "walk/longest"


def _log_waits(drawing: _Drawing) -> rrb.Container:
    """Log a tab that shows times between visits, ages of news, and steps between charges."""
    patrol, stream = drawing.patrol, drawing.stream
    news, charged = patrol.news, patrol.charged
    units = "steps" if patrol.timed is None else "s"
    shares = patrol.shares if patrol.walks_with_memory is None else patrol.walks_with_memory.shares
    between = patrol.timed.idleness if patrol.timed else steps_between_visits(shares)
    shown = {"Time between visits": between}
    if news is not None:
        shown[f"Mean age of news at the base {news.base}"] = news.mean_age
    if charged is not None:
        shown[f"Time between visits, with the charger {charged.charger}"] = charged.idleness
    all_times = np.concatenate([*shown.values()])
    finite = np.isfinite(all_times)
    most = float(all_times[finite].max())
    views: list[rrb.View] = []
    for number, (title, times) in enumerate(shown.items()):
        known = np.isfinite(times)
        colors = np.where(known[:, None], ramp(1 - times / most), PLAIN[:3]).astype(np.uint8)
        mean = [f"{one:.3g} {units}" for one in times.tolist()]
        drawing.discs(f"waits/{number}", drawing.mark, colors, mean)
        views.append(drawing.view(title, "edges", f"waits/{number}", "names"))
    charts: list[rrb.View] = []
    if news is not None:
        last = float(news.late_age[np.isfinite(news.late_age)].max(initial=1.0))
        plot = Plot(stream, "waits/news", last, 1.0)
        plot.axes(ticks(last), ticks(1.0), f"age ({units})", "share of news this old or newer")
        for vertex, age in enumerate(news.mean_age[:_MAX_NAMES].tolist()):
            (color,) = ramp(np.array([max(0.0, 1 - age / most)])).tolist()
            plot.line(str(vertex), news.age, news.known[:, vertex], tuple(color), 2.0)
        charts.append(plot.view("Age of news of each vertex, in its colour"))
    if charged is not None:
        every, high = float(charged.every), float(charged.interval.max())
        apart = math.ceil(charged.every / 10)
        middles = {n - 0.5: str(n) for n in range(apart, charged.every + 1, apart)}
        plot = Plot(stream, "waits/charges", every, high)
        plot.axes(middles, ticks(high), "steps between charges", "share of them")
        plot.bars("interval", charged.interval, every, palette.BELIEF)
        charts.append(plot.view("Steps between charges"))
    shades = _scale(most, units).legend()
    # Yellow stands for the shortest waiting times.
    turned = zip(shades, shades[::-1], strict=True)
    legend: list[tuple[str, Color]] = [palette.Level(one[0], other[1]) for one, other in turned]
    legend += [] if finite.all() else [("never", PLAIN)]
    rows: list[Any] = [rrb.Horizontal(*views), *([rrb.Horizontal(*charts)] if charts else [])]
    return log_tab(stream, "waits", "Waiting", rrb.Vertical(*rows), "", legend, shares=(7, 2))


def _log_next(drawing: _Drawing) -> rrb.Container:
    """Log the probability of leaving a vertex by each edge, on the edge's half near the vertex."""
    patrol = drawing.patrol
    most = float(patrol.transition.max())
    # Both halves of each edge, with a gap in the middle between them.
    here, there = np.concatenate([drawing.ends, drawing.ends[:, ::-1]]).swapaxes(0, 1)
    halves = np.stack([here, here + 0.48 * (there - here)], axis=1)
    chance, stay = patrol.probabilities.T.ravel(), patrol.stay
    log_shares(drawing.stream, "graph/next", halves, chance / most, 0.45 * drawing.mark)
    labels = [f"{one:.3f}" for one in chance.tolist()]
    # Labels are beside the line, on the right in the direction of motion.
    along = (there - here) / np.linalg.norm(there - here, axis=1, keepdims=True).clip(1e-9)
    beside = halves.mean(axis=1) + drawing.mark * (along[:, ::-1] * [1, -1] + [0, 0.35])
    drawing.labels("chances", beside, labels, chance.size <= _MAX_CHANCES)
    colors = palette.share_colors(stay / most, FREE)
    waits = [f"stays with probability {one:.3g}" for one in stay.tolist()]
    drawing.discs("stay", 0.6 * drawing.mark, colors, waits)
    legend = _scale(most, "chance to leave by it, or to wait").legend()
    legend.append(("a vertex where it never waits", FREE))
    who = "a patroller" if patrol.walks_with_memory is None else "one without memory"
    view = drawing.view(f"Where {who} goes next", "next", "chances", "stay", "names")
    return log_tab(drawing.stream, "next", "Where to next", view, "", legend, shares=(3, 1))


def _scale(most: float, unit: str) -> Scale:
    return Scale.over(np.array([0.0, most]), f"{{}} {unit}".format)


def _text(patrol: GraphPatrol, spec: Spec) -> str:
    robots = patrol.robots
    who = "A patroller walks" if robots == 1 else f"{robots} patrollers walk, each by itself,"
    edges = counted(len(patrol.graph.edges), "edge")
    columns = "vertex", "stationary", "mean_time_to", "first_arrival", "captured"
    drawn = "whatever came before: the walk is a *Markov chain*"
    if patrol.walks_with_memory is not None:
        drawn = f"by the vertex and one of {patrol.walks_with_memory.memory} states of a memory"
    return f"""# A random patrol

{who} on a graph of {patrol.graph.vertices:,} vertices and {edges}. At each vertex the
next one is drawn at random, {drawn}.

{_purpose(patrol, spec)}

## How to look

Press play, or drag `step` at the bottom.

- **The walk**: wide yellow edges are walked often.
- **Time since a visit**: a vertex is yellow when a patroller is there, and turns blue.
- The tab **Waiting**: how long vertices and news wait in the long run.
- The tab **Where to next**: wide yellow halves of edges are likely ways out.

## Numbers

{numbers(patrol)}

A step is as hard to guess as one of {math.exp(patrol.entropy_rate_nats):.3g} equally likely ones.

{described(patrol, *columns)}
{_more(patrol)}
{made_with(spec)}"""


def _purpose(patrol: GraphPatrol, spec: Spec) -> str:
    """Describe the strategy and the goal of the walk, and the least probability of capture."""
    parts = []
    if spec.get("strategy"):
        parts.append(f"The strategy is **{spec['strategy']}**.")
    if patrol.goal is not None and patrol.value is not None:
        parts.append(f"The walk makes large: {patrol.goal}, which is **{patrol.value:.4g}**.")
    walks = patrol.walks_with_memory
    if walks is not None and walks.memory > 1:
        memory = counted(walks.memory, "state")
        parts.append(f"With {memory} of memory the patrollers capture more.")
    if patrol.least_capture is not None:
        attack, unit = spec.get("attack_time"), "steps" if patrol.timed is None else "s"
        steps = "as long as its vertex says" if attack is None else f"**{attack:,} {unit}**"
        parts.append(
            f"An attack takes {steps}. An adversary who sees the patrollers at vertices is "
            f"captured with a probability of at least **{patrol.least_capture:.3f}**, at vertex "
            f"{patrol.least_captured}."
        )
    return " ".join(parts)


def _more(patrol: GraphPatrol) -> str:
    """Compose the sections on options of the patrol, such as constraints, news and charging."""
    sections: list[tuple[str, Result | None, str]] = [
        ("## Constraints", patrol.bounds, "constraint least value most active saves"),
        ("Edges take time:", patrol.timed, ""),
        (
            "Robots that share the graph, and that divide it:",
            patrol.division,
            "division mean_idleness worst_idleness least_capture",
        ),
        (
            "With a shared clock, patrollers can follow closed tours at equal intervals:",
            patrol.round,
            "stops robots steps seconds",
        ),
        ("", patrol.news, "mean_age late_age"),
        ("Kept near enough to the charger:", patrol.charged, ""),
        (
            "By number of states of memory, beside a tour and an upper bound. Other numbers are "
            "those of the walk without memory:",
            patrol.walks_with_memory,
            "walk least_capture any_time",
        ),
        (
            "By simulation, beside robots on a tour, those that go anywhere, and those that go "
            "where no robot was for longest:",
            patrol.idleness,
            "patrol mean mean_error worst longest least_capture",
        ),
    ]
    text = ""
    for intro, part, columns in sections:
        if part is not None:
            first = {"vertex": patrol.names} if part is patrol.news else None
            table = described(part, *columns.split(), first=first) if columns else ""
            paragraphs = filter(None, [intro, numbers(part), table])
            text += "".join(f"\n{paragraph}\n" for paragraph in paragraphs)
    return text
