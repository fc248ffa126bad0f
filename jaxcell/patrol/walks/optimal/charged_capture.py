import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ....base.precision import require_x64
from ....base.process import one_blas_thread
from ....optimize import Graph, GraphLike, shortest_tour
from ...team.charging import Charged, charged, in_time_for_charge
from ..steps import ChargedSteps, Steps
from ..walk import random_walk
from .ascent import Ascent, late_gain


# Gradient steps from each start, and the hardness of the minimum at the start and at the end.
_STEPS, _ANNEALED = 800, (1.0, 300.0)
# Steps with less than this fraction of the largest probability are not made. The search uses the
# first fraction, the result the best of all.
_RARE = (1e-3, 1e-2, 0.05, 0.2, 0.5)
# Largest number of products in a gradient step, and the largest with which all starts are tried.
_MAX_PRODUCTS, _QUICK = 10_000_000, 1_000_000


@one_blas_thread()
def charged_capture(
    graph: GraphLike,
    matrices: Float[np.ndarray, "robots vertices vertices"],
    charger: int,
    every: int,
    attack_time: int,
    *,
    starts: int = 6,
    seed: int = 0,
    names: Sequence[str] | None = None,
) -> Charged:
    """Find walks that maximise the least probability of capture and return to a charger in time.

    The steps of a robot depend on the number of steps since its last charge, and steps that would
    prevent a timely return are never made. The adversary knows the walks, and sees the robots and
    the time since their last charges. Robots are independent, and all start at their worst places,
    as in [`maximin_capture`][]. The result is a local optimum, the best of several starts.

    **Arguments:**

    - `graph`, `charger`, `every`, `names`: as in [`charged`][jaxcell.patrol.team.charged].
    - `matrices`: the transition matrices of given walks. One start of the search is these walks,
        modified to return in time. Another start follows a short tour from charge to charge, a
        third takes all edges with equal probability, and the other starts are random.
    - `attack_time`: number of steps that an attack takes.
    - `starts`: number of starts; a large problem has fewer.
    - `seed`: seed of the random starts.

    **Returns:** [`Charged`][jaxcell.patrol.team.Charged]; `led_back` is the least probability of
    capture by the given walks, modified to return in time.

    On a line of three vertices, a walk to the other end and back takes 4 steps:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1], [1, 2]])
        >>> walk = np.array([[[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]])
        >>> patrol.walks.charged_capture(line, walk, 0, 3, attack_time=4)
        Traceback (most recent call last):
            ...
        ValueError: every: expected at least 4 steps, to the farthest vertex and back, got 3
    """
    require_x64("charged_capture")
    robots = len(matrices)
    products = robots * every * graph.vertices**2 * attack_time
    if products > _MAX_PRODUCTS:
        raise ValueError(
            f"every: {every} steps, times {graph.vertices} vertices squared, times attacks of "
            f"{attack_time} steps, are {products:,} products for {robots} robots; expected at most "
            f"{_MAX_PRODUCTS:,}"
        )
    given: Any = {"attack_time": attack_time, "names": names}
    led = charged(graph, matrices, charger, every, **given)
    near = Steps.of(graph)
    image = np.asarray(near.image)
    allowed = in_time_for_charge(graph, charger, every)[:, image] & (np.asarray(near.even) > 0)
    shape = (robots, image.shape[0], every * graph.vertices)
    steps = ChargedSteps(near, *jax.device_put((allowed, charger, np.float32(_RARE[0]))))

    def logits(
        chance: Float[np.ndarray, "robots ages vertices vertices"],
    ) -> Float[np.ndarray, "robots branches cells"]:
        return near.logits(chance).swapaxes(1, 2).reshape(shape)

    random = np.random.default_rng(seed)
    even = random_walk(graph, np.ones(len(graph.edges))).to_scipy().toarray()
    tour = np.broadcast_to(_on_tour(graph, charger, every), led.chance.shape)
    even_led = charged(graph, np.stack([even] * robots), charger, every).chance
    begins = [logits(chance) for chance in (tour, even_led, led.chance)]
    if robots > 1:
        # Equal robots would stay equal.
        begins = [begin + 0.5 * random.normal(size=shape) for begin in begins]
    count = int(np.clip(starts * _QUICK / products, 1, starts))
    begins += [2 * random.normal(size=shape) for _ in range(count - len(begins))]
    away = np.tile(1 - np.eye(graph.vertices, dtype=np.float32), (every, 1))
    ascent = Ascent(steps, away, attack_time, 0.0, _ANNEALED)
    tries = [ascent.climb(begin, _STEPS) for begin in begins[:count]]
    best, _, course = max(tries, key=lambda attempt: attempt[1])
    walks = [led]
    for rare in _RARE:
        made = steps._replace(rare=jax.device_put(rare)).chances(np.asarray(best, np.float64), 0.0)
        drawn = np.asarray(made).reshape(robots, -1, every, graph.vertices).swapaxes(1, 2)
        walks.append(Charged.of(near.matrices(drawn), charger, **given))
    walk = max(walks, key=lambda each: each.least_capture or 0.0)
    return dataclasses.replace(walk, led_back=led.least_capture, late_gain=late_gain(course))


def _on_tour(graph: Graph, charger: int, every: int) -> Float[np.ndarray, "ages vertices vertices"]:
    """Count how often a short tour takes each step, for each number of steps since the last charge.

    The tour visits all vertices; steps that it takes while a charge is overdue are not counted."""
    others = np.delete(np.arange(graph.vertices), charger).tolist()
    # All edges have the same length here, because each takes one step.
    tour = shortest_tour(Graph(graph.edges, graph.vertices), [charger, *others])
    since, taken = 0, np.zeros((every, graph.vertices, graph.vertices))
    for tail, head in itertools.pairwise([*tour, charger]):
        if since < every:
            taken[since, tail, head] += 1
        since = 0 if head == charger else since + 1
    return taken
