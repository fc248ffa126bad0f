import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...automata import Decisions, Homing, Policy, Smallest, adaptive_choice, homing_sequence
from ...automata.adaptive import Aim, levels
from ...automata.filter import CONFIRM
from ...automata.policy import Onward
from ...base.quantities import Checks, derived, from_part, quantity
from ...space import CELL_BY_CELL, CellSpace, Motion
from ...space.touching import touching_steps
from ..dynamics import Bounces, Place, bounce_shift, cell_of
from ..plans.roadmap import Roadmap
from .corners import policy_touches, touching_runs
from .localize import Localization, drive_until_localized
from .off_centre import Shares, policy_shares
from .other_rooms import MOST_CELLS, policy_agreement
from .result import RunOnMap, States


Goal: TypeAlias = Literal["cell", "position", "class"]


@dataclasses.dataclass(frozen=True, eq=False)
class LocalizationPolicy(States):
    """A policy that localizes a robot by its choice of angles at bumps.

    State 0 is the start, and every other state is a bump with a set of possible cells. The possible
    cells of state `s` are `member[offset[s]:offset[s + 1]]`. From state `s`, the next bump leads to
    state `bump_state[i]`, after `bump_steps[i]` steps, for an `i` in
    `range(bump_offset[s], bump_offset[s + 1])`. If this range is empty, the robot is localized in
    state `s`.
    """

    title: ClassVar[str] = "Localization of a bouncing robot that chooses its angles"
    tables: ClassVar[Mapping[str, str]] = {"bounce": "angles"}

    cells: CellSpace
    motion: Motion
    bounces: Bounces
    goal: Goal
    aim: Aim
    policy: Policy
    roadmap: Roadmap
    "The cells where the robot bumps, and the cells after each bump."
    least: Annotated[float, quantity("", "lower bound of the bumps of any policy")]
    "A lower bound on the largest number of bumps, or on their mean over the starts; see `aim`."
    optimal: Annotated[bool, quantity("", "whether the policy is proved the best", kind="flag")]
    searched: Annotated[int, quantity("", "sets of cells that were searched for it", kind="count")]
    wall_class: Int[np.ndarray, "walls"]
    "The class of each wall; no choice of angles distinguishes the walls of a class."
    bumps_needed: Annotated[
        Int[np.ndarray, "directions positions"],
        quantity("direction position", "bumps until it is localized, by its start", kind="count"),
    ]
    end_state: Annotated[
        Int[np.ndarray, "directions positions"],
        quantity("direction position", "state where it is localized, by its start", kind="index"),
    ]
    fixed: Homing
    """A sequence of turns at successive bumps that is the same for all starts and observations. The
    robot bumps once more after the last turn, and is then localized. With the goal `"position"`,
    the position is known at some bump of the sequence, but perhaps no longer at its end."""
    smallest: Smallest | None = dataclasses.field(default=None, kw_only=True)

    @property
    def automaton(self) -> Policy:
        return self.policy

    @property
    def answered(self) -> bool:
        return self._unanswered_share == 0

    @functools.cached_property
    def _unanswered_share(self) -> float:
        """The share of the starts from which several cells, or places, are possible at the end."""
        if self.goal == "class":
            return 0.0
        unanswered = np.zeros(self.end_state.max() + 1, bool)
        for state in np.unique(self.end_state).tolist():
            cells = self.policy.cells(state)
            if self.goal == "position":
                cells = np.unique(cells % self.cells.positions)
            unanswered[state] = cells.size > 1
        return float(unanswered[self.end_state].mean())

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = []
        if not self.answered:
            what = "place" if self.goal == "position" else "cell"
            remarks.append(
                f"No choice of these angles brings every robot down to one {what}: from "
                f"{self._unanswered_share:.2%} of the starts, up to {self.largest_uncertainty:,} "
                "cells remain possible."
            )
        if not self.optimal:
            how = "at worst" if self.aim == "worst" else "in the mean"
            needs = self.worst_bumps if self.aim == "worst" else self.mean_bumps
            remarks.append(
                f"The search ended at its limit after {self.searched:,} sets of cells: this policy "
                f"needs {needs:.4g} bumps {how}, and none needs less than {self.least:.4g}."
            )
        if self.goal == "position" and self.answered and (places := self._fixed_places) > 1:
            remarks.append(
                f"A robot that turns by the one sequence for all starts has to stop as soon as one "
                f"place is left: at the end of the sequence up to {places} are possible again."
            )
        return tuple(remarks)

    @property
    def _fixed_places(self) -> int:
        """The largest number of positions left possible by the turns `fixed`, over all starts."""
        wall, observed = self.roadmap.wall, self.roadmap.length
        for number in self.fixed.inputs.tolist():
            turned = self.roadmap.turned[number, wall]
            both = np.stack([observed, self.roadmap.length[turned]])
            observed = np.unique(both, axis=1, return_inverse=True)[1].ravel()
            wall = self.roadmap.wall[turned]
        ends = np.stack([observed, self.roadmap.wall_cell[wall] % self.cells.positions])
        return int(np.bincount(np.unique(ends, axis=1)[0]).max())

    @derived("", "bumps at worst", "1", kind="count")
    def worst_bumps(self) -> int:
        return int(self.bumps_needed.max())

    @derived("", "bumps in the mean over all starts", "1")
    def mean_bumps(self) -> float:
        return float(self.bumps_needed.mean())

    @derived("", "classes of cells that can be told apart", "1", kind="count")
    def classes(self) -> int:
        return len(set(zip(self.roadmap.length.tolist(), self.cell_class.tolist(), strict=True)))

    @derived("", "possible cells at the end, at worst", "1", kind="count")
    def largest_uncertainty(self) -> int:
        return int(self.policy.uncertainty[self.policy.ends].max())

    @derived("", "starts from which one cell is left", kind="share")
    def localized_to_one(self) -> float:
        return float((self.policy.uncertainty[self.end_state] == 1).mean())

    policy_states = from_part("policy.turn.size", "", "states of the policy", "1", kind="count")

    @derived("", "bumps of one sequence for all starts", "1", kind="count")
    def fixed_bumps(self) -> int:
        return 1 + self.fixed.inputs.size

    @derived("", "lower bound of the bumps of any such sequence", "1", kind="count")
    def fixed_least(self) -> int:
        return 1 + self.fixed.least

    @derived("fixed_bump", "turns of that sequence", "degree", listed=True)
    def fixed_turns_deg(self) -> Float[np.ndarray, "bumps"]:
        return np.rad2deg(self.bounces[self.fixed.inputs]).round(9)

    @derived("bounce", "bouncing angle", "degree")
    def bounce_deg(self) -> Float[np.ndarray, "angles"]:
        return np.rad2deg(self.bounces).round(9)

    @derived("bounce", "states that turn by it", kind="count")
    def bounce_states(self) -> Int[np.ndarray, "angles"]:
        turns = self.policy.turn
        return np.bincount(turns[turns >= 0], minlength=self.bounces.size)

    turn = from_part(
        "policy.turn", "state", "number of the angle to turn by, -1 for none", kind="index"
    )
    color = from_part("policy.color", "state", "colour: 1 until it is localized", kind="count")
    bump_offset = from_part(
        "policy.first", "state_bound", "first entry of the state in bump_steps", kind="count"
    )
    bump_steps = from_part("policy.steps", "next_bump", "steps until the next bump", kind="count")
    bump_state = from_part("policy.target", "next_bump", "state at that bump", kind="index")

    @property
    def cell_class(self) -> Int[np.ndarray, "cells"]:
        """For each cell, the class (see `wall_class`) of the wall to which its run leads."""
        return self.wall_class[self.roadmap.wall]

    def drive(self, start: Place) -> Localization:
        """Drive a simulated robot with the policy until it is localized.

        For each time, the result contains the state of the policy at the most recent bump.
        """
        start = cell_of(self.cells, start)
        return drive_until_localized(
            self.policy,
            start,
            self.roadmap.length == 0,
            lambda cell, state: self.roadmap.after(cell, int(self.policy.turn[state.index])),
        )

    def checks(self) -> Checks:
        walls = self.roadmap.wall_cell.size
        ends = [self.policy.cells(state) for state in self.policy.ends.tolist()]
        mixed = sum(np.unique(self.cell_class[cells]).size > 1 for cells in ends)
        return {
            "ends_that_can_be_told_apart": (mixed if self.goal != "position" else 0, 0),
            "members_that_are_no_walls": (
                int(np.count_nonzero(self.roadmap.length[self.member[self.offset[1] :]])),
                0,
            ),
            "least_above_what_is_needed": (
                max(0.0, self.least - max(self.worst_bumps, self.mean_bumps)),
                1e-9 * walls,
            ),
        }


def localization_policy(
    cells: CellSpace,
    bounces: Float[np.ndarray, "angles"] | Array | Sequence[float],
    goal: Goal = "cell",
    *,
    aim: Aim = "worst",
    motion: Motion = CELL_BY_CELL,
    limit: int = 5_000_000,
    metadata: Mapping[str, Any] | None = None,
) -> LocalizationPolicy:
    """Find the policy for the angle at each bump that localizes a robot in the fewest bumps.

    A robot that knows neither its place nor its heading counts the steps to its first bump. Then it
    turns at each bump by the angle that the policy chooses for its observations so far; of angles
    that need equally many bumps, by one after which fewer robots touch a corner. The length
    of the next run excludes the possible cells whose next run has another length. Two possible
    cells never merge into one, because cells from which a robot runs straight to the same wall are
    at different distances from it. Therefore the bumps that are still needed depend on the set of
    possible cells alone, and a policy is a choice in an AND-OR graph of sets.

    **Arguments:**

    - `bounces`: the angles to choose from, in radians, counter-clockwise.
    - `goal`: the `"cell"`, the `"position"` with any heading, or the `"class"` of cells that no
        choice of these angles distinguishes. If a cell or a position cannot be determined, the
        policy stops once the class is known.
    - `aim`: minimise the largest (`"worst"`) or mean (`"mean"`) number of bumps over all starts.
    - `limit`: the largest number of cells of all searched sets together. If the search reaches the
        limit, it returns the best policy found, which is at least as good as the greedy policy, and
        `least` is only a lower bound.
    - `metadata`: values to store and save with the policy.

    **Returns:** [`LocalizationPolicy`][], which also has one sequence of angles for all starts.

    In the laboratory of the dissertation a robot that only turns by 45 degrees is localized to at
    most four cells. A robot that may also turn by 135 degrees is always localized to one cell:

        >>> import numpy as np
        >>> from jaxcell import bounce, examples
        >>> cells = examples.lab()
        >>> angles, motion = np.radians([45, 135]), bounce.ENDPOINT
        >>> policy = bounce.localization_policy(cells, angles, motion=motion)
        >>> policy.largest_uncertainty, policy.worst_bumps, policy.optimal, policy.fixed_bumps
        (1, 11, True, 12)
    """
    roadmap = Roadmap.of(cells, bounces, motion=motion)
    images, lengths = roadmap.wall[roadmap.turned], roadmap.length[roadmap.turned]
    roots = [roadmap.wall[roadmap.length == t] for t in range(int(roadmap.length.max()) + 1)]
    place = roadmap.wall_cell % cells.positions if goal == "position" else None
    touches = touching_steps(cells, motion).ravel()
    decisions = adaptive_choice(
        images,
        lengths,
        roots,
        place=place,
        aim=aim,
        limit=limit,
        avoid=touching_runs(roadmap, touches)[roadmap.turned],
    )
    policy = _going_on(_policy(cells, roadmap, decisions, metadata or {}), cells, roadmap, touches)
    bumps, ends = _all_runs(roadmap, policy, images, lengths)
    shape = cells.directions, cells.positions
    return LocalizationPolicy(
        cells=cells,
        motion=motion,
        bounces=roadmap.bounces,
        goal=goal,
        aim=aim,
        policy=policy,
        roadmap=roadmap,
        least=1.0 + (max(decisions.lower) if aim == "worst" else sum(decisions.lower) / cells.size),
        optimal=decisions.optimal,
        searched=decisions.searched,
        wall_class=levels(images, lengths)[-1],
        bumps_needed=bumps.reshape(shape),
        end_state=ends.reshape(shape),
        fixed=homing_sequence(images, lengths, roots, place=place),
    )


def _policy(
    cells: CellSpace, roadmap: Roadmap, decisions: Decisions, metadata: Mapping[str, Any]
) -> Policy:
    """Build a policy for a start in any cell, from the decision for each set of possible walls."""
    after = [dict(enumerate(decisions.roots)), *decisions.after]
    members = [np.arange(cells.size), *(roadmap.wall_cell[list(set)] for set in decisions.sets)]
    return Policy(
        turn=np.array([-1, *decisions.choice], np.int32),
        first=np.cumsum([0, *map(len, after)], dtype=np.int32),
        steps=np.array([steps for bumps in after for steps in bumps], np.int32),
        target=np.array([1 + number for bumps in after for number in bumps.values()], np.int32),
        offsets=np.cumsum([0, *map(len, members)], dtype=np.int32),
        members=np.concatenate(members).astype(np.int32),
        metadata=metadata,
    )


def _going_on(
    policy: Policy, cells: CellSpace, roadmap: Roadmap, touches: Bool[np.ndarray, "cells"]
) -> Policy:
    """Choose the angle by which a robot turns after the end of a policy, to confirm its place.

    The more headings a robot has in turn, the more its observations tell: a robot that turns round
    drives back and forth along one line. Among angles with equally many headings, the one after
    which fewest robots touch a corner is chosen.
    """
    shifts = bounce_shift(roadmap.bounces, cells.directions)
    headings = cells.directions // np.gcd(shifts, cells.directions)
    candidates = []
    for turn in np.flatnonzero(headings == headings.max()).tolist():
        turned = roadmap.turned[turn]
        onward = Onward(turn, roadmap.wall_cell, roadmap.length[turned], roadmap.wall[turned])
        candidates.append(dataclasses.replace(policy, onward=onward))
    if len(candidates) == 1 or not touches.any():
        return candidates[0]
    return min(
        candidates, key=lambda one: policy_touches(one, roadmap, touches, CONFIRM).sum().item()
    )


def _all_runs(
    roadmap: Roadmap,
    policy: Policy,
    images: Int[np.ndarray, "angles walls"],
    lengths: Int[np.ndarray, "angles walls"],
) -> tuple[Int[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
    """Count the bumps from each cell until the policy ends, and find the state in which it ends.

    After a turn by angle `a` at wall `w`, wall `images[a, w]` is `lengths[a, w]` steps ahead.
    """
    wall, steps = roadmap.wall.copy(), roadmap.length
    state, bumps = np.zeros(roadmap.size, np.int64), np.zeros(roadmap.size, np.int32)
    left = np.arange(roadmap.size)
    while left.size:
        state[left] = policy.next_states(state[left], steps)
        bumps[left] += 1
        left = left[policy.turn[state[left]] >= 0]
        turn = policy.turn[state[left]]
        steps = lengths[turn, wall[left]]
        wall[left] = images[turn, wall[left]]
    return bumps, state.astype(np.int32)


@dataclasses.dataclass(frozen=True, eq=False)
class AdaptivelyLocalized(RunOnMap, LocalizationPolicy):
    """A localization policy of a map, and the run of a robot that the policy localizes."""

    tables: ClassVar[Mapping[str, str]] = {"bounce": "angles", "candidate": "candidates"}

    run: Localization

    @classmethod
    def of(cls, policy: LocalizationPolicy, start: Place) -> "AdaptivelyLocalized":
        """Drive a simulated robot from a cell until a policy has localized it."""
        fields = {field.name: getattr(policy, field.name) for field in dataclasses.fields(policy)}
        return cls(**fields, run=policy.drive(start))

    @functools.cached_property
    def agreement(self) -> Mapping[int, float]:
        if self.cells.size > MOST_CELLS:
            return {}
        return policy_agreement(self.policy, self.cells, self.bounces, self.motion)

    @functools.cached_property
    def touching(self) -> Bool[np.ndarray, "cells"]:
        touches = touching_steps(self.cells, self.motion).ravel()
        return policy_touches(self.policy, self.roadmap, touches, CONFIRM)

    @functools.cached_property
    def off_centre(self) -> Shares:
        shifts = bounce_shift(self.bounces, self.cells.directions)
        return policy_shares(self.policy, self.cells, shifts, self.motion)

    @functools.cached_property
    def beliefs(self) -> list[Int[np.ndarray, "_"]]:
        roadmap = self.roadmap
        cells = np.arange(roadmap.size, dtype=np.int32)
        beliefs = [cells]
        for observation, state in zip(self.run.observations, self.run.states[1:], strict=True):
            cells = cells[(roadmap.length[cells] == 0) == observation]
            cells = np.sort(roadmap.after(cells, int(self.policy.turn[state])))
            beliefs.append(cells)
        return beliefs

    @derived("time", "number of the angle that the robot has just turned by", kind="index")
    def turned_by(self) -> Int[np.ndarray, "times"]:
        turn = self.policy.turn[self.run.states]
        return np.where(np.append(0, self.run.observations) == 1, turn, -1).astype(np.int32)
