import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Int, Integer

from .equivalent import ranked


Aim: TypeAlias = Literal["worst", "mean"]

# Beyond so many choices in a row the search would outgrow Python's stack.
_DEEPEST = 200


@dataclasses.dataclass(frozen=True, eq=False)
class Decisions:
    """Which input a strategy chooses for each set of states that it meets, and what that costs.

    A set is the number of one of `sets`; the choices from one set on make a tree in which equal
    sets are shared.
    """

    sets: list[tuple[int, ...]]
    "The states of each set, in ascending order."
    choice: list[int]
    "The input at each set, -1 where none is needed."
    after: list[dict[int, int]]
    "The set after each observation that may follow; none where no input is needed."
    roots: list[int]
    "The sets that the strategy begins with."
    lower: list[int]
    "For each root, what every strategy costs at least."
    upper: list[int]
    "For each root, what this one costs."
    searched: int
    "Number of sets whose choices were all looked at."

    @property
    def optimal(self) -> bool:
        """Whether no strategy costs less."""
        return self.lower == self.upper


def adaptive_choice(
    images: Integer[np.ndarray, "inputs states"],
    observations: Integer[np.ndarray, "inputs states"],
    roots: Sequence[Sequence[int] | Int[np.ndarray, "_"]],
    *,
    place: Integer[np.ndarray, "states"] | None = None,
    aim: Aim = "worst",
    limit: int = 5_000_000,
) -> Decisions:
    """Choose inputs, each by what was observed before it, until a set is known well enough.

    The machine is in an unknown state of a root. An input leaves of a set those states whose
    observation is the one that comes, and takes them to their images, until all that are left are
    *settled*: no inputs tell any two of them apart, or they are in one place.

    A greedy strategy comes first: the input that leaves little at worst, or where none tells states
    apart, one that brings the nearest two nearer to it. Then all strategies are searched, depth
    first with the costs of sets met before. No set costs less than its pair that is hardest to tell
    apart, and none of its states less than its own hardest pair; what cannot beat the best so far
    is left out. If the search ends, the strategy is proved the best; if `limit` ends it, `lower`
    still holds.

    **Arguments:**

    - `images`: the state after each input. No two states with one observation may have the same.
    - `observations`: what is observed on the way there.
    - `roots`: the sets that may be met first, without repeats.
    - `place`: where two states are settled if they have the same; by default nowhere.
    - `aim`: what is made small: the inputs that a set needs at worst, or their sum over its states.
    - `limit`: how many states the searched sets may have together: what the search takes.

    **Returns:** [`Decisions`][].

    **Raises:** `ValueError` if two states have the same image and observation.

    A ring of three states whose bell rings in state 2, and an input that goes the other way round.
    Told that the bell is silent, one input finds out which of the other two it was:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> images = np.array([[1, 2, 0], [2, 0, 1]])
        >>> rings = np.array([[0, 1, 0], [1, 0, 0]])
        >>> found = automata.adaptive_choice(images, rings, [[0, 1, 2]])
        >>> found.upper, found.optimal
        ([2], True)
    """
    check_apart(images, observations)
    search = Search(images, observations, place, aim, limit)
    numbers = [search.number(tuple(sorted(map(int, root)))) for root in roots]
    for one in numbers:
        search.greedy(one)
    for one in sorted(numbers, key=lambda one: -len(search.sets[one])):
        search.solve(one)
    return search.decisions(numbers)


def check_apart(
    images: Integer[np.ndarray, "inputs states"],
    observations: Integer[np.ndarray, "inputs states"],
) -> None:
    """Raises `ValueError` if two states have the same image and observation."""
    for i, (image, observation) in enumerate(zip(images, observations, strict=True)):
        if np.unique(ranked(image, observation)).size < image.size:
            raise ValueError(
                f"images[{i}]: two states have the same image and observation, so that they merge"
            )


def levels(
    images: Integer[np.ndarray, "inputs states"],
    observations: Integer[np.ndarray, "inputs states"],
) -> list[Int[np.ndarray, "states"]]:
    """The classes of states that so many inputs do not tell apart: none, one, and so on.

    The last are those that none do. Two states that are first in different classes of level `i`
    are told apart by `i` inputs, and not by fewer.
    """
    found = [np.zeros(images.shape[1], np.int64)]
    seen = np.zeros(images.shape[1], np.int64)
    for observation in observations:
        seen = ranked(seen, np.unique(observation, return_inverse=True)[1])
    finer = seen
    while finer.max(initial=0) > found[-1].max(initial=0):
        found.append(finer)
        finer = seen
        for image in images:
            finer = ranked(finer, found[-1][image])
    return found


class Search:
    """Sets of states by number, with bounds on what they cost."""

    def __init__(
        self,
        images: Integer[np.ndarray, "inputs states"],
        observations: Integer[np.ndarray, "inputs states"],
        place: Integer[np.ndarray, "states"] | None,
        aim: Aim,
        limit: int,
    ) -> None:
        self.image, self.observation = images.tolist(), observations.tolist()
        self.levels = [level.tolist() for level in levels(images, observations)]
        self.place = None if place is None else place.tolist()
        self.aim, self.left = aim, limit
        self.searched = 0
        self.numbers: dict[tuple[int, ...], int] = {}
        self.sets: list[tuple[int, ...]] = []
        self.lower: list[int] = []
        self.upper: list[float | int] = []
        self.choice: list[int] = []
        self.after: list[list[dict[int, int]] | None] = []

    def number(self, states: tuple[int, ...]) -> int:
        """The number of a set; a new one has the bounds that its pairs give."""
        one = self.numbers.setdefault(states, len(self.sets))
        if one == len(self.sets):
            bound = self._bound(states)
            self.sets.append(states)
            self.lower.append(bound)
            self.upper.append(math.inf if bound else 0)
            self.choice.append(-1)
            self.after.append(None)
        return one

    def _bound(self, states: tuple[int, ...]) -> int:
        """What the hardest pairs cost, 0 if all are settled."""
        if len(states) == 1:
            return 0
        if self.place is not None:
            return (1 if self.aim == "worst" else len(states)) * (not self._in_places(states))
        # A state is done at the level where those that are still with it are equivalent to it.
        final, total, left = self.levels[-1], 0, list(states)
        for depth, level in enumerate(self.levels):
            mixed: dict[int, int] = {}
            for x in left:
                if mixed.setdefault(level[x], final[x]) != final[x]:
                    mixed[level[x]] = -1
            rest = [x for x in left if mixed[level[x]] < 0]
            if self.aim == "mean":
                total += depth * (len(left) - len(rest))
            elif not rest:
                return depth
            left = rest
            if not left:
                break
        return total

    def _in_places(self, states: tuple[int, ...]) -> bool:
        """Whether each two states are in one place or equivalent."""
        assert self.place is not None
        # If two are neither, some state has both another place and another class than the first,
        # or there are some of each kind.
        place, final = self.place, self.levels[-1]
        kinds = {(place[x], final[x]) for x in states}
        return len({p for p, _ in kinds}) == 1 or len({c for _, c in kinds}) == 1

    def parts(self, one: int) -> list[dict[int, int]]:
        """For each input, the set after each observation."""
        known = self.after[one]
        if known is not None:
            return known
        states, found = self.sets[one], []
        for image, observation in zip(self.image, self.observation, strict=True):
            groups: dict[int, list[int]] = {}
            for x in states:
                groups.setdefault(observation[x], []).append(image[x])
            found.append({o: self.number(tuple(sorted(g))) for o, g in sorted(groups.items())})
        self.after[one] = found
        return found

    def cost(self, one: int, bounds: Sequence[float | int], after: dict[int, int]) -> float | int:
        """What a set costs if it goes on to others with some bounds."""
        if self.aim == "worst":
            return 1 + max(bounds[part] for part in after.values())
        return len(self.sets[one]) + sum(bounds[part] for part in after.values())

    def greedy(self, root: int) -> None:
        """Give a set and those after it the cost of the greedy strategy."""
        # Successors first; the strategy comes nearer to its end with each choice.
        stack = [root]
        while stack:
            one = stack[-1]
            if self.upper[one] < math.inf:
                stack.pop()
                continue
            chosen = self.choice[one]
            if chosen < 0:
                chosen = self.choice[one] = self._greedy_choice(one)
            after = self.parts(one)[chosen]
            open_ = [part for part in after.values() if self.upper[part] == math.inf]
            stack += open_
            if not open_:
                self.upper[one] = self.cost(one, self.upper, after)
                stack.pop()

    def _greedy_choice(self, one: int) -> int:
        parts = self.parts(one)
        splits = [i for i, after in enumerate(parts) if len(after) > 1]
        if not splits:
            return self.toward_nearest([one])

        def left(i: int) -> tuple[float | int, float | int]:
            sizes = [len(self.sets[part]) for part in parts[i].values()]
            if self.aim == "worst":
                return max(self.lower[part] for part in parts[i].values()), max(sizes)
            return sum(size * math.log2(size) for size in sizes), 0

        return min(splits, key=left)

    def toward_nearest(self, some: Sequence[int]) -> int:
        """An input that brings the pair of the sets that is told apart soonest nearer to that."""
        depth, one = min(
            (next(d for d, level in enumerate(self.levels) if _differ(level, self.sets[one])), one)
            for one in some
        )
        before, states = self.levels[depth - 1], self.sets[one]
        images = ([image[x] for x in states] for image in self.image)
        return next(i for i, image in enumerate(images) if _differ(before, image))

    def solve(self, root: int) -> None:
        """Search for the best strategy from a set that has a strategy."""
        if self.upper[root] > _DEEPEST * (1 if self.aim == "worst" else len(self.sets[root])):
            return
        if self.aim == "mean":
            self._improve(root, math.inf)
            return
        while self.lower[root] < self.upper[root] and self.left > 0:
            self._improve(root, self.lower[root] + 1)

    def _improve(self, one: int, limit: float | int) -> None:
        """Search until a set is known to cost `limit` or more, or what it costs is known."""
        if self.lower[one] >= min(limit, self.upper[one]):
            return
        if self.left <= 0:
            return
        self.left -= len(self.sets[one])
        self.searched += 1
        least = math.inf
        choices = sorted(
            (self.cost(one, self.lower, after), i) for i, after in enumerate(self.parts(one))
        )
        for low, i in choices:
            after = self.parts(one)[i]
            for part in sorted(after.values(), key=lambda part: -len(self.sets[part])):
                goal = min(limit, self.upper[one])
                low = self.cost(one, self.lower, after)
                if low >= goal:
                    break
                spare = goal - (1 if self.aim == "worst" else low - self.lower[part])
                self._improve(part, spare)
            low = self.cost(one, self.lower, after)
            high = self.cost(one, self.upper, after)
            if high < self.upper[one]:
                self.upper[one], self.choice[one] = high, i
            least = min(least, low)
        self.lower[one] = max(self.lower[one], int(min(least, self.upper[one])))

    def decisions(self, roots: list[int]) -> Decisions:
        """The strategy, with its sets numbered anew in the order in which it meets them."""
        number = {one: i for i, one in enumerate(dict.fromkeys(roots))}
        queue = list(number)
        choice, after = [], []
        for one in queue:
            ends = self.lower[one] == self.upper[one] == 0
            choice.append(-1 if ends else self.choice[one])
            onward = {} if ends else self.parts(one)[self.choice[one]]
            for part in onward.values():
                if part not in number:
                    number[part] = len(queue)
                    queue.append(part)
            after.append({o: number[part] for o, part in onward.items()})
        return Decisions(
            sets=[self.sets[one] for one in queue],
            choice=choice,
            after=after,
            roots=[number[one] for one in roots],
            lower=[self.lower[one] for one in roots],
            upper=[int(self.upper[one]) for one in roots],
            searched=self.searched,
        )


def _differ(level: list[int], states: Sequence[int]) -> bool:
    """Whether some states are in different classes."""
    return any(level[a] != level[b] for a, b in itertools.pairwise(states))
