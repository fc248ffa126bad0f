import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ....base.process import no_output
from ..symmetries import symmetries


# Least distance of promises from a set for a cut, and the probability of going on after a cut.
_OUTSIDE, _ON = 1e-6, 0.7
# Largest number of steps of a walk along which cuts are made, and the number of rounds of walks,
# one from each model, without a new cut after which the search ends.
_DEPTH, _ROUNDS = 30, 4

Cuts = dict[int, list[tuple[Any, float]]]


class Pursuit:
    """Upper bounds on capture by a robot with any memory, from nested Benders cuts.

    The *promises* of a robot at a vertex are probabilities of reaching each target within each
    number of steps. The promises that it can keep form a convex set at each vertex. After a move,
    the promises for targets not yet reached must be kept in the time that is left. Because the
    adversary may attack at any time, promises for the whole attack time must always be at least a
    given probability. Each set is approximated from outside by *cuts*, half-spaces that contain it.
    A linear program at a vertex, with the sets at its neighbours, either shows how given promises
    can be kept, or returns a cut that excludes them, as in stochastic dual dynamic programming.
    Programs are solved along random walks whose moves follow the last solution. Vertices that
    symmetries of the game map to each other share the cuts of one of them, the *model*.
    """

    def __init__(
        self,
        delays: Int[np.ndarray, "vertices vertices"],
        attack: Int[np.ndarray, "vertices"],
        targets: list[int],
    ) -> None:
        self.delays, self.attack, self.targets = delays, attack, targets
        self.beside = [np.flatnonzero(row).tolist() for row in delays]
        kinds = [(int(time), here in targets) for here, time in enumerate(attack)]
        alike = symmetries(delays, kinds)
        self.column = self._columns(int(attack[targets].max()))
        self.sizes = self.column.max(axis=(1, 2)) + 1
        self.models: dict[int, int] = {}
        self.images = [self._images(here, alike) for here in range(len(delays))]

    def _images(
        self, here: int, alike: Int[np.ndarray, "symmetries vertices"]
    ) -> list[Int[np.ndarray, "promises"]]:
        """Choose the model of a vertex: a vertex to which one of the symmetries `alike` maps it.

        Returns one array per symmetry that maps the vertex to the model: the index of the promise
        of the model that corresponds to each promise of the vertex."""
        there = alike[:, here].tolist()
        model = next((vertex for vertex in self.models.values() if vertex in there), here)
        self.models[here], images = model, {}
        for each, vertex in zip(alike, there, strict=True):
            if vertex == model:
                targets = [self.targets.index(each[target]) for target in self.targets]
                image, possible = np.empty(self.sizes[here], np.int64), self.column[here] >= 0
                image[self.column[here][possible]] = self.column[model][targets][possible]
                images[image.tobytes()] = image
        return list(images.values())

    def _columns(self, longest: int) -> Int[np.ndarray, "vertices targets times"]:
        """Return the index of the promise for each target and time, -1 if the time is too short.

        A time at which no first arrival is possible has the same promise as the time before.
        """
        vertices, targets = len(self.delays), len(self.targets)
        there = np.arange(vertices)[:, None] == self.targets
        arrives = np.zeros((longest + 1, vertices, targets), bool)
        # After a move, a robot is at the target, or first arrives there after the time left.
        later = [there]
        for time in range(1, longest + 1):
            for taken in range(1, time + 1):
                arrives[time] |= (self.delays == taken) @ later[time - taken]
            later.append(arrives[time] & ~there)
        order = arrives.transpose(1, 2, 0).reshape(vertices, -1)
        numbers = np.where(order, order.cumsum(axis=1) - 1, -1)
        return np.maximum.accumulate(numbers.reshape(vertices, targets, -1), axis=2)

    def bound(self, least: float, most: float, rounds: int, cuts: int) -> float:
        """Lower `most`, an upper bound on the probability of capture, by bisection, and return it.

        Each of the `rounds` tests a probability between `least` and `most` with up to `cuts` cuts.
        """
        random = np.random.default_rng(0)
        kept: Cuts = {}
        for _ in range(rounds):
            tested = (least + most) / 2
            search = _Search(self, tested, kept)
            value = search.run(cuts, random)
            most = min(most, max(tested, value))
            if value > tested:
                # Cuts for a lower probability hold for a higher one.
                least, kept = tested, search.cuts
            else:
                kept = {}
        return most


class _Search:
    """The search for cuts, for one probability of capture that the robot must always keep."""

    def __init__(self, pursuit: Pursuit, least: float, cuts: Cuts) -> None:
        models = sorted(set(pursuit.models.values()))
        self.pursuit, self.cuts = pursuit, {here: list(cuts.get(here, ())) for here in models}
        self.programs = {here: _Program(pursuit, here, least) for here in models}

    def run(self, count: int, random: np.random.Generator) -> float:
        """Add at most `count` cuts, and return an upper bound on capture."""
        made, turn, last, models = 0, 0, 0, list(self.programs)
        while made < count and turn - last <= _ROUNDS * len(models):
            here = models[turn % len(models)]
            turn += 1
            value, plan = self.programs[here].most(self.cuts)
            if value < self.programs[here].least:
                return value
            if plan is None:
                continue
            for _ in range(_DEPTH):
                shares = np.array([max(0.0, plan[at]) for at in self.programs[here].shares])
                move = random.choice(shares.size, p=shares / shares.sum())
                at, there = self.programs[here].shares[move], self.pursuit.beside[here][move]
                here, image = self.pursuit.models[there], self.pursuit.images[there][0]
                wanted = np.empty(image.size)
                wanted[image] = plan[at + 1 : at + 1 + image.size] / plan[at]
                distance, cut, plan = self.programs[here].separate(wanted, self.cuts)
                if distance == np.inf:
                    return 0.0
                if plan is None:
                    break
                if distance > _OUTSIDE:
                    self.cuts[here].append(cut)
                    made, last = made + 1, turn
                    if random.random() > _ON:
                        break
        return float(min(program.most(self.cuts)[0] for program in self.programs.values()))


class _Program:
    """The linear program that tests whether the next move can keep the promises at a vertex.

    Its variables (columns), from 0 to 1, are the promises; for each neighbour, the probability of
    the move, and its products with the promises there; a slack; and the *relief*, the amount by
    which promises may fall short. The relief is 0 except in the proof that no promises can be kept.
    """

    def __init__(self, pursuit: Pursuit, here: int, least: float) -> None:
        import highspy

        self.least, self.beside, column = least, pursuit.beside[here], pursuit.column
        self.models, self.images = pursuit.models, pursuit.images
        self.size = int(pursuit.sizes[here])
        widths = [1 + int(pursuit.sizes[there]) for there in self.beside]
        starts = self.size + np.concatenate([[0], np.cumsum(widths)])
        self.shares, self.slack = starts[:-1].tolist(), int(starts[-1])
        self.used = [0] * len(self.beside)
        with no_output():
            self.solver = highspy.Highs()
        for name, value in (("output_flag", False), ("threads", 1)):
            self.solver.setOptionValue(name, value)
        self.columns = self.slack + 2
        for limit in [1.0] * (self.slack + 1) + [0.0]:
            self.solver.addVar(0.0, limit)
        self.rows: list[Float[np.ndarray, columns]] = []
        self._row(dict.fromkeys(self.shares, 1.0), 1.0, 1.0)
        ends = pursuit.attack[pursuit.targets]
        for k, goal in enumerate(pursuit.targets):
            times = column[here, k]
            for number in np.unique(times[times >= 0]).tolist():
                time, row = int(np.argmax(times == number)), {number: 1.0}
                for at, there in zip(self.shares, self.beside, strict=True):
                    left = time - int(pursuit.delays[here, there])
                    if there == goal and left >= 0:
                        row[at] = -1.0
                    elif left > 0 and column[there, k, left] >= 0:
                        row[at + 1 + int(column[there, k, left])] = -1.0
                self._row(row)
            for at, there in zip(self.shares, self.beside, strict=True):
                numbers = np.unique(column[there, k][column[there, k] >= 0]).tolist()
                for sooner, later in itertools.pairwise(numbers):
                    self._row({at + 1 + sooner: 1.0, at + 1 + later: -1.0})
                whole = int(column[there, k, ends[k]])
                keep = {at: least, self.slack + 1: -1.0}
                if whole >= 0:
                    self._row({at + 1 + numbers[-1]: 1.0, at: -1.0})
                    keep[at + 1 + whole] = -1.0
                self._row(keep)
        self.wanted = [self._row({number: -1.0, self.slack: -1.0}) for number in range(self.size)]
        full = [int(column[here, k, ends[k]]) for k in range(len(ends))]
        self.full = [self._row({number: -1.0, self.slack: 1.0}) for number in full if number >= 0]
        self.lost = any(number < 0 for number in full)

    def _row(self, entries: dict[int, float], low: float = -np.inf, high: float = 0.0) -> int:
        places, numbers = np.array(list(entries), np.int32), np.array(list(entries.values()))
        self.solver.addRow(low, high, places.size, places, numbers)
        dense = np.zeros(self.columns)
        dense[places] = numbers
        self.rows.append(dense)
        return len(self.rows) - 1

    def _solve(self, cuts: Cuts, cost: float, rows: Iterable[tuple[int, float]]) -> tuple[Any, Any]:
        """Solve the program with new `cuts`, the `cost` of the slack, and upper limits of `rows`.

        Returns the values of the columns and the prices of the rows, or `None` for both if the
        solver finds no solution.
        """
        for k, there in enumerate(self.beside):
            known, at = cuts[self.models[there]], self.shares[k]
            for (normal, offset), image in itertools.product(
                known[self.used[k] :], self.images[there]
            ):
                here = normal[image]
                places = np.flatnonzero(here).tolist()
                self._row({at + 1 + i: float(here[i]) for i in places} | {at: -offset})
            self.used[k] = len(known)
        for row in (*self.wanted, *self.full):
            self.solver.changeRowBounds(row, -np.inf, np.inf)
        for row, high in rows:
            self.solver.changeRowBounds(row, -np.inf, float(high))
        self.solver.changeColCost(self.slack, cost)
        return self._run()

    def _run(self) -> tuple[Any, Any]:
        from highspy import HighsModelStatus

        self.solver.run()
        if self.solver.getModelStatus() != HighsModelStatus.kOptimal:
            return None, None
        found = self.solver.getSolution()
        return np.array(found.col_value), -np.array(found.row_dual)

    def _ceiling(
        self, gain: Float[np.ndarray, "columns"], prices: Float[np.ndarray, "rows"]
    ) -> float:
        """Compute an upper bound on `gain @ columns` over all columns that satisfy the rows.

        The bound holds however inexact the solver is: by weak duality, any prices of the rows give
        a bound, because columns are from 0 to 1. The relief counts as 0 unless `gain` contains it.
        """
        prices = np.append(prices[0], np.maximum(0.0, prices[1:]))
        left = gain - prices @ np.array(self.rows)
        limits = np.ones(left.size)
        limits[-1] = gain[-1] < 0
        return float(prices[0] + np.maximum(0.0, left) @ limits)

    def impossible(self) -> bool:
        """Try to prove, after a failed solve, that the program of this vertex has no solution.

        Without a solution, the robot cannot keep the least probability of capture at any neighbour.
        The proof is a positive lower bound on the relief that a solution needs.
        """
        for row in (*self.wanted, *self.full):
            self.solver.changeRowBounds(row, -np.inf, np.inf)
        relief = self.slack + 1
        self.solver.changeColCost(self.slack, 0.0)
        self.solver.changeColCost(relief, 1.0)
        self.solver.changeColBounds(relief, 0.0, 1.0)
        _, prices = self._run()
        self.solver.changeColCost(relief, 0.0)
        self.solver.changeColBounds(relief, 0.0, 0.0)
        if prices is None:
            return False
        gain = np.zeros(self.columns)
        gain[relief] = -1.0
        prices[[*self.wanted, *self.full]] = 0.0
        return self._ceiling(gain, prices) < -_OUTSIDE

    def most(self, cuts: Cuts) -> tuple[float, Any]:
        """Return an upper bound on the probability of capture from here, and the solution."""
        if self.lost:
            return 0.0, None
        plan, prices = self._solve(cuts, -1.0, [(row, 0.0) for row in self.full])
        if plan is None:
            return 0.0 if self.impossible() else 1.0, None
        gain = np.zeros(self.columns)
        gain[self.slack] = 1.0
        return self._ceiling(gain, prices), plan

    def separate(
        self, wanted: Float[np.ndarray, "promises"], cuts: Cuts
    ) -> tuple[float, tuple[Any, float], Any]:
        """Return the distance of promises from those that can be kept, a cut, and the solution."""
        plan, prices = self._solve(cuts, 1.0, zip(self.wanted, -wanted, strict=True))
        if plan is None:
            return np.inf if self.impossible() else 0.0, (None, 0.0), None
        normal = np.maximum(0.0, prices[self.wanted])
        prices[self.wanted] = 0.0
        gain = np.append(normal, np.zeros(self.columns - self.size))
        offset = self._ceiling(gain, prices)
        return float(normal @ wanted - offset), (normal, offset), plan
