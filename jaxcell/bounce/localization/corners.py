"""The starts from which a robot touches a wall before a filter or a policy has localized it."""

import numpy as np
from jaxtyping import Bool, Int

from ...automata import Filter, Policy
from ..plans.roadmap import Roadmap


def filter_touches(
    filter: Filter,
    image: Int[np.ndarray, "cells"],
    bumped: Bool[np.ndarray, "cells"],
    touches: Bool[np.ndarray, "cells"],
    confirm: int,
) -> Bool[np.ndarray, "cells"]:
    """Find the starts from which a robot touches a wall before a filter has localized it.

    The run ends when one configuration has been left, or a knowledge cycle reached, for `confirm`
    observations.
    """
    known = (filter.uncertainty == 1) | (filter.color > 1)
    touched = np.zeros(image.size, bool)
    start = cell = np.arange(image.size)
    state, agreed = np.zeros(image.size, np.int64), np.full(image.size, -1)
    while start.size:
        touched[start] |= touches[cell]
        state = filter.transition[state, bumped[cell].astype(int)]
        cell = image[cell]
        agreed += known[state] | (agreed >= 0)
        left = (agreed < confirm) & ~touched[start]
        start, cell, state, agreed = start[left], cell[left], state[left], agreed[left]
    return touched


def policy_touches(
    policy: Policy, roadmap: Roadmap, touches: Bool[np.ndarray, "cells"], confirm: int
) -> Bool[np.ndarray, "cells"]:
    """Find the starts from which a robot touches a wall before a policy has localized it.

    The run ends at a bump, at least `confirm` observations after the end of the policy.
    """
    onward = policy.onward
    assert onward is not None
    runs = touching_runs(roadmap, touches)
    touched = np.zeros(roadmap.size, bool)
    start = cell = np.arange(roadmap.size)
    state, agreed = np.zeros(roadmap.size, np.int64), np.full(roadmap.size, -1)
    while start.size:
        touched[start] |= runs[cell]
        on = agreed >= 0
        agreed[on] += roadmap.length[cell[on]] + 1
        state[~on] = policy.next_states(state[~on], roadmap.length[cell[~on]])
        turn = policy.turn[state]
        agreed[~on & (turn < 0)] = 0
        left = (agreed < confirm) & ~touched[start]
        cell = roadmap.turned[np.where(turn < 0, onward.turn, turn), roadmap.wall[cell]]
        start, cell, state, agreed = start[left], cell[left], state[left], agreed[left]
    return touched


def touching_runs(
    roadmap: Roadmap, touches: Bool[np.ndarray, "cells"]
) -> Bool[np.ndarray, "cells"]:
    """Compute a mask of the cells from which the run to the next wall has a step in `touches`."""
    count = np.append(0, np.cumsum(touches[roadmap.order]))
    end = roadmap.place[roadmap.wall_cell[roadmap.wall]]
    return count[end] > count[roadmap.place]
