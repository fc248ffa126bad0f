import dataclasses
import functools
import math

import numpy as np
from jaxtyping import Float, Int

from ..automata.hidden import Estimate, credible
from ..base.shown import Shown
from ..space import CellSpace, Slip, felt_walls, nearest_cell, slipping_step, stride_legs
from ..space.slip import ERRORS, MISSED


@dataclasses.dataclass(frozen=True, eq=False)
class Cloud(Shown):
    """The state of the particles after the observations so far."""

    pose: Float[np.ndarray, "particles 3"]
    "The pose of each particle: x and y in metres, and the heading in radians."
    believed: Int[np.ndarray, "particles"]
    "The number of the direction in which each particle would face if its turns had no errors."
    observations: int
    "The number of observations so far."
    matched: float
    "The fraction of the particles that agreed with the last observation."


@dataclasses.dataclass(frozen=True, eq=False)
class Particles:
    """Monte Carlo localization by particles, which are simulated robots that slip.

    The particles start at the centres of cells, and move by [`jaxcell.space.slipping_step`][].
    After each step, new particles are drawn from those that agree with the observation. Runs with
    the same seed are equal.

    In a corridor, a robot that bumps after two free steps has turned at an end, in cell 0 or 5:

        >>> import math
        >>> from jaxcell import examples, robot, space
        >>> cells = examples.corridor()
        >>> cloud = robot.Particles(cells, math.pi, space.Slip.of(0.01), count=200)
        >>> state = cloud.start()
        >>> for observation in (0, 0, 1):
        ...     state = cloud.observe(state, observation)
        >>> sorted(cloud.estimate(state).cells.tolist())
        [0, 5]
    """

    cells: CellSpace
    bounce: float
    "The bouncing angle in radians, counter-clockwise."
    slip: Slip
    step: float | None = None
    "The length of a step in metres, by default the side of a cell."
    count: int = 10_000
    "The number of particles."
    seed: int = 0
    share: float = 0.95
    "The least probability with which the credible set of an estimate contains the robot."

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ValueError(f"count: expected at least 1 particle, got {self.count}")

    @functools.cached_property
    def _legs(self) -> Float[np.ndarray, "directions 3"]:
        step = self.cells.cell if self.step is None else self.step
        return stride_legs(self.cells.directions, self.cells.cell, step)

    @functools.cached_property
    def _walls(self) -> Float[np.ndarray, "walls 2 2"]:
        return felt_walls(self.cells.room, self.slip.give)

    def start(self) -> Cloud:
        """Put an equal number of particles at the centre of each cell."""
        chosen = np.random.default_rng([self.seed, 0]).permutation(self.count) % self.cells.size
        pose = np.stack(self.cells.centre(chosen), axis=1)
        return Cloud(pose, chosen // self.cells.positions, 0, 1.0)

    def observe(self, state: Cloud, observation: int) -> Cloud:
        """Move the particles by a step, and resample those that agree with the observation."""
        rng = np.random.default_rng([self.seed, state.observations + 1])
        errors = rng.standard_normal((self.count, ERRORS))
        legs = self._legs[state.believed]
        pose, bumped = slipping_step(state.pose, legs, self.bounce, errors, self._walls, self.slip)
        shift = round(self.bounce * self.cells.directions / (2 * math.pi))
        believed = (state.believed + shift * bumped) % self.cells.directions
        match = bumped == observation
        weight = np.where(match, 1.0, MISSED)
        # Systematic resampling: evenly spaced draws along the weights have the least variance.
        ends = np.cumsum(weight)
        drawn = (np.arange(self.count) + rng.random()) / self.count * ends[-1]
        kept = np.minimum(np.searchsorted(ends, drawn, side="right"), self.count - 1)
        return Cloud(pose[kept], believed[kept], state.observations + 1, float(match.mean()))

    def estimate(self, state: Cloud) -> Estimate:
        """Compute the credible set; its `nowhere` is 1 if no particle matched the observation."""
        where = nearest_cell(self.cells, *state.pose.T)
        mass = np.bincount(where, minlength=self.cells.size) / self.count
        return credible(mass, self.share, float(state.matched == 0))
