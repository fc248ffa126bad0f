import dataclasses
import functools
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Int32, Int64, Shaped

from ..base.shown import Shown
from .cycles import KnowledgeCycle, knowledge_cycles
from .formats.storage import checked_metadata, reading, write_arrays
from .subset import Automaton


CONFIRM = 30
"""The default number of further observations that confirm the place of a robot.

Filters leave one configuration on wrong maps, too. On eight bundled maps, 44 % of the starts on
another map of the eight are localized at once, 1.9 % after 10 further observations that agree with
the map of the filter, 0.16 % after 20, and 0.003 % after 30.
"""

# Observations 0 and 1, as the digits of a string or as numbers.
Observations = str | Iterable[int] | Shaped[np.ndarray, "_"]


@dataclasses.dataclass(frozen=True, eq=False)
class Filter(Shown):
    """A localization filter, an automaton with colours (Alam 2018, Definitions 2.4.5 and 2.4.6).

    State 0 is the start. States are numbered in breadth-first order, observation 0 before 1.
    [`Filter.of`][] builds a filter from an automaton; the constructor only checks its arguments.

    Three cells in a ring, with a bump between cells 2 and 0:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> image, bumped = np.array([1, 2, 0]), np.array([False, False, True])
        >>> filter = automata.Filter.of(automata.subset_construction(image, bumped))
        >>> filter.color.tolist(), filter.uncertainty.tolist()
        ([1, 1, 2, 2, 2], [3, 2, 1, 1, 1])
        >>> [cycle.word for cycle in filter.cycles]
        ['001']
        >>> run = filter.run("01")
        >>> run.localized_at, filter.cells(int(run.states[-1])).tolist()
        (2, [0])
    """

    transition: Int32[np.ndarray, "states 2"]
    "The state after observation 0 or 1, or -1 if that observation cannot occur."
    uncertainty: Int32[np.ndarray, "states"]
    "The number of possible configurations in each state, 0 in the trap."
    offsets: Int64[np.ndarray, "states+1"]
    "The configurations of state `i` are `members[offsets[i] : offsets[i + 1]]`."
    members: Int32[np.ndarray, "total"]
    "The possible configurations in each state, in ascending order, one state after the other."
    open_world: bool = False
    "`True` if the last state is a trap, to which impossible observations lead."
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    "A JSON object that is stored with the filter, such as its map and the bouncing angle."

    def __post_init__(self) -> None:
        transition, offsets, states = self.transition, self.offsets, len(self.transition)
        if states <= self.open_world:
            raise ValueError(
                f"transition: {states} states; expected a start" + " and a trap" * self.open_world
            )
        if transition.min() < -1 or transition.max() >= states:
            raise ValueError(f"transition: expected states from 0 to {states - 1}, or -1 for none")
        total = self.members.size
        if offsets[0] != 0 or offsets[-1] != total or np.any(np.diff(offsets) < 0):
            raise ValueError(f"offsets: expected to rise from 0 to the {total} members")
        if self.open_world and (transition.min() < 0 or np.any(transition[-1] != states - 1)):
            raise ValueError(
                "transition: expected every observation and, as last state, a trap in an open world"
            )
        # The largest state met before each edge grows by 1; a state is met before its edges.
        closed = self.closed_transition
        met = np.maximum.accumulate(np.append(0, closed.ravel()))
        late = met[:-1:2] < np.arange(len(closed))
        if met[-1] != len(closed) - 1 or np.any(np.diff(met) > 1) or np.any(late):
            raise ValueError(
                "transition: expected states in breadth-first order from state 0, each reached"
            )
        object.__setattr__(self, "metadata", checked_metadata(self.metadata))

    @staticmethod
    def of(
        automaton: Automaton, *, open_world: bool = False, metadata: Mapping[str, Any] | None = None
    ) -> "Filter":
        """Build the filter of a deterministic I-state automaton, by default without a trap.

        `metadata` is a JSON object to store with the filter.
        """
        closed = Filter(
            transition=automaton.transition,
            uncertainty=np.diff(automaton.offsets).astype(np.int32),
            offsets=automaton.offsets,
            members=automaton.members,
            metadata=metadata or {},
        )
        return closed.with_trap() if open_world else closed

    def with_trap(self) -> "Filter":
        """Return the open-world filter, in which every impossible observation leads to a trap.

        The trap is the last state; it has no exits (Alam 2018, Definition 2.4.6).
        """
        if self.open_world:
            return self
        trap = len(self.transition)
        transition = np.append(self.transition, np.full((1, 2), trap, np.int32), axis=0)
        return dataclasses.replace(
            self,
            transition=np.where(transition < 0, np.int32(trap), transition),
            uncertainty=np.append(self.uncertainty, np.int32(0)),
            offsets=np.append(self.offsets, self.offsets[-1]),
            open_world=True,
        )

    @property
    def trap(self) -> int | None:
        """The number of the trap, the last state of an open-world filter; otherwise `None`."""
        return len(self.transition) - 1 if self.open_world else None

    @functools.cached_property
    def cycles(self) -> tuple[KnowledgeCycle, ...]:
        """The knowledge cycles in the order of their smallest states, with colours 2, 3, ..."""
        transition = self.closed_transition
        return knowledge_cycles(transition, self.uncertainty[: len(transition)])

    @property
    def closed_transition(self) -> Int32[np.ndarray, "ordinary 2"]:
        """The transitions between all states except the trap; -1 for an impossible observation."""
        if not self.open_world:
            return self.transition
        transition = self.transition[:-1]
        return np.where(transition == self.trap, np.int32(-1), transition)

    @functools.cached_property
    def color(self) -> Int32[np.ndarray, "states"]:
        """Each state's colour: 2, 3, ... in knowledge cycles, 1 elsewhere; highest in the trap."""
        color = np.ones(len(self.transition), np.int32)
        for cycle in self.cycles:
            color[cycle.states] = cycle.color
        if self.open_world:
            color[-1] = len(self.cycles) + 2
        return color

    def cells(self, state: int) -> Int32[np.ndarray, "configurations"]:
        """Return the configurations that are possible in a state, in ascending order."""
        if not 0 <= state < len(self.transition):
            raise ValueError(f"state {state} does not exist; there are {len(self.transition)}")
        cells = self.members[self.offsets[state] : self.offsets[state + 1]]
        cells.flags.writeable = False
        return cells

    def start(self) -> "FilterState":
        """Return the state before the first observation."""
        return FilterState(self, 0, 0, None)

    def run(self, observations: Observations) -> "FilterRun":
        """Run the filter on observations 0 and 1, as numbers or as a string of digits.

        It raises `ValueError` for an impossible observation, except in an open-world filter.
        """
        state = self.start()
        states = [state.index]
        for observation in digits(observations):
            state = state.observe(observation)
            states.append(state.index)
        path = np.array(states, np.int32)
        colors = self.color[path]
        localized = np.flatnonzero((colors > 1) & (path != self.trap))
        return FilterRun(
            states=path,
            colors=colors,
            refuted_at=state.refuted_at,
            localized_at=localized.item(0) if localized.size else None,
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the filter to a file with a checksum, completely or not at all.

        Equal filters give equal bytes.
        """
        header = {"kind": "filter", "open_world": self.open_world, "metadata": self.metadata}
        arrays = {
            "transition": self.transition.ravel(),
            "uncertainty": self.uncertainty,
            "sizes": np.diff(self.offsets).astype(np.int32),
            "members": self.members,
        }
        write_arrays(path, header, arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Filter":
        """Read a filter that [`Filter.save`][] wrote."""
        with reading(path, "filter") as (header, arrays):
            sizes = arrays["sizes"]
            if (
                arrays["transition"].size != 2 * sizes.size
                or arrays["uncertainty"].size != sizes.size
            ):
                raise ValueError("its tables are of different lengths")
            return Filter(
                transition=arrays["transition"].reshape(-1, 2),
                uncertainty=arrays["uncertainty"],
                offsets=np.append(0, np.cumsum(sizes, dtype=np.int64)),
                members=arrays["members"],
                open_world=bool(header["open_world"]),
                metadata=header["metadata"],
            )


@dataclasses.dataclass(frozen=True, eq=False)
class FilterRun(Shown):
    """The states and colours that a filter passes through on an observation string.

    Entry `i` of `states` is the state after `i` observations, and entry `i` of `colors` its colour.
    """

    states: Int32[np.ndarray, "entries"]
    "The states of the filter."
    colors: Int32[np.ndarray, "entries"]
    "The colours of the states."
    refuted_at: int | None
    "The index of the first observation that is impossible on the map; `None` if all are possible."
    localized_at: int | None
    "The index in `states` of the first state in a knowledge cycle, or `None`."


@dataclasses.dataclass(slots=True, eq=False)
class FilterState(Shown):
    """The state of a filter after some observations; `observe` returns a new object.

    Each observation takes constant time and memory.
    """

    filter: Filter
    index: int
    "The index of the filter's current state."
    time: int
    "The number of observations so far."
    refuted_at: int | None
    "The index of the first observation that is impossible on the map; `None` if all are possible."

    def observe(self, observation: int) -> "FilterState":
        """Return the state after one more observation, 0 or 1."""
        if observation not in (0, 1):
            raise ValueError(f"observation {self.time} is {observation!r}; expected 0 or 1")
        index = self.filter.transition.item(self.index, int(observation))
        refuted_at = self.refuted_at
        if index < 0:
            raise ValueError(
                f"observation {self.time} is {int(observation)}, which cannot occur in this map "
                "after those before it; only an open-world filter allows for another map"
            )
        if refuted_at is None and index == self.filter.trap:
            refuted_at = self.time
        return FilterState(self.filter, index, self.time + 1, refuted_at)

    @property
    def color(self) -> int:
        """The colour of the state, the output of the filter."""
        return self.filter.color.item(self.index)

    @property
    def uncertainty(self) -> int:
        """The number of possible configurations of the robot."""
        return self.filter.uncertainty.item(self.index)

    @property
    def localized(self) -> bool:
        """`True` if the filter is in a knowledge cycle."""
        return self.color > 1 and self.index != self.filter.trap

    @property
    def refuted(self) -> bool:
        """`True` if an observation was impossible, so that the robot cannot be on the map."""
        return self.refuted_at is not None

    @property
    def cells(self) -> Int32[np.ndarray, "configurations"]:
        """The possible configurations of the robot, in ascending order."""
        return self.filter.cells(self.index)


def digits(observations: Observations) -> Iterable[int]:
    """Convert observations to numbers; a string has one digit per observation."""
    if isinstance(observations, np.ndarray):
        return observations.tolist()
    if not isinstance(observations, str):
        return observations
    for index, character in enumerate(observations):
        if character not in "01":
            raise ValueError(f"observation {index} is {character!r}; expected 0 or 1")
    return map(int, observations)
