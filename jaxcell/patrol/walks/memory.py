import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.quantities import Result, derived, quantity
from ...optimize import GraphLike
from ..team.idleness import RobotShares, idleness_over_vertices, long_run, steps_between_visits
from ..team.rounds import evenly_spaced_round
from ..team.times import names_of
from .arrival import blind_capture, states_at, watched_capture
from .optimal.bound import capture_bound
from .optimal.maximin import maximin_capture


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MemoryPatrol(Result):
    """Walks with memory: their least probability of capture, that of a round, and an upper bound.

    A state of a robot is a pair of a state of its memory and a vertex; the vertex varies fastest.
    """

    title: ClassVar[str] = "Walks with memory"
    tables: ClassVar[Mapping[str, str]] = {"walk": "walks", "vertex": "vertices"}

    walk: Annotated[list[str], quantity("walk", "walk", kind="coordinate")]
    least_capture: Annotated[
        Float[np.ndarray, "walks"],
        quantity("walk", "least capture from the worst starts", "1", kind="share"),
    ]
    "The least probability of capture if the adversary sees robots and states of their memories."
    any_time: Annotated[
        Float[np.ndarray, "walks"],
        quantity("walk", "least capture of attacks that begin at any time", "1", kind="share"),
    ]
    upper_bound: Annotated[
        float, quantity("", "no walks with any memory capture more than this", "1", kind="share")
    ]
    memory: Annotated[
        int, quantity("", "states of memory of the walk that captures most", kind="count")
    ]
    "The number of memory states of the walk that captures most; the smallest if walks tie."
    vertex: Annotated[list[str], quantity("vertex", "vertex", kind="coordinate")]
    chance: Annotated[
        Float[np.ndarray, "robots states states"],
        quantity("robot state next_state", "probability of a step between states", kind="share"),
    ]
    shares: RobotShares
    captured: Annotated[
        Float[np.ndarray, "vertices"],
        quantity("vertex", "least chance of capture there", "1", kind="share"),
    ]
    blind_captured: Float[np.ndarray, "vertices"]
    "The probability of capture at each vertex if the attack begins at a random time."

    @derived("state", "vertex of the state", kind="coordinate")
    def state_vertex(self) -> list[str]:
        return self.vertex * self.memory

    @derived("state", "state of the memory", kind="coordinate")
    def state_memory(self) -> Int[np.ndarray, "states"]:
        return np.repeat(np.arange(self.memory), len(self.vertex))

    @derived("", "share by which the bound is above the capture", "1")
    def gap(self) -> float:
        return 1 - float(self.least_capture.max()) / self.upper_bound

    mean_idleness, worst_idleness = idleness_over_vertices(
        "steps", lambda self: steps_between_visits(self.shares)
    )


def memory_patrol(
    graph: GraphLike,
    attack_time: Any,
    memory: int,
    matrices: Float[np.ndarray, "robots vertices vertices"],
    *,
    travel_times: Any = None,
    stay: bool = False,
    tests: int = 8,
    names: Sequence[str] | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> MemoryPatrol:
    """Search for walks that capture much, for robots with 2, 4, 8, ... states of memory.

    A search also starts from the walks with half as many states, so that it never captures less.
    One robot on a closed tour, or several robots on an evenly spaced round, are beside the walks.

    **Arguments:**

    - `graph`, `attack_time`, `travel_times`, `stay`: as in
        [`maximin_capture`][jaxcell.patrol.maximin_capture].
    - `memory`: the largest number of states of the memory of a robot.
    - `matrices`: the transition matrix of each robot without memory.
    - `tests`: number of tests of the upper bound, as in [`capture_bound`][].
    - `names`: names of the vertices; by default their numbers.
    - `say`: a function that is called with a line of text when a search begins.

    **Returns:** [`MemoryPatrol`][].

    A robot on a line of four vertices captures more if it has a memory:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1], [1, 2], [2, 3]])
        >>> walk = np.array([[0, 1, 0, 0], [0.5, 0, 0.5, 0], [0, 0.5, 0, 0.5], [0, 0, 1, 0]])
        >>> found = patrol.walks.memory_patrol(line, 5, 2, walk[None])
        >>> dict(zip(found.walk, found.least_capture.round(2).tolist(), strict=True))
        {'memory 1': 0.44, 'memory 2': 0.53, 'tour': 0.0}
    """
    robots, times = len(matrices), (attack_time, travel_times)
    sizes, walks = [1], [matrices]
    while sizes[-1] < memory:
        sizes.append(min(2 * sizes[-1], memory))
        say(f"seeking a walk with {sizes[-1]} states of memory")
        found = maximin_capture(
            graph,
            attack_time,
            travel_times=travel_times,
            robots=robots,
            stay=stay,
            memory=sizes[-1],
            known=walks[-1],
            throw=False,
        )
        walks.append(found.matrices)
    captured = [
        (watched_capture(graph, walk, long_run(walk), *times), blind_capture(graph, walk, *times))
        for walk in walks
    ]
    least = [float(worst.min()) for worst, _ in captured]
    best = int(np.argmax(np.array(least) >= max(least) * (1 - 1e-9)))
    on_tour = evenly_spaced_round(graph, robots, attack_time, travel_times=travel_times)
    say("bounding the capture with any memory")
    bound = capture_bound(
        graph,
        attack_time,
        travel_times=travel_times,
        robots=robots,
        stay=stay,
        captured=max(least),
        tests=tests,
    )
    shares = long_run(walks[best]) @ states_at(walks[best].shape[1], graph.vertices)
    return MemoryPatrol(
        walk=[*(f"memory {size}" for size in sizes), "tour" if robots == 1 else "round"],
        least_capture=np.array([*least, on_tour.watched_capture]),
        any_time=np.array([*(float(blind.min()) for _, blind in captured), on_tour.least_capture]),
        upper_bound=bound,
        memory=sizes[best],
        vertex=names_of(graph.vertices, names),
        chance=walks[best],
        shares=shares,
        captured=captured[best][0],
        blind_captured=captured[best][1],
    )
