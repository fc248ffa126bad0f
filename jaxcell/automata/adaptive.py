import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Int, Integer

from ..base.shown import Shown
from .equivalent import ranked


Aim: TypeAlias = Literal["worst", "mean"]

# Number of choices in a row beyond which the search would exceed Python's stack.
_DEEPEST = 200


@dataclasses.dataclass(frozen=True, eq=False)
class Decisions(Shown):
    """An adaptive strategy: the input for each set of possible states, and its cost.

    The number of a set is its index in `sets`. Each set is listed once, even if several branches of
    the strategy reach it. The strategy ends at *settled* sets, which need not be divided further.
    """

    sets: list[tuple[int, ...]]
    "The states of each set, in ascending order."
    choice: list[int]
    "The input for each set; -1 for a settled set, which needs no input."
    after: list[dict[int, int]]
    "For each set, the number of the next set after each observation; empty for a settled set."
    roots: list[int]
    "The numbers of the initial sets, in the order of `roots` in [`adaptive_choice`][]."
    lower: list[int]
    "For each of `roots`, a lower bound on the cost of any strategy."
    upper: list[int]
    "For each of `roots`, the cost of this strategy."
    searched: int
    "Number of sets for which the search compared the inputs."

    @property
    def optimal(self) -> bool:
        """`True` if it is proved that no strategy costs less."""
        return self.lower == self.upper


def adaptive_choice(
    images: Integer[np.ndarray, "inputs states"],
    observations: Integer[np.ndarray, "inputs states"],
    roots: Sequence[Sequence[int] | Int[np.ndarray, "_"]],
    *,
    place: Integer[np.ndarray, "states"] | None = None,
    aim: Aim = "worst",
    limit: int = 5_000_000,
    avoid: Bool[np.ndarray, "inputs states"] | None = None,
) -> Decisions:
    """Find a strategy of inputs that depend on observations, to identify the state of a machine.

    At first the machine may be in any state of one set, a *root*. An input moves each state to its
    image, and the observation excludes the states that would have given another observation. The
    strategy ends when the remaining states are *settled*: all are equivalent, or all have the same
    label in `place`.

    A greedy strategy is computed first. It chooses the input that divides a set best. If no input
    distinguishes two states, it chooses an input after which at least one pair is easier to
    distinguish. Then all strategies are searched depth first. A set costs at least as much as the
    pair of its states that is hardest to distinguish; an input is skipped if, by this bound, it
    cannot improve the best strategy. A complete search proves the strategy optimal; if `limit` ends
    the search, `lower` is still a lower bound.

    **Arguments:**

    - `images`: the state after each input. States with equal observations must have different
        images.
    - `observations`: the observation between each state and its image.
    - `roots`: sets of states in which the machine may be at first, each without repeats.
    - `place`: the label of the place of each state. By default all places differ.
    - `aim`: the cost of a set: the number of inputs in the worst case (`"worst"`), or the sum of
        the number of inputs over the states of the set (`"mean"`).
    - `limit`: the search ends when the sets that it has examined have this many states in total.
    - `avoid`: a mask of the inputs to avoid in each state. Among the inputs that cost a set
        equally little, the strategy takes the one that avoids most.

    **Returns:** [`Decisions`][].

    **Raises:** `ValueError` if two states have the same image and observation.

    Three states in a circle: input 0 goes forwards, and input 1 backwards. A bell rings when state
    2 is entered. Two inputs identify the state in the worst case:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> images = np.array([[1, 2, 0], [2, 0, 1]])
        >>> rings = np.array([[0, 1, 0], [1, 0, 0]])
        >>> strategy = automata.adaptive_choice(images, rings, [[0, 1, 2]])
        >>> strategy.upper, strategy.optimal
        ([2], True)
    """
    check_apart(images, observations)
    search = Search(images, observations, place, aim, limit)
    numbers = [search.number(tuple(sorted(map(int, root)))) for root in roots]
    for number in numbers:
        search.greedy(number)
    for number in sorted(numbers, key=lambda number: -len(search.sets[number])):
        search.solve(number)
    if avoid is not None and avoid.any():
        search.avoid(numbers, avoid)
    return search.decisions(numbers)


def check_apart(
    images: Integer[np.ndarray, "inputs states"], observations: Integer[np.ndarray, "inputs states"]
) -> None:
    """Raise `ValueError` if an input gives two states the same image and observation."""
    for i, (image, observation) in enumerate(zip(images, observations, strict=True)):
        if np.unique(ranked(image, observation)).size < image.size:
            raise ValueError(
                f"images[{i}]: two states have the same image and observation, so that they merge"
            )


def levels(
    images: Integer[np.ndarray, "inputs states"], observations: Integer[np.ndarray, "inputs states"]
) -> list[Int[np.ndarray, "states"]]:
    """Classify the states by the observations after 0, 1, 2, ... inputs.

    States have the same class in array `i` if no sequence of `i` inputs distinguishes them, and in
    the last array if no sequence of any length does.
    """
    levels = [np.zeros(images.shape[1], np.int64)]
    seen = np.zeros(images.shape[1], np.int64)
    for observation in observations:
        seen = ranked(seen, np.unique(observation, return_inverse=True)[1])
    finer = seen
    while finer.max(initial=0) > levels[-1].max(initial=0):
        levels.append(finer)
        finer = seen
        for image in images:
            finer = ranked(finer, levels[-1][image])
    return levels


class Search:
    """A search for a strategy: the sets of states found so far, with bounds on their costs.

    The attributes `sets`, `lower`, `upper`, `choice` and `after` have an entry per set.
    """

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
        """Return the number of a set; a new set gets the next number."""
        number = self.numbers.setdefault(states, len(self.sets))
        if number == len(self.sets):
            bound = self._bound(states)
            self.sets.append(states)
            self.lower.append(bound)
            self.upper.append(math.inf if bound else 0)
            self.choice.append(-1)
            self.after.append(None)
        return number

    def _bound(self, states: tuple[int, ...]) -> int:
        """Compute a lower bound on the cost of a set from pairs of states; 0 for a settled set."""
        final, place = self.levels[-1], self.place
        if len(states) == 1:
            return 0
        if place is not None:
            settled = 1 in (len({place[x] for x in states}), len({final[x] for x in states}))
            return 0 if settled else 1 if self.aim == "worst" else len(states)
        # A state is done at the level where all states of its class are equivalent to it.
        total, left = 0, list(states)
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

    def parts(self, number: int) -> list[dict[int, int]]:
        """Return, for each input, a dictionary from observations to the sets after set `number`."""
        known = self.after[number]
        if known is not None:
            return known
        states, parts = self.sets[number], []
        for image, observation in zip(self.image, self.observation, strict=True):
            groups: dict[int, list[int]] = {}
            for x in states:
                groups.setdefault(observation[x], []).append(image[x])
            parts.append({o: self.number(tuple(sorted(g))) for o, g in sorted(groups.items())})
        self.after[number] = parts
        return parts

    def cost(
        self, number: int, bounds: Sequence[float | int], after: dict[int, int]
    ) -> float | int:
        """Compute a bound on the cost of a set whose next input leads to the sets in `after`.

        `bounds` has a bound on the cost of every set, by its number, such as `lower` or `upper`.
        """
        if self.aim == "worst":
            return 1 + max(bounds[part] for part in after.values())
        return len(self.sets[number]) + sum(bounds[part] for part in after.values())

    def greedy(self, root: int) -> None:
        """Compute `upper`, the cost of the greedy strategy, for a set and the sets after it."""
        # Successors come first; each choice brings the strategy nearer to its end.
        stack = [root]
        while stack:
            number = stack[-1]
            if self.upper[number] < math.inf:
                stack.pop()
                continue
            chosen = self.choice[number]
            if chosen < 0:
                chosen = self.choice[number] = self._greedy_choice(number)
            after = self.parts(number)[chosen]
            open_ = [part for part in after.values() if self.upper[part] == math.inf]
            stack += open_
            if not open_:
                self.upper[number] = self.cost(number, self.upper, after)
                stack.pop()

    def _greedy_choice(self, number: int) -> int:
        parts = self.parts(number)
        splits = [i for i, after in enumerate(parts) if len(after) > 1]
        if not splits:
            return self.toward_nearest([number])

        def left(i: int) -> tuple[float | int, float | int]:
            sizes = [len(self.sets[part]) for part in parts[i].values()]
            if self.aim == "worst":
                return max(self.lower[part] for part in parts[i].values()), max(sizes)
            return sum(size * math.log2(size) for size in sizes), 0

        return min(splits, key=left)

    def toward_nearest(self, sets: Sequence[int]) -> int:
        """Choose the first input of a shortest sequence that divides at least one of `sets`."""
        depth, number = min(
            (next(d for d, level in enumerate(self.levels) if _differ(level, self.sets[n])), n)
            for n in sets
        )
        before, states = self.levels[depth - 1], self.sets[number]
        images = ([image[x] for x in states] for image in self.image)
        return next(i for i, image in enumerate(images) if _differ(before, image))

    def solve(self, root: int) -> None:
        """Search for the best strategy for a set whose greedy strategy is already known."""
        if self.upper[root] > _DEEPEST * (1 if self.aim == "worst" else len(self.sets[root])):
            return
        if self.aim == "mean":
            self._improve(root, math.inf)
            return
        while self.lower[root] < self.upper[root] and self.left > 0:
            self._improve(root, self.lower[root] + 1)

    def _improve(self, number: int, limit: float | int) -> None:
        """Search until the cost of a set is known, or is known to be at least `limit`."""
        if self.lower[number] >= min(limit, self.upper[number]) or self.left <= 0:
            return
        self.left -= len(self.sets[number])
        self.searched += 1
        least = math.inf
        choices = sorted(
            (self.cost(number, self.lower, after), i) for i, after in enumerate(self.parts(number))
        )
        for low, i in choices:
            after = self.parts(number)[i]
            for part in sorted(after.values(), key=lambda part: -len(self.sets[part])):
                goal = min(limit, self.upper[number])
                low = self.cost(number, self.lower, after)
                if low >= goal:
                    break
                spare = goal - (1 if self.aim == "worst" else low - self.lower[part])
                self._improve(part, spare)
            low = self.cost(number, self.lower, after)
            high = self.cost(number, self.upper, after)
            if high < self.upper[number]:
                self.upper[number], self.choice[number] = high, i
            least = min(least, low)
        self.lower[number] = max(self.lower[number], int(min(least, self.upper[number])))

    def avoid(self, roots: list[int], avoid: Bool[np.ndarray, "inputs states"]) -> None:
        """Choose, for each set, the input of least cost after which the fewest states are met that
        are to be avoided, here and at the sets after it."""
        queue = list(dict.fromkeys(roots))
        seen, cheapest = set(queue), dict[int, list[int]]()
        for number in queue:
            bound = self.upper[number]
            parts = self.parts(number) if bound else []
            inputs = [i for i, p in enumerate(parts) if self.cost(number, self.upper, p) <= bound]
            cheapest[number] = inputs
            new = [part for i in inputs for part in parts[i].values() if part not in seen]
            queue += dict.fromkeys(new)
            seen.update(new)
        # The sets after a set cost less than it.
        met: dict[int, int] = {}
        for number in sorted(queue, key=lambda number: self.upper[number]):
            states, least = list(self.sets[number]), []
            for i in cheapest[number]:
                after = self.parts(number)[i].values()
                count = int(avoid[i, states].sum()) + sum(met[part] for part in after)
                least.append((count, i != self.choice[number], i))
            met[number], _, chosen = min(least, default=(0, False, -1))
            self.choice[number] = chosen

    def decisions(self, roots: list[int]) -> Decisions:
        """Return the best strategy found, with its sets numbered in breadth-first order."""
        number = {old: i for i, old in enumerate(dict.fromkeys(roots))}
        queue = list(number)
        choice, after = [], []
        for old in queue:
            ends = self.lower[old] == self.upper[old] == 0
            choice.append(-1 if ends else self.choice[old])
            onward = {} if ends else self.parts(old)[self.choice[old]]
            for part in onward.values():
                if part not in number:
                    number[part] = len(queue)
                    queue.append(part)
            after.append({o: number[part] for o, part in onward.items()})
        return Decisions(
            sets=[self.sets[old] for old in queue],
            choice=choice,
            after=after,
            roots=[number[root] for root in roots],
            lower=[self.lower[root] for root in roots],
            upper=[int(self.upper[root]) for root in roots],
            searched=self.searched,
        )


def _differ(classes: list[int], states: Sequence[int]) -> bool:
    return any(classes[a] != classes[b] for a, b in itertools.pairwise(states))
