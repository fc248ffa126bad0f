import functools
import operator
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..space import CELL_BY_CELL, CellSpace, Motion
from .dynamics import bounce_shift, moves as moves_of
from .joint_image import JointImage, joint_orbits, squares_of
from .trajectory import TeamOutcome, TeamTrajectory


# Number of steps that are simulated at once; parts are tens to thousands of steps long.
_CHUNK = 256
# The least number of joint states that are followed at once: fewer of them take hardly less time,
# but another compilation.
_LANES = 8
# The longest part by default, because all visited joint states are kept in memory.
_MAX_PART_STEPS = 100_000


def team_trajectory(
    cells: CellSpace,
    starts: Int[np.ndarray, "robots"] | Sequence[int],
    bounces: Float[np.ndarray, "*angles"] | Sequence[float] | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
    max_parts: int = 1000,
    part_steps: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> TeamTrajectory:
    """Find a joint trajectory of several bouncing robots that covers a map (Alam 2018, Alg. 3.4).

    The robots move by the joint bounce map (Eq. 3.9 to 3.11) until they repeat a joint state. Then
    a part of the trajectory ends, and the next part begins with a turn of one robot in place, by
    one direction to either side. All such turns that lead to new joint states are tried. The part
    that visits the most new positions is chosen; among equal parts, the part with the fewest
    collisions, and then the first part (robot 0 counter-clockwise, robot 0 clockwise, robot 1,
    ...). The trajectory ends when all positions that can be reached from the starts, by steps in
    any directions, have been visited. Only positions where a step ends count as visited. The search
    runs on the host, because the number of steps depends on the values.

    **Arguments:**

    - `starts`: the cell of each robot, no two in one position.
    - `bounces`: bouncing angles in radians, one for all robots or one for each.
    - `max_parts`: the largest number of parts.
    - `part_steps`: the largest number of steps of a part, because several robots may take millions
        of steps until they repeat a state; by default the number of cells, at most 100,000.
    - `progress`: called after each part with the numbers of parts and of visited positions.

    **Returns:** [`TeamTrajectory`][], the cells of all robots over time.

    Robots at both ends of a corridor of three squares meet in the middle and turn around. When they
    are at the ends again, their state repeats, so one robot is turned, and the middle is visited:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> team = bounce.team_trajectory(cells, [0, 5], math.pi)
        >>> team.cell.tolist(), team.outcome.name
        ([[0, 5], [3, 2], [0, 5], [3, 5], [0, 4]], 'COVERED')
    """
    return team_trajectories(
        cells,
        np.array([operator.index(cell) for cell in starts], np.int64)[None],
        bounces,
        motion=motion,
        max_parts=max_parts,
        part_steps=part_steps,
        progress=progress,
    )[0]


def team_trajectories(
    cells: CellSpace,
    starts: Int[np.ndarray, "runs robots"],
    bounces: Float[np.ndarray, "*angles"] | Sequence[float] | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
    max_parts: int = 1000,
    part_steps: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> list[TeamTrajectory]:
    """Find the joint trajectories of [`team_trajectory`][] from many starts of the same robots.

    All runs, and all turns that they try, are simulated at once.

    **Arguments:** as for [`team_trajectory`][], but `starts` has a row for each run, and `progress`
    is called with the largest number of parts and the smallest number of visited positions among
    all runs. **Returns:** a trajectory for each run.

    The number of steps from two pairs of starts in a corridor of three squares:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> runs = bounce.team_trajectories(cells, np.array([[0, 5], [1, 5]]), math.pi)
        >>> [run.steps for run in runs]
        [4, 2]
    """
    _check_starts(cells, starts)
    shift = _shifts(bounces, starts.shape[1], cells.directions)
    limit = min(cells.size, _MAX_PART_STEPS) if part_steps is None else part_steps
    for name, value in (("max_parts", max_parts), ("part_steps", limit)):
        if value < 1:
            raise ValueError(f"{name}: expected at least 1, got {value}")
    moves = moves_of(cells, motion=motion)
    squares, shift = jax.device_put((squares_of(cells), shift))
    orbits = functools.partial(joint_orbits, moves, squares, shift, steps=_CHUNK)

    target = np.asarray(moves.target)
    runs = [
        _Run(cells, start, _reach(target, start % cells.positions), max_parts)
        for start in starts.astype(np.int32)
    ]
    searching = runs
    while searching:
        tries = [[_Part(run, begin, limit) for begin in run.begins()] for run in searching]
        _simulate(orbits, [part for parts in tries for part in parts])
        for run, parts in zip(searching, tries, strict=True):
            run.append(max(parts, key=lambda part: (part.gain, -part.collisions)))
        if progress is not None:
            fewest = min(int(run.covered.sum()) for run in runs)
            progress(max(len(run.parts) for run in runs), fewest)
        searching = [run for run in searching if run.outcome is None]
    return [run.trajectory() for run in runs]


def _check_starts(cells: CellSpace, starts: Int[np.ndarray, "runs robots"]) -> None:
    if starts.shape[1] == 0:
        raise ValueError("starts: there are no robots; at least one is needed")
    for run, row in enumerate(starts.tolist()):
        where = f" of run {run}" if len(starts) > 1 else ""
        first: dict[int, int] = {}
        for robot, cell in enumerate(row):
            if not 0 <= cell < cells.size:
                raise ValueError(
                    f"starts{where}: robot {robot} is in cell {cell}, which does not exist; "
                    f"cells are 0 to {cells.size - 1}"
                )
            other = first.setdefault(cell % cells.positions, robot)
            if other != robot:
                raise ValueError(
                    f"starts{where}: robots {other} and {robot} are both at position "
                    f"{cell % cells.positions}, in cells {row[other]} and {cell}; one can be there"
                )


def _shifts(
    bounces: Float[np.ndarray, "*angles"] | Sequence[float] | float | int,
    robots: int,
    directions: int,
) -> Int[np.ndarray, "robots"]:
    angles = np.asarray(bounces, float)
    if angles.shape not in ((), (1,), (robots,)):
        raise ValueError(
            f"bounces: got {angles.size} angles for {robots} robots; "
            "expected one for all or one for each"
        )
    return np.broadcast_to(bounce_shift(angles, directions), robots)


def _reach(target: Int[np.ndarray, "ways positions"], position: Int[np.ndarray, "robots"]) -> int:
    """Count the positions that robots reach from their starts `position`, including the starts."""
    reached = np.zeros(target.shape[1], bool)
    new = position
    while new.size:
        reached[new] = True
        new = np.unique(target[:, new])
        new = new[~reached[new]]
    return int(reached.sum())


class _Run:
    """A joint trajectory that is extended part by part."""

    def __init__(
        self, cells: CellSpace, start: Int[np.ndarray, "robots"], reach: int, max_parts: int
    ) -> None:
        self.cells, self.start, self.reach, self.max_parts = cells, start, reach, max_parts
        self.outcome: TeamOutcome | None = None
        self.visited: set[bytes] = set()
        self.covered = np.zeros(cells.positions, bool)
        self.parts: list[_Part] = []

    def begins(self) -> list[Int[np.ndarray, "robots"]]:
        """List the joint states that the next part can begin with."""
        if not self.parts:
            return [self.start]
        last = self.parts[-1].state
        turns = np.kron(np.eye(len(last), dtype=np.int32), np.array([[1], [-1]], np.int32))
        states = (last + turns * self.cells.positions) % self.cells.size
        return [state for state in states if state.tobytes() not in self.visited]

    def append(self, part: "_Part") -> None:
        self.parts.append(part)
        self.visited |= part.visited
        self.covered = part.covered
        if self.covered.sum() == self.reach:
            everywhere = self.reach == self.cells.positions
            self.outcome = TeamOutcome.COVERED if everywhere else TeamOutcome.OUT_OF_REACH
        elif len(self.parts) == self.max_parts:
            self.outcome = TeamOutcome.OUT_OF_PARTS
        elif not self.begins():
            self.outcome = TeamOutcome.STUCK

    def trajectory(self) -> TeamTrajectory:
        assert self.outcome is not None
        steps = (steps for part in self.parts for steps in part.steps)
        joint = jax.tree.map(lambda *fields: np.concatenate(fields), *steps)
        path = joint.image
        position, first = np.unique(path % self.cells.positions, return_index=True)
        new = np.bincount(first // path.shape[1], minlength=len(path))
        return TeamTrajectory(
            cells=self.cells,
            # The entry of the start is no step.
            bumped=joint.bumped[1:],
            collided=joint.collided[1:],
            collisions=joint.collisions[1:],
            cell=path,
            covered=np.cumsum(new).astype(np.int32),
            part_begin=np.cumsum(
                [0, *(part.length + 1 for part in self.parts[:-1])], dtype=np.int32
            ),
            uncovered_positions=np.setdiff1d(
                np.arange(self.cells.positions, dtype=np.int32), position
            ),
            outcome=self.outcome,
        )


class _Part:
    """A candidate for the next part of a run; it is extended step by step."""

    def __init__(self, run: _Run, begin: Int[np.ndarray, "robots"], limit: int) -> None:
        self.run, self.limit = run, limit
        # The first entry turns one robot, and no robot bumps.
        none = np.zeros((1, len(begin)), bool)
        self.steps = [JointImage(begin[None], none, none, np.zeros(1, np.int32))]
        self.length = self.collisions = 0
        self.visited = {begin.tobytes()}
        self.covered = run.covered.copy()
        self.covered[begin % run.cells.positions] = True
        self.growing = bool(self.covered.sum() < run.reach)

    @property
    def state(self) -> Int[np.ndarray, "robots"]:
        """The last joint state."""
        return np.asarray(self.steps[-1].image[-1])

    @property
    def gain(self) -> int:
        """Number of positions that this part is the first to visit."""
        return int(self.covered.sum() - self.run.covered.sum())

    def extend(self, steps: JointImage) -> None:
        """Append steps to the part, up to the step that ends it."""
        states = np.asarray(steps.image[: self.limit - self.length])
        stop = len(states)
        self.growing = self.length + stop < self.limit
        whole = np.ascontiguousarray(states)
        keys = whole.view(f"V{whole.itemsize * whole.shape[1]}").ravel().tolist()
        for i, state in enumerate(keys):
            if state in self.visited or state in self.run.visited:
                stop, self.growing = i + 1, False
                break
            self.visited.add(state)
        position, first = np.unique(states[:stop] % self.run.cells.positions, return_index=True)
        first = first[~self.covered[position]]
        self.covered[position] = True
        if self.covered.sum() == self.run.reach:
            stop, self.growing = int(first.max()) // states.shape[1] + 1, False
        self.steps.append(jax.tree.map(lambda field: field[:stop], steps))
        self.length += stop
        self.collisions += int(steps.collisions[:stop].sum())


def _simulate(
    orbits: Callable[[Int[Array, "lanes robots"]], JointImage], parts: list[_Part]
) -> None:
    """Extend all parts at once, by the steps that `orbits` computes, until each part has ended."""
    while growing := [part for part in parts if part.growing]:
        states = np.stack([part.state for part in growing])
        # The number of lanes is a power of two, so that few programs are compiled.
        lanes = max(_LANES, 1 << (len(growing) - 1).bit_length())
        states = np.resize(states, (lanes, states.shape[1]))
        joint = jax.device_get(orbits(jax.device_put(states)))
        for lane, part in enumerate(growing):
            part.extend(jax.tree.map(lambda field, lane=lane: field[:, lane], joint))
