import dataclasses
import functools
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Int32

from ...base.optional_modules import import_module
from ...base.shown import Shown
from ..filter import Filter
from ..machine import MooreMachine
from ..minimization import moore_classes
from ..policy import Policy
from .compatible import incompatible_pairs, large_clique
from .folding import folded
from .satisfying import Classes, closed_classes


# The number of clauses is proportional to the number of states, times the square of the number of
# classes beyond the clique. A search above the bound has at most this product.
_LARGEST = 1_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class Smallest(Shown):
    """A small machine with the same outputs, and a proved lower bound on the number of states.

    Every string of symbols that can occur in the original machine can occur in the small machine,
    with the same outputs.
    """

    machine: MooreMachine
    "The smallest machine that was found."
    bound: int
    "The proved lower bound on the number of states of every such machine."
    moore: int
    "The number of states after merging equivalent states only, as [`minimize`][] does."
    seconds: float
    "The duration of the search in seconds."

    @property
    def states(self) -> int:
        """The number of states."""
        return len(self.machine.transition)

    @property
    def gap(self) -> int:
        """The difference between the number of states and the bound."""
        return self.states - self.bound

    @property
    def proved(self) -> bool:
        """`True` if it is proved that no machine with the same outputs has fewer states."""
        return self.gap == 0

    @property
    def claim(self) -> str:
        """The proved bound, in words."""
        return "proved least" if self.proved else f"the least has at least {self.bound}, by proof"


def smallest(
    source: MooreMachine | Filter | Policy,
    *,
    seconds: float | int = 60.0,
    say: Callable[[str], None] = lambda text: None,
) -> Smallest:
    """Find the smallest machine that gives the same outputs on every string that can occur.

    States can be merged if no string that is possible from all of them gives different outputs, and
    if their successors are merged too. This relation is not transitive, so a state may be merged
    into several states: the smallest machine is a *cover* of the states by classes, and may be
    smaller than every *partition*. Finding it is NP-hard (O'Kane and Shell 2017; Zhang and Shell
    2020). The size of a clique of incompatible states is a lower bound, the number of classes of a
    greedy partition is an upper bound, and a SAT solver searches between them.

    **Arguments:**

    - `source`: a machine, or a filter or a policy with its default output.
    - `seconds`: the time after which the search ends and the best machine is returned. All pairs of
        states are compared even if that takes longer.
    - `say`: a function that is called with a description of each part of the work.

    **Returns:** [`Smallest`][].

    **Raises:** `ModuleNotFoundError` without python-sat, if the greedy bounds differ; `MemoryError`
    if the pairs of states do not fit into memory.

    The filter of three cells in a ring has five states:

        >>> from jaxcell import automata, examples
        >>> small = automata.smallest(examples.ring())
        >>> small.states, small.bound, small.machine.transition.tolist()
        (3, 3, [[1, 2], [2, 2], [2, 2]])
    """
    machine = source if isinstance(source, MooreMachine) else MooreMachine.of(source)
    began = time.monotonic()

    def go_on() -> bool:
        return time.monotonic() - began < seconds

    label, first = moore_classes(machine.transition, machine.color)
    after = machine.transition[first]
    transition = np.where(after < 0, np.int32(-1), label[after])
    say(f"comparing the pairs of {first.size:,} states")
    apart = incompatible_pairs(transition, machine.color[first])
    clique = large_clique(apart)
    say(f"merging {first.size:,} states")
    heads = folded(transition, apart, go_on)
    classes = np.unique(heads)[:, None] == heads
    bound = clique.size
    if bound < len(classes) and go_on():
        import_module("pysat.solvers")
    search = functools.partial(closed_classes, transition, apart, clique)
    most = clique.size + math.isqrt(_LARGEST // len(transition))
    tried: dict[int, Iterator[Classes | bool | None]] = {}
    while bound < len(classes) and go_on():
        say(f"{len(classes):,} states are enough, at least {bound:,} are needed")
        # The search at the bound raises it, and the one in the middle lowers the other bound.
        wanted = {bound, max(bound, min(most, (bound + len(classes)) // 2))}
        tried = {count: tried.get(count) or search(count) for count in sorted(wanted)}
        for count, attempt in tried.items():
            answer = next(attempt)
            if answer is False:
                bound = count + 1
            elif isinstance(answer, np.ndarray):
                classes = answer[_successors(transition, answer)[1]]
                break
    classes = classes[:, label]
    after, order = _successors(machine.transition, classes)
    color = machine.color[np.argmax(classes[order], axis=1)]
    small = dataclasses.replace(machine, transition=after, color=color)
    return Smallest(small, bound, first.size, time.monotonic() - began)


def _successors(
    transition: Int32[np.ndarray, "states symbols"], classes: Classes
) -> tuple[Int32[np.ndarray, "reached symbols"], list[int]]:
    """Find the classes that can be reached from the start, in breadth-first order.

    Returns the transitions between these classes, numbered in this order, and the classes.
    """
    start = int(np.argmax(classes[:, 0]))
    number, queue, rows = {start: 0}, [start], []
    for index in queue:
        row = []
        for after in transition.T:
            targets = after[classes[index] & (after >= 0)]
            if not targets.size:
                row.append(-1)
                continue
            target = int(np.argmax(classes[:, targets].all(axis=1)))
            if number.setdefault(target, len(number)) == len(queue):
                queue.append(target)
            row.append(number[target])
        rows.append(row)
    return np.array(rows, np.int32), queue
