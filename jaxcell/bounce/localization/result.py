import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Int

from ...automata import Filter, Policy, Smallest, minimize
from ...automata.filter import CONFIRM
from ...base.formatting import configuration, counted, percent
from ...base.quantities import Checks, Result, derived, from_part
from ...space import CellSpace, Motion
from ...space.touching import touching_steps
from ..dynamics import bounce_map, bounce_shift, candidate_poses, robots_over_time
from ..group_results import BounceGroups
from .corners import filter_touches
from .localize import Localization
from .off_centre import OBSERVATIONS, STARTS, Shares, filter_shares
from .other_rooms import MOST_CELLS, ROOMS, filter_agreement


# The share of robots in other rooms that may be localized without a remark.
_RARE = 1e-3
# Number of possible cells of a robot that the answer names.
_NAMED = 4


class States(Result):
    """The states of a filter or a policy.

    The possible cells of state `s` are `member[offset[s]:offset[s + 1]]`.
    """

    smallest: Smallest | None
    "The smallest machine with the same outputs; `None` if it was not searched for."

    @derived("", "states, smallest", "1", kind="count")
    def smallest_states(self) -> int | None:
        return None if self.smallest is None else self.smallest.states

    @derived("", "states that are needed, by proof", "1", kind="count")
    def smallest_bound(self) -> int | None:
        return None if self.smallest is None else self.smallest.bound

    @property
    def automaton(self) -> Filter | Policy:
        raise NotImplementedError

    uncertainty = from_part(
        "automaton.uncertainty", "state", "cells where the robot may be", "cells", kind="count"
    )
    offset = from_part(
        "automaton.offsets", "state_bound", "first entry of the state in member", kind="count"
    )
    member = from_part("automaton.members", "entry", "cells of the states in turn", kind="index")


@dataclasses.dataclass(frozen=True, eq=False)
class LocalizationFilter(States):
    """The localization filter of a map, with its states and knowledge cycles.

    The possible cells of state `s` are `member[offset[s]:offset[s + 1]]`, and the states of
    knowledge cycle `c`, in their order, are `cycle_state[cycle_offset[c]:cycle_offset[c + 1]]`.
    """

    title: ClassVar[str] = "Localization filter of a bouncing robot"
    tables: ClassVar[Mapping[str, str]] = {"cycle": "cycles"}

    filter: Filter
    smallest: Smallest | None = dataclasses.field(default=None, kw_only=True)

    @property
    def automaton(self) -> Filter:
        return self.filter

    @derived("", "states, nondeterministic", "1", kind="count")
    def nfa_states(self) -> int:
        return int(self.filter.uncertainty[0]) + 1

    @derived("", "states, deterministic", "1", kind="count")
    def dfa_states(self) -> int:
        return len(self.filter.transition) - self.filter.open_world

    @derived("", "states, minimal", "1", kind="count")
    def minimal_states(self) -> int:
        return len(minimize(self.filter).transition) - self.filter.open_world

    @derived("", "knowledge cycles", "1", kind="count")
    def knowledge_cycles(self) -> int:
        return len(self.filter.cycles)

    @derived("", "possible cells at the end, at best", "1", kind="count")
    def least_uncertainty(self) -> int:
        return int(self.cycle_uncertainty.min())

    @derived("", "possible cells at the end, at worst", "1", kind="count")
    def largest_uncertainty(self) -> int:
        return int(self.cycle_uncertainty.max())

    @derived("cycle", "colour of the cycle", kind="count")
    def cycle_color(self) -> Int[np.ndarray, "cycles"]:
        return np.array([cycle.color for cycle in self.filter.cycles], np.int32)

    @derived("cycle", "cells where the robot may be", "1", kind="count")
    def cycle_uncertainty(self) -> Int[np.ndarray, "cycles"]:
        return np.array([cycle.uncertainty for cycle in self.filter.cycles], np.int32)

    @derived("cycle", "states of the cycle", kind="count")
    def cycle_length(self) -> Int[np.ndarray, "cycles"]:
        return np.array([len(cycle.states) for cycle in self.filter.cycles], np.int32)

    @derived("cycle_bound", "first entry of the knowledge cycle in cycle_state", kind="count")
    def cycle_offset(self) -> Int[np.ndarray, "bounds"]:
        return np.cumsum([0, *self.cycle_length], dtype=np.int64)

    @derived("cycle_entry", "states of the knowledge cycles in turn", kind="index")
    def cycle_state(self) -> Int[np.ndarray, "entries"]:
        return np.concatenate([cycle.states for cycle in self.filter.cycles])

    @derived("observation", "observation of the robot", kind="coordinate", values="1: it bumped")
    def observation(self) -> Int[np.ndarray, "2"]:
        return np.arange(2, dtype=np.int32)

    transition = from_part(
        "filter.transition",
        "state observation",
        "state after an observation that may occur",
        kind="index",
    )
    color = from_part(
        "filter.color", "state", "colour: 1 outside the knowledge cycles", kind="count"
    )

    def checks(self) -> Checks:
        # The cells that are left after the two observations are images of the cells before.
        known = np.where(self.transition >= 0, self.uncertainty[self.transition], 0)
        gain = known.sum(axis=1) > self.uncertainty
        members = np.abs(self.uncertainty - np.diff(self.offset)).max()
        return {
            "uncertainty_minus_members": (int(members), 0),
            "states_that_gain_cells": (int(np.count_nonzero(gain)), 0),
        }


class Evidence(Result):
    """The shares of robots in other rooms, and off the centres of cells, that are localized."""

    cells: CellSpace

    @functools.cached_property
    def off_centre(self) -> Shares:
        """The shares of robots, started anywhere in the cells, that are not located."""
        raise NotImplementedError

    @functools.cached_property
    def agreement(self) -> Mapping[int, float]:
        """The shares of robots in random other rooms that count as localized.

        The keys are numbers of further observations that confirm the place of a robot. Without
        keys, the map has too many cells.
        """
        raise NotImplementedError

    @property
    def evidence(self) -> dict[str, Any]:
        """The fields of a file of a robot that say how sure its answers are."""
        shares = {str(confirm): share for confirm, share in self.agreement.items()}
        return {"other_room_shares": shares, "other_rooms": ROOMS}

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = list(super().remarks)
        if not self.agreement:
            remarks.append(
                "How many robots in other rooms are localized is not computed for more than "
                f"{MOST_CELLS:,} cells."
            )
        elif self.agreement[CONFIRM] > _RARE:
            rare = (confirm for confirm, share in self.agreement.items() if share <= _RARE)
            enough = next(rare, max(self.agreement))
            least = f"{percent(self.agreement[enough])} with `robot run --confirm {enough}`"
            if self.agreement[enough] > _RARE:
                least += "; another angle may leave fewer, because robots repeat longer loops"
            remarks.append(
                f"Of robots in {ROOMS} random other rooms, {percent(self.agreement[CONFIRM])} "
                f"are localized after {CONFIRM} further observations, and {least}."
            )
        return tuple(remarks)

    @derived("", "robots in other rooms that are localized", kind="share")
    def other_room_share(self) -> float | None:
        return self.agreement.get(CONFIRM)

    lost_share = from_part(
        "off_centre.lost", "", "off-centre starts that the filter loses", kind="share"
    )
    wrong_share = from_part(
        "off_centre.wrong", "", "off-centre starts that are localized wrongly", kind="share"
    )


class RunOnMap(Evidence):
    """The run of a simulated robot on a map, with the cells where the robot may be."""

    run: Localization
    may_lose: ClassVar[bool] = False
    "True if the possible cells may exclude the true cell, as with a filter of another map."

    candidate_x, candidate_y, candidate_theta_deg = candidate_poses("run.candidates")

    @property
    def beliefs(self) -> list[Int[np.ndarray, "_"]]:
        """The possible cells of the robot at each time."""
        raise NotImplementedError

    @property
    def answer(self) -> tuple[str, ...]:
        run, ends = self.run, self.run.candidates.tolist()
        after = f"After {counted(run.steps, 'step')} and {counted(run.bumps, 'bump')}"
        if not ends:
            return (f"{after} the simulated robot is refuted: it is on another map.",)
        places = "; or at ".join(configuration(self.cells, z) for z in ends[:_NAMED])
        more = f"; or in {len(ends) - _NAMED:,} other cells" if len(ends) > _NAMED else ""
        return (f"{after} the simulated robot is at {places}{more}.",)

    @functools.cached_property
    def touching(self) -> Bool[np.ndarray, "cells"]:
        """A mask of the starts from which a robot touches a wall before it is localized."""
        raise NotImplementedError

    @property
    def evidence(self) -> dict[str, Any]:
        return {**super().evidence, "touching_starts": self.touching_starts}

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = list(super().remarks)
        if any(self.off_centre):
            lost, wrong = (f"{100 * share:.3g} %" for share in self.off_centre)
            remarks.append(
                f"This assumes a start at the centre of a cell. Of {STARTS:,} robots that start "
                f"anywhere in the cells it loses {lost} within {OBSERVATIONS} observations and "
                f"places {wrong} wrongly; `jaxcell localize anywhere` loses none."
            )
        if self.touching_starts:
            remarks.append(
                f"From {self.touching_starts:,} of {self.cells.size:,} starts a robot touches a "
                "corner or a wall that it passes, before it is localized and confirmed; a real "
                "robot may bump there, which refutes the map. Another cell size, angle or radius "
                "may avoid it."
            )
        return tuple(remarks)

    @derived("", "starts from which a robot touches a corner", kind="count")
    def touching_starts(self) -> int:
        return int(self.touching.sum())

    def _pose(self, cell: int) -> str:
        x, y, theta = map(float, self.cells.centre(cell))
        return f"{x:g} m, {y:g} m, {math.degrees(theta):g}°"

    @derived("", "pose at the start")
    def start_pose(self) -> str:
        return self._pose(self.run.start)

    @derived("", "pose at the end")
    def end_pose(self) -> str:
        return self._pose(self.run.end)

    time, robot_x, robot_y, robot_theta = robots_over_time("run.path", "time")

    @derived("time", "cells where the robot may be", "cells", kind="count")
    def belief_size(self) -> Int[np.ndarray, "times"]:
        return np.array([cells.size for cells in self.beliefs], np.int32)

    def checks(self) -> Checks:
        beliefs, left = self.beliefs, self.run.candidates
        lost = sum(not np.isin(z, cells) for z, cells in zip(self.run.path, beliefs, strict=True))
        return {
            **super().checks(),
            "candidates_not_of_the_last_state": (
                np.setxor1d(left, beliefs[-1]).size,
                0,
            ),
            "states_without_the_robot": (lost, math.inf if self.may_lose else 0),
        }


@dataclasses.dataclass(frozen=True, eq=False)
class Localized(RunOnMap, LocalizationFilter):
    """A localization filter of a map, and the run of a robot that the filter localizes.

    The constructor checks that the filter and the run belong to the cells.
    """

    title: ClassVar[str] = "Localization of a bouncing robot by its bumps"
    # The filter may be of another map.
    may_lose: ClassVar[bool] = True
    picture: ClassVar[str] = "belief_size"
    tables: ClassVar[Mapping[str, str]] = {"cycle": "cycles", "candidate": "candidates"}

    cells: CellSpace
    motion: Motion
    bounce: float
    "The bouncing angle, in radians."
    run: Localization

    def __post_init__(self) -> None:
        first, size = int(self.filter.uncertainty[0]), self.cells.size
        if first != size:
            raise ValueError(
                f"filter: it starts with {first} possible cells, but there are {size}; expected "
                "the filter of these cells"
            )
        limits = ("path", "cell", size), ("states", "state", len(self.filter.transition))
        for name, what, count in limits:
            values = getattr(self.run, name)
            for i in np.flatnonzero((values < 0) | (values >= count)).tolist()[:1]:
                raise ValueError(
                    f"run: {name}[{i}] is {what} {values[i]}; {what}s are 0 to {count - 1}"
                )

    @functools.cached_property
    def agreement(self) -> Mapping[int, float]:
        if self.cells.size > MOST_CELLS:
            return {}
        return filter_agreement(self.filter, self.cells, self.bounce, self.motion)

    @functools.cached_property
    def touching(self) -> Bool[np.ndarray, "cells"]:
        touches = touching_steps(self.cells, self.motion).ravel()
        mapped = bounce_map(self.cells, self.bounce, motion=self.motion)
        image, bumped = np.asarray(mapped.image), np.asarray(mapped.bumped)
        return filter_touches(self.filter, image, bumped, touches, CONFIRM)

    @functools.cached_property
    def off_centre(self) -> Shares:
        shift = int(bounce_shift(self.bounce, self.cells.directions))
        return filter_shares(self.filter, self.cells, shift, self.motion)

    @functools.cached_property
    def groups(self) -> BounceGroups:
        """The periodic groups of the map; the robot ends in one of them."""
        return BounceGroups.of(self.cells, self.bounce, motion=self.motion)

    @derived("", "periodic groups", "1", kind="count")
    def periodic_groups(self) -> int:
        return int(self.groups.count[0])

    @derived("", "longest transient", "mappings", kind="count")
    def longest_transient(self) -> int:
        return int(self.groups.longest_transient[0])

    @derived("time", "colour of the filter", kind="count")
    def belief_color(self) -> Int[np.ndarray, "times"]:
        return self.color[self.run.states]

    @functools.cached_property
    def beliefs(self) -> list[Int[np.ndarray, "_"]]:
        return [self.filter.cells(state) for state in self.run.states.tolist()]

    def checks(self) -> Checks:
        run = self.run
        follows = self.transition[run.states[:-1], run.observations] == run.states[1:]
        return {**super().checks(), "run_off_the_transitions": (int(np.count_nonzero(~follows)), 0)}
