import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from ...automata import Belief, HiddenMap
from ...automata.belief import NOWHERE, SMALL
from ...base.formatting import configuration, counted, percent
from ...base.quantities import PROBABILITY, Checks, Result, derived, from_part, quantity
from ...space import CellSpace, Slip, felt_walls, nearest_cell, slipping_step, stride_legs
from ...space.slip import ERRORS
from ..dynamics import Place, bounce_shift, candidate_poses, cell_of
from ..localization.localize import Candidates, Localization, Observations


_Times: TypeAlias = Int[np.ndarray, "times"]
_Shares: TypeAlias = Float[np.ndarray, "times positions"]


@dataclasses.dataclass(frozen=True, eq=False)
class Slipped(Result):
    """A run of a robot that slips and starts in an unknown cell, with its belief."""

    title: ClassVar[str] = "Localization of a bouncing robot that slips"
    tables: ClassVar[Mapping[str, str]] = {"candidate": "candidates"}

    cells: CellSpace
    bounces: Float[np.ndarray, "angles"]
    "The bouncing angles to choose from at each bump, in radians."
    slip: Slip
    hidden: HiddenMap
    "The map of the fine cells, which updates the belief."
    fine_side: Annotated[float, quantity("", "side of a fine cell", "m")]
    fine_directions: Annotated[int, quantity("", "fine directions", kind="count")]
    observations: Observations
    turned_by: Annotated[
        _Times,
        quantity("time", "number of the angle that the robot has just turned by", kind="index"),
    ]
    pose: Annotated[
        Float[np.ndarray, "times 3"],
        quantity("time axis", "pose of the robot: x and y in m, heading in rad"),
    ]
    belief: Annotated[
        _Shares, quantity("time position", "probability of each position", kind="share")
    ]
    nowhere: Annotated[
        Float[np.ndarray, "times"],
        quantity("time", "probability that the robot is nowhere on the map", kind="share"),
    ]
    credible: Annotated[
        _Times, quantity("time", "cells of the credible set, 95 %", "cells", kind="count")
    ]
    likeliest: Annotated[_Times, quantity("time", "likeliest cell", kind="cell")]
    smoothed: Annotated[
        _Shares,
        quantity("time position", "probability of each position, by the whole run", kind="share"),
    ]
    path: Annotated[_Times, quantity("time", "cells of the likeliest path", kind="cell")]
    candidates: Candidates
    candidate_probability: Annotated[
        Float[np.ndarray, "candidates"], quantity("candidate", "probability", kind="share")
    ]

    candidate_x, candidate_y, candidate_theta_deg = candidate_poses("candidates")

    @property
    def answered(self) -> bool:
        return not self.is_nowhere

    @property
    def answer(self) -> tuple[str, ...]:
        bumps, steps = self.bumps, self.observations.size - self.bumps
        after = f"After {counted(steps, 'step')} and {counted(bumps, 'bump')}"
        if self.is_nowhere or not self.candidates.size:
            return (f"{after} the robot is on another map, by its belief.",)
        best = int(np.argmax(self.candidate_probability))
        place = configuration(self.cells, int(self.candidates[best]))
        sure = percent(self.candidate_probability[best])
        return (f"{after} the robot is at {place} with a probability of {sure}, by its belief.",)

    @property
    def truth(self) -> Int[np.ndarray, "times"]:
        """The cell that contains the robot at each time, or the nearest cell."""
        return nearest_cell(self.cells, *self.pose.T)

    @property
    def events(self) -> Int[np.ndarray, "steps"]:
        """The event of each step: 0 for a move, and 1 plus the number of the angle for a bump."""
        return 1 + self.turned_by[1:]

    fine_cells = from_part("hidden.cells", "", "fine cells", kind="count")

    @derived("", "start", kind="cell")
    def start(self) -> int:
        return int(self.truth[0])

    word, bumps = Localization.word, Localization.bumps

    @derived("", "end", kind="cell")
    def end(self) -> int:
        return int(self.truth[-1])

    @derived("", "whether the robot is nowhere on the map, by the belief", kind="flag")
    def is_nowhere(self) -> bool:
        return bool(self.nowhere[-1] > NOWHERE)

    truth_is_a_candidate = Localization.truth_is_a_candidate

    def checks(self) -> Checks:
        total = self.belief.sum(axis=1) + self.nowhere
        return {
            "belief_and_nowhere_sum_to_1": (float(np.abs(total - 1).max()), PROBABILITY),
            "smoothed_sums_to_1": (
                float(np.abs(self.smoothed.sum(axis=1) - 1).max(initial=0)),
                PROBABILITY,
            ),
        }


def slipping_run(
    hidden: HiddenMap,
    cells: CellSpace,
    bounces: Sequence[float] | Float[np.ndarray, "angles"],
    slip: Slip,
    start: Place,
    *,
    seed: int = 0,
    step: float | None = None,
    limit: int = 400,
    fine_side: float,
    fine_directions: int,
) -> Slipped:
    """Drive a simulated robot that slips, until its belief is concentrated in a few cells.

    The robot moves by [`jaxcell.space.slipping_step`][], in continuous space.

    **Arguments:**

    - `hidden`: the map of fine cells that [`jaxcell.bounce.slip_map`][] returns.
    - `bounces`: the angles of `hidden` in radians, counter-clockwise. At each bump the robot
        chooses one of them according to its belief.
    - `start`: the cell or the pose where the robot starts, which it does not know.
    - `step`: length of a step in metres, by default one cell.
    - `limit`: the largest number of observations.
    - `fine_side`, `fine_directions`: the side of a fine cell in metres, and the number of fine
        directions, which are stored in the result.

    **Returns:** [`Slipped`][], the run and its beliefs.

    A corridor of three cells looks the same from both ends:

        >>> import math
        >>> from jaxcell import bounce, examples, space
        >>> cells, slip = examples.corridor(), space.Slip.of(0.01)
        >>> fine = bounce.FineCells.of(cells, squares=3, directions=9, reach=3)
        >>> hidden = bounce.slip_map(fine, [math.pi], slip)
        >>> run = bounce.slipping_run(
        ...     hidden, cells, [math.pi], slip, 1, fine_side=1 / 3, fine_directions=18
        ... )
        >>> bool(run.credible[-1] <= 4), run.truth_is_a_candidate
        (True, True)
    """
    start = cell_of(cells, start)
    rng = np.random.default_rng([seed, start])
    legs = stride_legs(cells.directions, cells.cell, cells.cell if step is None else step)
    walls, belief = felt_walls(cells.room, slip.give), Belief(hidden)
    shifts = bounce_shift(np.asarray(bounces, float), cells.directions).tolist()
    pose, believed = np.stack(cells.centre(start)), start // cells.positions
    state = belief.start()
    poses, states, estimates = [pose], [state], [belief.estimate(state)]
    observations: list[int] = []
    while len(observations) < limit:
        errors = rng.standard_normal(ERRORS)
        leg = legs[believed]
        after = [slipping_step(pose, leg, bounce, errors, walls, slip) for bounce in bounces]
        observations.append(int(after[0][1]))
        state = belief.observe(state, observations[-1])
        if state.turn is not None:
            believed = (believed + shifts[state.turn]) % cells.directions
        pose = after[state.turn or 0][0]
        poses.append(pose)
        states.append(state)
        estimates.append(belief.estimate(state))
        if estimates[-1].cells.size <= SMALL or state.nowhere > NOWHERE:
            break

    turns = [-1 if state.turn is None else state.turn for state in states]
    turned_by = np.array(turns, np.int32)
    events = (1 + turned_by[1:]).tolist()
    try:
        smoothed, path = belief.smoothed(events), belief.likeliest_path(events)
    except ValueError:
        # No path of the map has these observations: the robot is nowhere on the map.
        smoothed, path = np.zeros((0, hidden.cells)), np.zeros(0, np.int32)
    at_end = estimates[-1]
    return Slipped(
        cells=cells,
        bounces=np.asarray(bounces, float),
        slip=slip,
        hidden=hidden,
        fine_side=fine_side,
        fine_directions=fine_directions,
        observations=np.array(observations, np.int8),
        turned_by=turned_by,
        pose=np.stack(poses),
        belief=np.stack([hidden.by_position(one.weight, cells.positions) for one in states]),
        nowhere=np.array([one.nowhere for one in states]),
        credible=np.array([one.cells.size for one in estimates], np.int32),
        likeliest=np.array([one.cells[0] if one.cells.size else -1 for one in estimates], np.int32),
        smoothed=np.array([hidden.by_position(one, cells.positions) for one in smoothed]).reshape(
            -1, cells.positions
        ),
        path=hidden.configuration[path],
        candidates=at_end.cells,
        candidate_probability=at_end.probability,
    )
