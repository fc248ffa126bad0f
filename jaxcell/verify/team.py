from fractions import Fraction
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..bounce import TeamTrajectory, bounce_map
from ..bounce.dynamics import Collision
from ..mapping import SimpleMap
from ..space import CellSpace
from .bounce import compare_images, sample
from .comparison import Comparison


_STEPS = 300
_MOST_PLACES = 200


def compare_team(
    cells: CellSpace,
    team: TeamTrajectory,
    bounces: Float[np.ndarray, "angles"],
    *,
    step: float | None = None,
    collision: Collision = "swept",
) -> list[Comparison]:
    """Some steps of a joint trajectory against the rule of collisions, pair by pair.

    **Arguments:**

    - `cells`: the cells of a map.
    - `team`: the trajectory.
    - `bounces`, `step`, `collision`: as for [`jaxcell.bounce.team_trajectory`][].
    """
    straight = bounce_map(cells, 0.0, step=step, collision=collision)
    visited = np.unique(team.path)
    visited = visited[sample(visited.size, _MOST_PLACES)]
    return [
        compare_images(cells, straight, 0.0, step=step, collision=collision, only=visited),
        _replayed(cells, team, straight, np.asarray(bounces, float)),
        _visited(cells, team),
    ]


def _replayed(
    cells: CellSpace,
    team: TeamTrajectory,
    straight: SimpleMap,
    bounces: Float[np.ndarray, "angles"],
) -> Comparison:
    robots = team.path.shape[1]
    turns = np.rint(np.broadcast_to(bounces, robots) * cells.directions / (2 * np.pi)).astype(int)
    # The step before a part begins is the turn of one robot.
    steps = np.setdiff1d(np.arange(len(team.bumped)), team.parts[1:] - 1)
    wrong, chosen = [], steps[sample(steps.size, _STEPS)].tolist()
    for t in chosen:
        state, bumped, collided, pairs = _joint_step(cells, straight, turns, team.path[t])
        told = (
            team.path[t + 1].tolist(),
            team.bumped[t].tolist(),
            team.collided[t].tolist(),
            int(team.collisions[t]),
        )
        if told != (state, bumped, collided, pairs):
            wrong.append(f"step {t}: to cells {told[0]}, and {state} pair by pair")
    return Comparison.exact("steps of the robots, pair by pair", wrong, len(chosen))


def _joint_step(
    cells: CellSpace,
    straight: SimpleMap,
    turns: Int[np.ndarray, "robots"],
    state: Int[np.ndarray, "robots"],
) -> tuple[list[int], list[bool], list[bool], int]:
    """The next cells, who bumped, who collided, and how many pairs did."""
    robots = range(len(state))

    def square(z: int) -> tuple[int, int]:
        row, column = divmod(int(cells.square[z % cells.positions]), cells.free.shape[1])
        return column, row

    here = [square(z) for z in state.tolist()]
    there = [square(int(straight.image[z])) for z in state.tolist()]
    bumped = [bool(straight.bumped[z]) for z in state.tolist()]
    meet = {(i, j) for i in robots for j in robots if i != j and _meet(here, there, i, j, False)}
    on_way = {(i, j) for i in robots for j in robots if i != j and _meet(here, there, i, j, True)}
    for i, j in meet:
        bumped[i] = bumped[j] = True
    for _ in robots:
        for i, j in on_way:
            bumped[i] |= bumped[j]
    pairs = {frozenset((i, j)) for i, j in meet | {(i, j) for i, j in on_way if bumped[j]}}
    collided = [any(i in pair for pair in pairs) for i in robots]
    after = [
        int((z + turns[i] * cells.positions) % cells.size if bumped[i] else straight.image[z])
        for i, z in enumerate(state.tolist())
    ]
    return after, bumped, collided, len(pairs)


def _meet(here: Any, there: Any, i: int, j: int, stands: bool) -> bool:
    """Whether robot `i` comes to where `j` is at the same time, if `j` goes on or stands."""
    motion = [
        (there[i][a] - here[i][a]) - (0 if stands else there[j][a] - here[j][a]) for a in (0, 1)
    ]
    apart = [here[j][a] - here[i][a] for a in (0, 1)]
    times = {Fraction(apart[a], motion[a]) for a in (0, 1) if motion[a]}
    if not times or any(apart[a] and not motion[a] for a in (0, 1)):
        return False
    return len(times) == 1 and 0 < min(times) <= 1


def _visited(cells: CellSpace, team: TeamTrajectory) -> Comparison:
    """What is covered, by a set that grows."""
    seen: set[int] = set()
    wrong = []
    for t, states in enumerate((team.path % cells.positions).tolist()):
        seen.update(states)
        if len(seen) != team.covered[t]:
            wrong.append(f"after {t} steps {team.covered[t]} are told, and {len(seen)} visited")
    if set(team.uncovered.tolist()) != set(range(cells.positions)) - seen:
        wrong.append("the positions that stay uncovered are others")
    return Comparison.exact("positions covered, by a set that grows", wrong, len(team.path) + 1)
