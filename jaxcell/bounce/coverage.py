import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate, Real, Solution, Whole
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.quantities import PROBABILITY, Checks, Result, derived, from_part, quantity
from ..base.wide import as_number, namespace, traced
from ..mapping import PersistentGroups, persistent_groups
from ..markov import LimitingDistribution, hitting_times, limiting_distribution
from ..optimize import mixture
from ..space import CELL_BY_CELL, CellSpace, Motion, estimates
from .dynamics import Bounces, Moves, bounce_shift, moves as moves_of
from .groups import padded
from .noisy_map import noisy_chain, noisy_turns


Target: TypeAlias = npt.ArrayLike | Callable[[Any, Any], Any] | None


_ARRAYS = "bounce alpha coverage mixture target distance certificate groups limiting goal arrival"


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=_ARRAYS.split(), meta_fields=["cells"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class CoveragePolicy(Result):
    """The mixture of bouncing angles whose coverage of a room is nearest to a target."""

    title: ClassVar[str] = "Coverage by a mixture of bouncing policies"
    picture: ClassVar[str] = "mixture"
    tables: ClassVar[Mapping[str, str]] = {"bounce": "policies"}

    cells: CellSpace
    bounce: Bounces
    alpha: Annotated[
        Float[Array, "angles"],
        quantity("bounce", "share of time", "1", kind="distribution", source="Alam 2018, Eq. 3.7"),
    ]
    coverage: Annotated[
        Float[Array, "angles positions"],
        quantity("bounce position", "share of time in the long run", "1", kind="distribution"),
    ]
    mixture: Annotated[
        Float[Array, "positions"],
        quantity("position", "share of time of the mixture", "1", kind="distribution"),
    ]
    target: Annotated[
        Float[Array, "positions"],
        quantity("position", "share of time that is wanted", "1", kind="distribution"),
    ]
    distance: Annotated[Real, quantity("", "Euclidean distance of the mixture from the target")]
    certificate: Certificate
    "A bound on `distance**2` minus its minimum; see [`jaxcell.optimize.mixture`][]."
    groups: tuple[PersistentGroups, ...]
    "The persistent groups of each angle."
    limiting: tuple[LimitingDistribution, ...]
    "The limiting distribution of each angle over all cells, with its certificate."
    goal: Bool[np.ndarray | Array, "positions"] | None = None
    "The positions of the goal, or `None`."
    arrival: tuple[Solution, ...] = ()
    "The expected steps of each angle from all cells to the goal; empty without a goal."

    @property
    def answer(self) -> tuple[str, ...]:
        shares = zip(np.asarray(self.alpha).tolist(), self.bounce_deg.tolist(), strict=True)
        used = [f"at {angle:g}° for {100 * share:.3g} %" for share, angle in shares if share > 0]
        return (f"The best robot bounces {', '.join(used)} of the time.",)

    @derived("", "time spent elsewhere than wanted", kind="share")
    def total_variation(self) -> Real:
        return as_number(jnp.abs(self.mixture - self.target).sum() / 2)

    @derived("", "positions visited in the long run", kind="count")
    def positions_visited(self) -> Whole:
        return as_number((self.mixture > 0).sum())

    @derived("", "bouncing angles with a share of time", kind="count")
    def angles_used(self) -> Whole:
        return as_number((self.alpha > 0).sum())

    @derived("", "persistent groups of all angles", kind="count")
    def groups_in_all(self) -> Whole:
        return sum(one.count for one in self.groups)

    @derived("", "share of time of the mixture in the goal", "1", kind="share")
    def goal_share(self) -> Real | None:
        if self.goal is None:
            return None
        return as_number(jnp.where(self.goal, self.mixture, 0.0).sum())

    @derived("", "mean steps to the goal if each robot keeps its angle", "steps", kind="time")
    def goal_time(self) -> Real | None:
        """The mean over random starts and over angles, which have their shares of time."""
        if self.goal is None:
            return None
        each = jnp.stack([one.value.mean() for one in self.arrival])
        return as_number(jnp.where(self.alpha > 0, self.alpha * each, 0.0).sum())

    duality_gap = from_part("certificate.residual", "", "duality gap, relative", kind="residual")

    @derived("bounce", "bouncing angle", "degree", kind="coordinate")
    def bounce_deg(self) -> Float[np.ndarray, "angles"]:
        return np.rad2deg(self.bounce)

    @derived("bounce", "persistent groups", kind="count")
    def persistent_groups(self) -> Int[np.ndarray, "angles"]:
        return np.array([one.count for one in self.groups])

    @derived("bounce", "cells of persistent groups", kind="count")
    def persistent_cells(self) -> Int[np.ndarray, "angles"]:
        return np.array([int(one.size.sum()) for one in self.groups])

    @derived("bounce", "positions visited by one angle alone", kind="count")
    def positions_alone(self) -> Int[np.ndarray, "angles"]:
        return (np.asarray(self.coverage) > 0).sum(axis=1)

    @derived("bounce", "mean steps from a random start to the goal", "steps", kind="time")
    def steps_to_goal(self) -> Float[np.ndarray, "angles"] | None:
        return np.array([one.value.mean() for one in self.arrival]) if self.arrival else None

    @derived("bounce", "change of the limiting distribution by a step", kind="residual")
    def stationarity_residual(self) -> Float[np.ndarray, "angles"]:
        return np.array([one.certificate.residual for one in self.limiting])

    @derived(
        "bounce direction position",
        "share of time in the long run",
        "1",
        kind="distribution",
        over="direction position",
    )
    def share(self) -> Float[np.ndarray, "angles directions positions"]:
        return self._by_direction([one.value for one in self.limiting])

    @derived("bounce direction position", "persistent group, -1 if transient", kind="index")
    def group(self) -> Int[np.ndarray, "angles directions positions"]:
        return self._by_direction([one.group for one in self.groups])

    @derived("bounce group_index", "probability of ending in the group", kind="distribution")
    def group_weight(self) -> Float[np.ndarray, "angles groups"]:
        return padded([np.asarray(one.weights) for one in self.limiting])

    @derived("bounce group_index", "cells of the group, 0 where an angle has fewer", kind="count")
    def group_size(self) -> Int[np.ndarray, "angles groups"]:
        return padded([np.asarray(one.size) for one in self.groups])

    def checks(self) -> Checks:
        alpha, coverage = np.asarray(self.alpha), np.asarray(self.coverage)
        transient = np.where(self.group < 0, self.share, 0).sum(axis=(1, 2))
        counted = [
            np.bincount(one[one >= 0], minlength=self.group_size.shape[1])
            for one in self.group.reshape(len(alpha), -1)
        ]
        return {
            "stationarity_residual": (float(self.stationarity_residual.max()), PROBABILITY),
            "group_sizes": (int(np.abs(counted - self.group_size).max()), 0),
            "share_of_transient_cells": (float(transient.max()), PROBABILITY),
            "coverage_is_of_share": (
                float(np.abs(self.share.sum(axis=1) - coverage).max()),
                PROBABILITY,
            ),
            "mixture_is_of_coverage": (
                float(np.abs(alpha @ coverage - np.asarray(self.mixture)).max()),
                PROBABILITY,
            ),
        }

    def _by_direction(self, values: list[Any]) -> np.ndarray:
        shape = (len(values), self.cells.directions, self.cells.positions)
        return np.stack(values).reshape(shape)


def coverage_policy(
    cells: CellSpace,
    bounces: Sequence[float] | Float[np.ndarray, "angles"] | Float[Array, "angles"],
    error: float,
    reliability: float | Array,
    target: Target = None,
    *,
    weights: Literal["basin", "size"] = "basin",
    motion: Motion = CELL_BY_CELL,
    goal: Bool[np.ndarray | Array, "positions"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> CoveragePolicy:
    """Find the mixture of bouncing angles whose coverage is nearest to a target (Alg. 3.3).

    The coverage of an angle is the limiting distribution of its noisy map, summed over the
    directions of each position. The mixture solves the least squares problem of Eq. 3.8.

    **Arguments:**

    - `bounces`: different bouncing angles in radians, counter-clockwise.
    - `error`, `reliability`, `target`: as for [`noisy_bounce_map`][] and [`coverage_target`][].
    - `weights`: the weight of a persistent group, which is the probability of ending in it from a
        random start (`"basin"`), or its share of the persistent cells (`"size"`).
    - `goal`: a mask of positions, by default none; the policy then has the expected steps to them.
    - `progress`: a function that is called with the number of finished angles.

    **Returns:** [`CoveragePolicy`][]: the mixture, and the coverage of each angle. The
    reliability may be traced by `jit`, `vmap` and `grad`, and the angles by `jit` and `vmap`.

    **Raises:** `RuntimeError` if a solver does not converge, or if JAX uses 32 bits.

    Any policy covers a room of 2 by 2 squares evenly:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, space
        >>> cells = space.CellSpace.of_grid(np.ones((2, 2), bool), directions=4)
        >>> policy = bounce.coverage_policy(cells, [math.pi], error=math.pi / 2, reliability=0.8)
        >>> policy.mixture.round(6).tolist()
        [0.25, 0.25, 0.25, 0.25]
    """
    require_x64("coverage_policy")
    if not traced(bounces):
        check_different(bounces, cells.directions)
    branches = len(noisy_turns(bounces[0], error, reliability, cells.directions)[0])
    wanted = coverage_target(cells, target)
    needed = functools.partial(estimates.coverage, angles=len(bounces), branches=branches)
    estimates.check_cells(cells, motion, needed, "coverage")
    possible = moves_of(cells, motion=motion)
    about = error, reliability, wanted, weights, goal, progress
    return policy_of_moves(cells, possible, bounces, *about)


def policy_of_moves(
    cells: CellSpace,
    possible: Moves,
    bounces: Any,
    error: float,
    reliability: float | Array,
    target: Float[Any, "positions"],
    weights: Literal["basin", "size"],
    goal: Bool[np.ndarray | Array, "positions"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> CoveragePolicy:
    """Find the mixture of [`coverage_policy`][] from the moves of the cells and from the target."""
    turns = [noisy_turns(b, error, reliability, cells.directions) for b in bounces]
    groups, limiting, coverage, arrival = [], [], [], []
    there = None if goal is None else namespace(goal).tile(goal, cells.directions)
    for turn, probability in turns:
        chain = noisy_chain(possible, turn, probability)
        groups.append(persistent_groups(chain))
        limiting.append(limiting_distribution(chain, groups[-1], weights))
        value = limiting[-1].value.reshape(cells.directions, cells.positions)
        coverage.append(value.sum(axis=0))
        if there is not None:
            arrival.append(hitting_times(chain, there))
        if progress is not None:
            progress(len(coverage))
    each = jnp.stack(coverage)
    best = mixture(each.T, target)
    return CoveragePolicy(
        cells=cells,
        bounce=namespace(bounces).asarray(bounces, float),
        alpha=best.weights,
        coverage=each,
        mixture=best.value,
        target=put_on_device(target),
        distance=best.distance,
        certificate=best.certificate,
        groups=tuple(groups),
        limiting=tuple(limiting),
        goal=goal,
        arrival=tuple(arrival),
    )


def check_different(bounces: Any, directions: int) -> None:
    """Raise `ValueError` unless there are bouncing angles, which are different directions."""
    shifts = [int(bounce_shift(float(one), directions)) for one in bounces]
    if not shifts:
        raise ValueError("bounces: expected at least one angle, got none")
    for i, shift in enumerate(shifts):
        if shift in shifts[:i]:
            raise ValueError(
                f"bounces: {math.degrees(bounces[i]):g} deg comes twice, as angles {i} and "
                f"{shifts.index(shift)}"
            )


def coverage_target(cells: CellSpace, target: Target = None) -> Float[Any, "positions"]:
    """Compute a target for coverage, as a distribution over the positions; it works under `jit`.

    **Arguments:** a cell space, and the relative worth of each position: `None` if all positions
    have the same worth; a function of arrays `x, y` of centres in metres; an array over the
    positions; or an image `[rows, columns]`, whose first row is at the top. The image is stretched
    over all squares of the map, and its values at the centres are used.

    **Returns:** the share of each position; the shares sum to 1.

    The last of three squares is worth twice as much as the others:

        >>> import numpy as np
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.coverage_target(cells, np.array([1, 1, 2])).tolist()
        [0.25, 0.25, 0.5]
    """
    x, y, _ = cells.centre(np.arange(cells.positions))
    given = np.ones(cells.positions) if target is None else target
    given = given(x, y) if callable(given) else given
    xp = namespace(given)
    worth = xp.asarray(given, float)
    if worth.ndim == 2 and worth.size:
        rows, columns = worth.shape
        height, width = cells.free.shape
        right = (x - cells.origin[0]) / (width * cells.cell)
        up = (y - cells.origin[1]) / (height * cells.cell)
        # Rounding puts a centre on the edge between two pixels into the same pixel everywhere.
        column, row = (np.floor(np.round(v, 9)).astype(int) for v in (right * columns, up * rows))
        worth = worth[rows - 1 - row, column]
    if worth.shape != (cells.positions,):
        raise ValueError(
            f"target: expected {cells.positions} numbers, one per position, or an image, got shape "
            f"{worth.shape}"
        )
    wrong: Any = [] if xp is jnp else np.flatnonzero(~(np.isfinite(worth) & (worth >= 0)))
    if len(wrong):
        at = wrong[0]
        raise ValueError(
            f"target: {worth[at]:g} at position {at} ({x[at]:g} m, {y[at]:g} m); expected a finite "
            "number from 0"
        )
    if xp is np and not worth.any():
        raise ValueError("target: it is 0 at all positions; expected more at one of them")
    # The division by the largest number prevents an overflow of the sum.
    worth = worth / worth.max()
    return worth / worth.sum()
