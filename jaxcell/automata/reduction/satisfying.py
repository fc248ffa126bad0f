from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Int, Integer


Classes: TypeAlias = Bool[np.ndarray, "classes states"]
"""For each class, the mask of its states."""

# Number of conflicts of the solver after which a part of the search ends.
_CONFLICTS = 2000
# A literal that is false.
_FALSE = 1


def closed_classes(
    transition: Integer[np.ndarray, "states symbols"],
    apart: Bool[np.ndarray, "states states"],
    clique: Int[np.ndarray, "clique"],
    count: int,
) -> Iterator[Classes | bool | None]:
    """Find `count` classes that form a closed cover of the states, with a SAT solver.

    Each state is in a class, no class contains two incompatible states, and the cover is *closed*:
    after each symbol, the successors of a class are in one class. Without loss of generality state
    `i` of the clique is in class `i`, because no two states of a clique can be in one class.
    Clauses about pairs of states and about successors are added only when a solution violates them
    (Zhang and Shell 2020).

    **Arguments:**

    - `transition`: the state after each symbol, -1 for an impossible symbol.
    - `apart`: the mask of the pairs of incompatible states.
    - `clique`: states that are incompatible with each other.

    **Yields:** `None` after each part of the search, and at the end the classes, or `False` if
    there are provably no such classes.
    """
    from pysat.solvers import Solver

    problem = _Problem(transition, apart, clique, count)
    with Solver("glucose4", bootstrap_with=problem.base()) as solver:
        while True:
            solver.conf_budget(_CONFLICTS)
            answer = solver.solve_limited()
            if answer is False:
                yield False
            elif answer:
                classes = problem.classes(solver.get_model())
                violated = problem.pairs(classes)
                solver.append_formula(violated)
                for clauses in problem.closing(classes):
                    yield None
                    solver.append_formula(clauses)
                    violated = clauses
                if not violated:
                    yield classes
            yield None


class _Problem:
    """The SAT problem of closed classes. Each variable says whether one state is in one class."""

    def __init__(
        self,
        transition: Integer[np.ndarray, "states symbols"],
        apart: Bool[np.ndarray, "states states"],
        clique: Int[np.ndarray, "clique"],
        count: int,
    ) -> None:
        self.transition, self.apart, self.clique, self.count = transition, apart, clique, count
        candidate = np.ones((count, len(transition)), bool)
        candidate[: clique.size] = ~apart[clique]
        variables = _FALSE + np.cumsum(candidate).reshape(candidate.shape)
        self.member = np.where(candidate, variables, _FALSE)
        self.last = int(variables[-1, -1])
        self.closed: set[tuple[int, int]] = set()

    def base(self) -> list[list[int]]:
        of_clique = self.member[np.arange(self.clique.size), self.clique][:, None].tolist()
        of_states = [column[column != _FALSE].tolist() for column in self.member.T]
        return [[-_FALSE], *of_clique, *of_states]

    def classes(self, model: list[int]) -> Classes:
        # Variables that are in no clause are not in the model.
        true = np.zeros(self.last + 1, bool)
        true[1 : len(model) + 1] = np.array(model) > 0
        return true[self.member]

    def pairs(self, classes: Classes) -> list[list[int]]:
        """Return clauses that forbid the pairs of incompatible states that occur in `classes`."""
        pairs: set[tuple[int, int]] = set()
        for row in classes:
            states = np.flatnonzero(row)
            first, second = np.nonzero(np.triu(self.apart[np.ix_(states, states)]))
            pairs.update(zip(states[first].tolist(), states[second].tolist(), strict=True))
        if not pairs:
            return []
        both = self.member[:, np.array(sorted(pairs))].reshape(-1, 2)
        return (-both[(both != _FALSE).all(axis=1)]).tolist()

    def closing(self, classes: Classes) -> Iterator[list[list[int]]]:
        """Yield clauses that unite successors of a class after a symbol if no class has them."""
        for index, row in enumerate(classes):
            for symbol, after in enumerate(self.transition.T):
                targets = after[row & (after >= 0)]
                if (index, symbol) in self.closed or classes[:, targets].all(axis=1).any():
                    continue
                # The classes beyond the clique are interchangeable.
                free = index >= self.clique.size
                for each in range(self.clique.size, self.count) if free else [index]:
                    yield self._close(each, symbol)

    def _close(self, index: int, symbol: int) -> list[list[int]]:
        self.closed.add((index, symbol))
        after = self.transition[:, symbol]
        states = np.flatnonzero((self.member[index] != _FALSE) & (after >= 0))
        targets = np.arange(self.count)
        if index < self.clique.size and after[self.clique[index]] >= 0:
            targets = np.flatnonzero(self.member[:, after[self.clique[index]]] != _FALSE)
        chosen = self.last + 1 + np.arange(targets.size)
        self.last += targets.size
        then = self.member[np.ix_(targets, after[states])]
        clauses = np.broadcast_arrays(-self.member[index, states], -chosen[:, None], then)
        return [chosen.tolist(), *np.stack(clauses, axis=-1).reshape(-1, 3).tolist()]
