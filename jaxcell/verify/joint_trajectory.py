import itertools

import networkx as nx
import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..bounce import CELL_BY_CELL, Motion, TeamTrajectory
from ..bounce.joint_image import squares_of
from ..mapping import SimpleMap
from .bounce import compare_straight
from .comparison import Comparison, sample


_STEPS = 300
_PLACES = 200


def compare_team(
    team: TeamTrajectory, bounces: Float[np.ndarray, "angles"], motion: Motion = CELL_BY_CELL
) -> list[Comparison]:
    """Compare steps of a joint trajectory with the collision rule, applied to each pair of robots.

    The other arguments are those from which [`jaxcell.bounce.team_trajectory`][] computed `team`.
    """
    cells, visited = team.cells, np.unique(team.cell)
    straight, images = compare_straight(cells, visited[sample(visited.size, _PLACES)], motion)
    angles = np.broadcast_to(bounces, team.starts.size)
    turns = np.rint(angles * cells.directions / (2 * np.pi)).astype(int)
    # The step before each further part is left out, because in it one robot turns.
    steps = np.setdiff1d(np.arange(team.steps), team.part_begin[1:] - 1)
    wrong, chosen = [], steps[sample(steps.size, _STEPS)].tolist()
    for t in chosen:
        expected = _joint_step(team, straight, turns, team.cell[t])
        fields = team.cell[t + 1], team.bumped[t], team.collided[t], team.collisions[t]
        ours = tuple(field.tolist() for field in fields)
        if ours != expected:
            wrong.append(f"step {t}: to cells {ours[0]}, and {expected[0]} pair by pair")
    return [
        images,
        Comparison.exact("steps of the robots, by shapely pair by pair", wrong, len(chosen)),
    ]


def _joint_step(
    team: TeamTrajectory,
    straight: SimpleMap,
    turns: Int[np.ndarray, "robots"],
    state: Int[np.ndarray, "robots"],
) -> tuple[list[int], list[bool], list[bool], int]:
    """Find the next cells, the robots that bump or collide, and the number of colliding pairs.

    `turns` contains the turn of each robot at a bump, counted in directions.
    """
    cells, squares = team.cells, squares_of(team.cells).T
    ahead = np.asarray(straight.image)[state]
    here = squares[state % cells.positions]
    motion = squares[ahead % cells.positions] - here
    pairs = list(itertools.permutations(range(len(state)), 2))
    i, j = np.array(pairs, int).reshape(-1, 2).T
    # Motion of robot i relative to robot j, if j moves, and if j stands.
    meet = _touches(here[i] - here[j], motion[i] - motion[j])
    runs_into = _touches(here[i] - here[j], motion[i])
    queue = nx.DiGraph([(b, a) for (a, b), one in zip(pairs, runs_into, strict=True) if one])
    first = {*np.flatnonzero(np.asarray(straight.bumped)[state]), *i[meet]}
    behind = (nx.descendants(queue, robot) for robot in first if robot in queue)
    bumps = first.union(*behind)
    collide = {
        frozenset(pair)
        for pair, one, other in zip(pairs, meet, runs_into, strict=True)
        if one or (other and pair[1] in bumps)
    }
    collided = frozenset().union(*collide)
    turned = (state + turns * cells.positions) % cells.size
    robots = range(len(state))
    return (
        [int(turned[k] if k in bumps else ahead[k]) for k in robots],
        [k in bumps for k in robots],
        [k in collided for k in robots],
        len(collide),
    )


def _touches(
    start: Int[np.ndarray, "pairs 2"], motion: Int[np.ndarray, "pairs 2"]
) -> Bool[np.ndarray, "pairs"]:
    """Test whether segments from `start` to `start + motion` contain the origin."""
    steps = shapely.linestrings(np.stack([start, start + motion], axis=1).astype(float))
    return shapely.intersects(steps, shapely.Point(0, 0))
