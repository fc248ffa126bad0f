"""A robot of your own, which leaves each wall at a random angle.

    jaxcell run experiments/your_own_robot.py:RandomBounce @complex --out runs/mine

Define the images of each cell, and a study with its result. Options, tables, JSON, NetCDF, a
recording, and sweeps with `task = "experiments/your_own_robot.py:RandomBounce"` follow.
"""

import dataclasses
from typing import Annotated

import numpy as np

from jaxcell import bounce, space
from jaxcell.base.quantities import Result, derived, quantity
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.markov import hitting_times, limiting_distribution
from jaxcell.study import MapStudy


def random_bounce_map(cells: space.CellSpace) -> Chain:
    """Make the generalized map of a robot that turns to a random direction at each bump."""
    straight = bounce.bounce_map(cells, 0.0)
    direction, position = np.divmod(np.arange(cells.size), cells.positions)
    slot = np.arange(cells.directions)[:, None]
    # A step has one image with probability 1; its other images have probability 0.
    ahead = np.where(slot == 0, straight.image, direction * cells.positions + position)
    return Chain(
        np.where(straight.bumped, slot * cells.positions + position, ahead),
        np.where(straight.bumped, 1 / cells.directions, slot == 0),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Wandering(Result):
    title = "A robot that leaves each wall at a random angle"

    cells: space.CellSpace
    share: Annotated[np.ndarray, quantity("position", "share of time", "1", kind="distribution")]
    steps: Annotated[
        np.ndarray, quantity("position", "mean steps to the goal", "step", kind="time")
    ]

    @derived("", "mean steps to the goal, over all starts", "step", kind="time")
    def mean_steps(self) -> float:
        return float(self.steps.mean())


@dataclasses.dataclass(frozen=True, kw_only=True)
class RandomBounce(MapStudy):
    """Compute the share of time in each position, and the mean steps to a goal."""

    goal: int = 0
    """The position of the goal."""

    def run(self, say=print) -> Wandering:
        cells = self.cells()
        chain = random_bounce_map(cells)
        limiting = limiting_distribution(chain, persistent_groups(chain)).value
        steps = hitting_times(chain, np.arange(cells.size) % cells.positions == self.goal).value
        by_direction = (np.asarray(x).reshape(-1, cells.positions) for x in (limiting, steps))
        share, steps = by_direction
        return Wandering(cells, share.sum(axis=0), steps.mean(axis=0))
