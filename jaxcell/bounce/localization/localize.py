import dataclasses
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Int

from ...automata import Filter, Policy, subset_construction
from ...base.quantities import Result, derived, quantity
from ...mapping import SimpleMap
from ..dynamics import check_cell


Observations: TypeAlias = Annotated[
    Int[np.ndarray, "steps"],
    quantity("move", "observation of the robot", values="0: it moved, 1: it bumped"),
]
Candidates: TypeAlias = Annotated[
    Int[np.ndarray, "candidates"],
    quantity("candidate", "where the robot may be at the end", kind="cell", listed=True),
]


def localization_filter(
    simple_map: SimpleMap, *, open_world: bool = False, metadata: Mapping[str, Any] | None = None
) -> Filter:
    """Build the filter that localizes a robot from its bumps and its clock (Alam 2018, sec. 2.4).

    It runs on the host, because the number of I-states depends on the map.

    The I-state graph of the map (I for information) is a nondeterministic automaton that may start
    in any cell. Subset construction makes it deterministic. On a knowledge cycle, which is a cycle
    without exits, the robot is localized. Each cycle has a colour, the output of its states.

    **Arguments:** the bounce map, and metadata to save with the filter. If `open_world` is true, an
    observation that cannot occur on the map leads to a trap state (Definition 2.4.6); otherwise it
    is an error (Definition 2.4.5). **Returns:** the filter.

    The laboratory of the dissertation, with the states and uncertainties of its Tables 2.1 and 2.2:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.lab()
        >>> bounces = bounce.bounce_map(cells, math.radians(45), motion=bounce.ENDPOINT)
        >>> filter = bounce.localization_filter(bounces)
        >>> len(filter.transition), sorted(cycle.uncertainty for cycle in filter.cycles)
        (129, [1, 3, 4])
    """
    automaton = subset_construction(np.asarray(simple_map.image), np.asarray(simple_map.bumped))
    return Filter.of(automaton, open_world=open_world, metadata=metadata or {})


@dataclasses.dataclass(frozen=True, eq=False)
class Localization(Result):
    """A run of a robot from an unknown cell until its filter is in a knowledge cycle."""

    observations: Observations
    path: Annotated[
        Int[np.ndarray, "steps+1"], quantity("time", "cell that the robot is in", kind="cell")
    ]
    states: Annotated[
        Int[np.ndarray, "steps+1"], quantity("time", "state of the filter", kind="index")
    ]
    candidates: Candidates

    @derived("", "start", kind="cell")
    def start(self) -> int:
        return int(self.path[0])

    @derived("", "observations, 1 for a bump")
    def word(self) -> str:
        return "".join(map(str, self.observations.tolist()))

    @derived("", "steps", kind="count")
    def steps(self) -> int:
        return int((self.observations == 0).sum())

    @derived("", "bumps", kind="count")
    def bumps(self) -> int:
        return int((self.observations == 1).sum())

    @derived("", "end", kind="cell")
    def end(self) -> int:
        return int(self.path[-1])

    @derived("", "whether the truth is among the candidates", kind="flag")
    def truth_is_a_candidate(self) -> bool:
        return bool(np.isin(self.end, self.candidates))


def localize(simple_map: SimpleMap, filter: Filter, start: int) -> Localization:
    """Drive a simulated robot from a cell until the filter enters a knowledge cycle.

    **Arguments:** the bounce map, a filter, and a cell. **Returns:** the run. It has no candidates
    if the filter was built for another map and ends in its trap.

    A corridor of three squares looks the same from both ends, so two configurations remain:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounces = bounce.bounce_map(cells, math.pi)
        >>> run = bounce.localize(bounces, bounce.localization_filter(bounces), start=0)
        >>> run.observations.tolist(), run.candidates.tolist()
        ([0, 0], [2, 3])
    """
    image, bumped = np.asarray(simple_map.image), np.asarray(simple_map.bumped)
    start = check_cell(start, image.size)
    return drive_until_localized(filter, start, bumped, lambda cell, _: image[cell])


def drive_until_localized(
    automaton: Filter | Policy,
    start: int,
    bumped: Bool[np.ndarray, "cells"],
    after: Callable[[int, Any], Any],
) -> Localization:
    """Drive a simulated robot until a filter or a policy localizes it.

    `bumped` is a mask of the cells where the robot bumps. `after(cell, state)` is the next cell of
    the robot, where `state` is the state of the filter or the policy after the observation.
    """
    cell, state = start, automaton.start()
    path, observations, states = [cell], [], [state.index]
    while not (state.localized or state.refuted):
        observations.append(int(bumped[cell]))
        state = state.observe(observations[-1])
        cell = int(after(cell, state))
        path.append(cell)
        states.append(state.index)
    return Localization(
        np.array(observations, np.int8),
        np.array(path, np.int32),
        np.array(states, np.int32),
        state.cells,
    )
