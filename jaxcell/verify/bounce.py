import numpy as np
from jaxtyping import Bool, Int

from ..automata import Filter
from ..mapping import GroupSummary, PeriodicGroups, SimpleMap
from ..space import CellSpace
from .comparison import Comparison
from .motion import Walker


_IMAGES = 200
_WALKS = 200
# Of all walks together, and of the candidates of all strings.
_MOST_STEPS = 1_000_000
_STRINGS = 20
_LONGEST_STRING = 60


def sample(size: int, count: int, seed: int = 0) -> Int[np.ndarray, "sample"]:
    """Some of the numbers from 0 to `size - 1`: all, or as many as asked for, always the same."""
    if size <= count:
        return np.arange(size)
    return np.sort(np.random.default_rng(seed).choice(size, count, replace=False))


def compare_images(
    cells: CellSpace,
    simple_map: SimpleMap,
    bounce: float,
    *,
    step: float | None = None,
    collision: str = "swept",
    only: Int[np.ndarray, "some"] | None = None,
) -> Comparison:
    """The images of some cells against one step at a time of exact geometry.

    **Arguments:**

    - `cells`: the cells of a map.
    - `simple_map`: the map to compare.
    - `bounce`: its bouncing angle, in radians.
    - `step`, `collision`: as for [`jaxcell.bounce.moves`][].
    - `only`: the cells to compare; by default 200 of all.
    """
    image, bumped = np.asarray(simple_map.image), np.asarray(simple_map.bumped)
    walker = Walker(cells, step, collision)
    shift = round(bounce * cells.directions / (2 * np.pi))
    wrong, count = [], 0
    for z in (sample(cells.size, _IMAGES) if only is None else only).tolist():
        target = walker.target(z)
        if target is None:
            continue
        count += 1
        direction, position = divmod(z, cells.positions)
        bumps = target == position
        turned = (direction + shift * bumps) % cells.directions
        expected = turned * cells.positions + target
        if (int(image[z]), bool(bumped[z])) != (expected, bumps):
            wrong.append(f"cell {z}: its image is {image[z]}, and {expected} by geometry")
    return Comparison.exact("images of cells, by shapely one step at a time", wrong, count)


def compare_groups(
    image: Int[np.ndarray, "cells"],
    groups: PeriodicGroups,
    summary: GroupSummary | None = None,
) -> list[Comparison]:
    """The periodic groups of a map against walks from some cells until they come around.

    **Arguments:**

    - `image`: the image of every cell.
    - `groups`: the groups to compare.
    - `summary`: what was told of them without an array over the cells, to compare with them.
    """
    group, step, period = (np.asarray(a) for a in (groups.group, groups.step, groups.period))
    follow = np.ascontiguousarray(image).data
    wrong, count, left = [], 0, _MOST_STEPS
    # Not in ascending order, lest the first directions take all the steps there are.
    for z in np.random.default_rng(0).permutation(sample(image.size, _WALKS)).tolist():
        if left < 0:
            break
        seen: dict[int, int] = {}
        at = z
        while at not in seen:
            seen[at] = len(seen)
            at = follow[at]
        left -= len(seen)
        count += 1
        steps, around = seen[at], len(seen) - seen[at]
        first = min(cell for cell, time in seen.items() if time >= steps)
        told = (int(step[z]), int(period[z]), int(group[z]), 0)
        walked = (steps, around, int(group[first]), int(step[first]))
        if told != walked:
            wrong.append(
                f"cell {z}: step {told[0]}, period {told[1]}, group {told[2]}; by walking there "
                f"{walked[0]}, {walked[1]}, {walked[2]}"
            )
    found = [Comparison.exact("groups of cells, by walking until they repeat", wrong, count)]
    if summary is not None:
        found.append(_compare_summary(group, step, period, summary))
    return found


def _compare_summary(
    group: Int[np.ndarray, "cells"],
    step: Int[np.ndarray, "cells"],
    period: Int[np.ndarray, "cells"],
    summary: GroupSummary,
) -> Comparison:
    count = int(summary.count)
    wrong = [] if count == group.max() + 1 else [f"{count} groups, and {group.max() + 1} of cells"]
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(group.max() + 1))
    tables = {
        "basin": np.diff(np.append(starts, group.size)),
        "transient": np.maximum.reduceat(step[order], starts),
        "period": np.add.reduceat(step[order] == 0, starts, dtype=np.int64),
    }
    if not np.array_equal(tables["period"][group], period):
        wrong.append("the period of a group is not the number of its periodic cells")
    for name, counted in tables.items():
        told = np.asarray(getattr(summary, name))[:count]
        same = told.shape == counted.shape and np.array_equal(told, counted)
        if not same:
            wrong.append(f"{name} of the groups: {told[:5]}..., by counting cells {counted[:5]}...")
    return Comparison.exact("numbers of the groups, by counting cells", wrong, 3 * count + 1)


def compare_filter(simple_map: SimpleMap, filter: Filter) -> Comparison:
    """A filter against the set of cells where a robot may be, kept along random strings.

    After each observation both the state that follows it and the one that would have followed the
    other are compared.

    **Arguments:**

    - `simple_map`: image and observation of every cell.
    - `filter`: the filter of this map.
    """
    image, bumped = np.asarray(simple_map.image), np.asarray(simple_map.bumped)
    random = np.random.default_rng(0)
    wrong, count, left = [], 0, _MOST_STEPS
    for _ in range(_STRINGS):
        cells, state, word = np.arange(image.size), 0, ""
        while len(word) < _LONGEST_STRING and left > 0:
            left -= cells.size
            after = [_after(image, bumped, cells, observation) for observation in (0, 1)]
            for observation in (0, 1):
                count += 1
                told = _told(filter, state, observation)
                if not np.array_equal(told, after[observation]):
                    wrong.append(
                        f"after {word}{observation}: {told.size} cells, and "
                        f"{after[observation].size} by keeping the set"
                    )
            if wrong:
                break
            possible = [observation for observation in (0, 1) if after[observation].size]
            seen = int(random.choice(possible))
            cells, state = after[seen], int(filter.transition[state, seen])
            word += str(seen)
    return Comparison.exact("states of the filter, by sets along random strings", wrong, count)


def _after(
    image: Int[np.ndarray, "all"],
    bumped: Bool[np.ndarray, "all"],
    cells: Int[np.ndarray, "some"],
    observation: int,
) -> Int[np.ndarray, "later"]:
    return np.unique(image[cells[bumped[cells] == observation]])


def _told(filter: Filter, state: int, observation: int) -> Int[np.ndarray, "cells"]:
    """The cells of the state after an observation; none if there is no such state."""
    state = int(filter.transition[state, observation])
    return np.empty(0, np.int32) if state < 0 else filter.cells(state)
