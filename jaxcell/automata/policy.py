import dataclasses
import functools
import graphlib
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Int, Int32

from ..base.shown import Shown
from .formats.storage import checked_metadata, reading, write_arrays


@dataclasses.dataclass(frozen=True, eq=False)
class Onward:
    """The bumps of a robot that goes on after the end of its policy, and turns by one angle.

    Entry `i` belongs to a robot at a bump in configuration `at[i]`, before its turn.
    """

    turn: int
    "The index of the angle by which the robot turns at each bump."
    at: Int32[np.ndarray, "bumps"]
    "The configurations at a bump, in ascending order."
    steps: Int32[np.ndarray, "bumps"]
    "The number of steps from each to the next bump."
    target: Int32[np.ndarray, "bumps"]
    "The entry of the configuration at the next bump."

    def __post_init__(self) -> None:
        if self.turn < 0:
            raise ValueError(f"onward: expected the index of an angle, got {self.turn}")
        if np.any(np.diff(self.at) <= 0) or self.steps.min(initial=0) < 0:
            raise ValueError("onward: expected ascending configurations, and steps from 0")
        if not np.all((self.target >= 0) & (self.target < self.at.size)):
            raise ValueError(f"onward: expected each target below {self.at.size}")


@dataclasses.dataclass(frozen=True, eq=False)
class Policy(Shown):
    """A localization policy: the angle by which a robot turns at each bump until it is localized.

    A state is a set of possible configurations of the robot at a bump; state 0 is the start, before
    the first bump. Each possible number of steps to the next bump leads to another state; an
    impossible number refutes the map. In a state that leads to no other state, an *end*, the robot
    is localized.

    A first bump after two steps localizes the robot. After a bump without a step it turns by angle
    1, and the next bump, after three steps, localizes it:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> policy = automata.Policy(
        ...     turn=np.int32([-1, 1, -1, -1]), first=np.int32([0, 2, 3, 3, 3]),
        ...     steps=np.int32([0, 2, 3]), target=np.int32([1, 2, 3]),
        ...     offsets=np.int32([0, 5, 7, 8, 9]), members=np.int32([0, 1, 2, 3, 4, 1, 3, 4, 0]),
        ... )
        >>> state = policy.start().observe(1)
        >>> state.turn, state.uncertainty
        (1, 2)
        >>> for observation in (0, 0, 0, 1):
        ...     state = state.observe(observation)
        >>> state.localized, state.cells.tolist()
        (True, [0])
    """

    turn: Int32[np.ndarray, "states"]
    "The index of the angle by which the robot turns in each state; -1 at the start and at ends."
    first: Int32[np.ndarray, "states+1"]
    "State `i` has the entries `first[i]` to `first[i + 1] - 1` of `steps` and `target`."
    steps: Int32[np.ndarray, "bumps"]
    "The possible numbers of steps from each state to the next bump, in ascending order."
    target: Int32[np.ndarray, "bumps"]
    "The state at the next bump, for each number in `steps`."
    offsets: Int32[np.ndarray, "states+1"]
    "The configurations of state `i` are `members[offsets[i] : offsets[i + 1]]`."
    members: Int32[np.ndarray, "total"]
    "The possible configurations in each state, in ascending order, one state after the other."
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    "A JSON object that is stored with the policy, such as its map and the angles."
    onward: Onward | None = None
    """The bumps after the end of the policy, by which further observations confirm or refute the
    map; `None` if they are unknown."""

    def __post_init__(self) -> None:
        states = self.turn.size
        for name, bounds, total in (
            ("first", self.first, self.steps.size),
            ("offsets", self.offsets, self.members.size),
        ):
            if bounds[0] != 0 or bounds[-1] != total or np.any(np.diff(bounds) < 0):
                raise ValueError(f"{name}: expected to rise from 0 to {total}")
        if states < 2:
            raise ValueError("turn: expected a start, and a state after it")
        owner = np.repeat(np.arange(states), np.diff(self.first))
        falls = (np.diff(owner) == 0) & (np.diff(self.steps) <= 0)
        if self.steps.min(initial=0) < 0 or falls.any():
            raise ValueError("steps: expected numbers from 0, rising in each state")
        # States are numbered in the order in which they are met, so the start leads to all others.
        new = np.maximum.accumulate(np.append(0, self.target))
        if self.target.min(initial=1) < 1 or new[-1] != states - 1 or np.any(np.diff(new) > 1):
            raise ValueError("target: expected states in the order in which they are met")
        try:
            graphlib.TopologicalSorter({x: self.after(x).values() for x in range(states)}).prepare()
        except graphlib.CycleError:
            raise ValueError("target: expected no state to lead back to itself") from None
        turns = np.diff(self.first) > 0
        turns[0] = False
        if np.any((self.turn >= 0) != turns) or self.turn.min() < -1:
            raise ValueError("turn: expected an angle where steps follow a bump, and -1 elsewhere")
        if self.onward is not None:
            ends = np.isin(np.repeat(np.arange(states), np.diff(self.offsets)), self.ends)
            if not np.isin(self.members[ends], self.onward.at).all():
                raise ValueError("onward: expected each configuration in which the policy ends")
        object.__setattr__(self, "metadata", checked_metadata(self.metadata))

    @property
    def trap(self) -> int:
        """The `index` of a [`PolicyState`][] after a refutation; it equals the number of states."""
        return self.turn.size

    @functools.cached_property
    def ends(self) -> Int32[np.ndarray, "ends"]:
        """The states in which the robot is localized."""
        return np.flatnonzero(np.diff(self.first) == 0).astype(np.int32)

    @functools.cached_property
    def color(self) -> Int32[np.ndarray, "states"]:
        """The colour of each state: 2, 3, ... for states in which the policy ends, 1 for others."""
        color = np.ones(self.turn.size, np.int32)
        color[self.ends] = 2 + np.arange(self.ends.size)
        return color

    @functools.cached_property
    def uncertainty(self) -> Int32[np.ndarray, "states"]:
        """The number of possible configurations in each state."""
        return np.diff(self.offsets).astype(np.int32)

    def cells(self, state: int) -> Int32[np.ndarray, "configurations"]:
        """Return the configurations that are possible in a state, in ascending order."""
        if not 0 <= state < self.turn.size:
            raise ValueError(f"state {state} does not exist; there are {self.turn.size}")
        return self.members[self.offsets[state] : self.offsets[state + 1]]

    def after(self, state: int) -> dict[int, int]:
        """Return the next state for each possible number of steps from a state to the next bump."""
        bumps = slice(self.first[state], self.first[state + 1])
        return dict(zip(self.steps[bumps].tolist(), self.target[bumps].tolist(), strict=True))

    def next_states(
        self, state: Int[np.ndarray, "robots"], steps: Int[np.ndarray, "robots"]
    ) -> Int[np.ndarray, "robots"]:
        """Return the state of each robot at its next bump after `steps`; -1 if it is impossible."""
        key = state * self._width + np.minimum(steps, self._width - 1)
        bump = np.searchsorted(self._keys, key)
        return np.where(self._keys[bump] == key, np.append(self.target, -1)[bump], -1)

    @functools.cached_property
    def _keys(self) -> Int[np.ndarray, "keys"]:
        """The keys, in ascending order, of the next bumps; the last key belongs to none."""
        owner = np.repeat(np.arange(self.turn.size), np.diff(self.first))
        return np.append(owner * self._width + self.steps, self.turn.size * self._width)

    @functools.cached_property
    def _width(self) -> int:
        """A number above all numbers of steps, and above one that no bump has."""
        return int(self.steps.max()) + 2

    def start(self) -> "PolicyState":
        """Return the state before the first observation."""
        return PolicyState(self, 0, 0, 0, None)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy to a file with a checksum, completely or not at all.

        Equal policies give equal bytes.
        """
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        if self.onward is not None:
            arrays |= {f"onward_{name}": getattr(self.onward, name) for name in _ONWARD}
            arrays["onward_turn"] = np.array([self.onward.turn], np.int32)
        write_arrays(path, {"kind": "policy", "metadata": self.metadata}, arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Policy":
        """Read a policy that [`Policy.save`][] wrote."""
        with reading(path, "policy") as (header, arrays):
            named = {name: arrays[name] for name in _ARRAYS}
            sizes = {name: array.size for name, array in named.items()}
            if not (
                sizes["first"] == sizes["offsets"] == sizes["turn"] + 1
                and sizes["steps"] == sizes["target"]
            ):
                raise ValueError("its tables are of different lengths")
            onward = None
            # Earlier versions of jaxcell did not write these tables.
            if any(name.startswith("onward_") for name in arrays):
                tables = [arrays[f"onward_{name}"] for name in _ONWARD]
                if len({table.size for table in tables}) > 1:
                    raise ValueError("its tables are of different lengths")
                onward = Onward(arrays["onward_turn"].item(), *tables)
            return Policy(**named, metadata=header["metadata"], onward=onward)


_ARRAYS = ("turn", "first", "steps", "target", "offsets", "members")
_ONWARD = ("at", "steps", "target")


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class PolicyState(Shown):
    """The state of a policy after some observations; `observe` returns a new object.

    After an impossible observation the map stays refuted. After the end of the policy, it accepts
    further observations if the policy has the table `onward`, and if the robot turns by
    `onward.turn` at each bump.
    """

    policy: Policy
    index: int
    "The state of the policy at its last bump; `Policy.trap` if the map is refuted."
    steps: int
    "The number of steps since the last bump."
    time: int
    "The number of observations so far."
    refuted_at: int | None
    "The index of the first observation that is impossible on the map; `None` if all are possible."
    left: Int32[np.ndarray, "_"] | None = None
    """The entries of `Policy.onward` that were possible at the last bump; `None` before the first
    observation after the end of the policy."""

    def observe(self, observation: int) -> "PolicyState":
        """Return the state after one more observation, 0 for a step or 1 for a bump."""
        if observation not in (0, 1):
            raise ValueError(f"observation {self.time} is {observation!r}; expected 0 or 1")
        if self.refuted:
            return self._next(self.index, 0)
        if self.localized:
            return self._go_on(observation)
        onward = self.policy.after(self.index)
        if observation == 0 and self.steps < max(onward):
            return self._next(self.index, self.steps + 1)
        if observation == 1 and self.steps in onward:
            return self._next(onward[self.steps], 0)
        return self._refute()

    def _go_on(self, observation: int) -> "PolicyState":
        table = self.policy.onward
        if table is None:
            raise ValueError(f"observation {self.time}: expected none, as the policy has ended")
        entries = self._entries(table)
        steps = table.steps[entries]
        if observation == 0 and self.steps < steps.max():
            return self._next(self.index, self.steps + 1, entries)
        bumped = table.target[entries[steps == self.steps]]
        if observation == 1 and bumped.size:
            return self._next(self.index, 0, np.unique(bumped))
        return self._refute()

    def _entries(self, table: Onward) -> Int32[np.ndarray, "_"]:
        if self.left is not None:
            return self.left
        return np.searchsorted(table.at, self.policy.cells(self.index)).astype(np.int32)

    def _next(
        self, index: int, steps: int, left: Int32[np.ndarray, "_"] | None = None
    ) -> "PolicyState":
        return PolicyState(self.policy, index, steps, self.time + 1, self.refuted_at, left)

    def _refute(self) -> "PolicyState":
        return PolicyState(self.policy, self.policy.trap, 0, self.time + 1, self.time)

    @property
    def color(self) -> int:
        """The state's colour in [`Policy.color`][]; one above the largest if the map is refuted."""
        if self.refuted:
            return len(self.policy.ends) + 2
        return self.policy.color.item(self.index)

    @property
    def turn(self) -> int | None:
        """The index of the angle by which the robot has to turn now; `None` if it does not turn."""
        if self.steps or self.refuted:
            return None
        turn: int = self.policy.turn.item(self.index)
        return None if turn < 0 else turn

    @property
    def uncertainty(self) -> int:
        """The number of possible configurations of the robot."""
        if self.refuted:
            return 0
        table = self.policy.onward
        if self.localized and table is not None:
            return int((table.steps[self._entries(table)] >= self.steps).sum())
        if not self.steps:
            return self.policy.uncertainty.item(self.index)
        return sum(
            self.policy.uncertainty.item(target)
            for steps, target in self.policy.after(self.index).items()
            if steps >= self.steps
        )

    @property
    def localized(self) -> bool:
        """`True` if the policy has ended."""
        return not self.refuted and self.color > 1

    @property
    def refuted(self) -> bool:
        """`True` if an observation was impossible, so that the robot cannot be on the map."""
        return self.refuted_at is not None

    @property
    def cells(self) -> Int32[np.ndarray, "configurations"]:
        """The possible configurations at a bump; none between bumps, or if the map is refuted."""
        if self.steps or self.refuted:
            return np.empty(0, np.int32)
        if self.left is not None and self.policy.onward is not None:
            return self.policy.onward.at[self.left]
        return self.policy.cells(self.index)
