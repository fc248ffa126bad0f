import dataclasses
from collections.abc import Iterable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Int32

from ..base.shown import Shown
from .filter import Filter
from .policy import Policy


Output: TypeAlias = Literal["color", "count", "cells", "localized", "action"]
"""The output of a filter or a policy that a smaller machine must keep; see `MooreMachine.of`."""


@dataclasses.dataclass(frozen=True, eq=False)
class MooreMachine(Shown):
    """A Moore machine: the states, transitions and outputs of a filter or a policy.

    State 0 is the start. The output of a state is its colour. A machine reads either
    *observations*, 0 for a step and 1 for a bump, or *runs*, the number of steps before each bump.

    The filter of three cells in a ring has two colours. If it reads runs, it has two states,
    because the first run has 0 to 2 steps, and all later runs have 2:

        >>> from jaxcell import automata, examples
        >>> automata.MooreMachine.of(examples.ring()).color.tolist()
        [1, 1, 2, 2, 2]
        >>> automata.MooreMachine.of(examples.ring(), runs=True).transition.tolist()
        [[1, 1, 1], [-1, -1, 1]]
    """

    transition: Int32[np.ndarray, "states symbols"]
    "The state after each symbol, or -1 if that symbol cannot occur."
    color: Int32[np.ndarray, "states"]
    "The output of each state."
    runs: bool = False
    "`True` if symbol `s` is a run of `s` steps and a bump, `False` if symbols are observations."
    final: int = 2
    "The smallest output of a robot that is localized, or of a plan that has ended."

    def __post_init__(self) -> None:
        states = len(self.transition)
        if not states or self.color.size != states:
            raise ValueError(f"color: expected one per state, got {self.color.size} for {states}")
        if self.transition.min(initial=0) < -1 or self.transition.max(initial=0) >= states:
            raise ValueError(f"transition: expected states from 0 to {states - 1}, or -1 for none")
        reached, new = np.zeros(states, bool), np.array([0])
        while new.size:
            reached[new] = True
            after = np.unique(self.transition[new])
            new = after[(after >= 0) & ~reached[after]]
        if not reached.all():
            raise ValueError(f"transition: no string reaches state {np.argmin(reached)}")

    @staticmethod
    def of(
        source: Filter | Policy, output: Output | None = None, *, runs: bool = False
    ) -> "MooreMachine":
        """Build the machine of a filter or a policy.

        **Arguments:**

        - `source`: a filter or a policy.
        - `output`: the output to keep. For a filter: `"color"` (the default), the colour;
            `"count"`, the number of possible configurations; `"cells"`, the possible configurations
            in knowledge cycles, and 1 elsewhere; `"localized"`, 2 in knowledge cycles, and 1
            elsewhere. For a policy: `"cells"` (the default), the angle of the next turn, or the
            possible configurations at an end; `"action"`, the angle, or one number for all ends.
        - `runs`: whether the machine of a filter reads runs; it then has outputs only at bumps. The
            machine of a policy always reads runs.

        **Returns:** [`MooreMachine`][]. With `"cells"`, each set of configurations has a number as
        its output. The outputs of a policy with `n` angles are the indices of angles, `n` at the
        start, and `n + 1` or more at an end.

        **Raises:** `ValueError` if `runs` is true and the filter is open-world or has a
        state from which the robot may never bump again.
        """
        choices: tuple[str, ...] = ("color", "count", "cells", "localized")
        if isinstance(source, Policy):
            choices = ("cells", "action")
        if output is not None and output not in choices:
            kind = "policy" if isinstance(source, Policy) else "filter"
            raise ValueError(
                f"output is {output!r}; expected {', '.join(choices[:-1])} or {choices[-1]} for a "
                f"{kind}"
            )
        if isinstance(source, Policy):
            return _of_policy(source, output or "cells")
        color = _colors(source, output or "color")
        final = int(color.max()) + 1 if output == "count" else 2
        machine = MooreMachine(source.transition, color, final=final)
        return _in_runs(machine, source.trap) if runs else machine

    @staticmethod
    def of_plan(actions: Sequence[float]) -> "MooreMachine":
        """Build the machine of a plan. An action is 0 for a step, or the angle to turn at a bump.

        The machine reads observations. It has a state for the start, and a state after each action.
        With `n` different angles, in ascending order, its output is `i` to turn by angle `i`, `n`
        to continue, `n + 1` at the end, and `n + 2 + i` at an end with a turn by angle `i`.

            >>> from jaxcell import automata
            >>> automata.MooreMachine.of_plan([0, 1.5, 0, 0]).color.tolist()
            [1, 1, 0, 1, 2]
        """
        angles = sorted({action for action in actions if action})
        number = {0.0: len(angles), **{angle: i for i, angle in enumerate(angles)}}
        color = np.array([number[action] for action in (0.0, *actions)], np.int32)
        color[-1] = len(angles) + 1 + (color[-1] + 1) % (len(angles) + 1)
        transition = np.full((color.size, 2), -1, np.int32)
        step = np.arange(len(actions))
        transition[step, [int(action != 0) for action in actions]] = step + 1
        return MooreMachine(transition, color, final=len(angles) + 1)

    def run(self, symbols: Iterable[int]) -> Int32[np.ndarray, "entries"]:
        """Run the machine on symbols, and return the outputs at the start and after each symbol."""
        state, colors = 0, [self.color.item(0)]
        for index, symbol in enumerate(symbols):
            known = 0 <= symbol < self.transition.shape[1]
            state = self.transition.item(state, symbol) if known else -1
            if state < 0:
                raise ValueError(f"symbol {index} is {symbol}, which cannot occur here")
            colors.append(self.color.item(state))
        return np.array(colors, np.int32)


def _colors(filter: Filter, output: str) -> Int32[np.ndarray, "states"]:
    color = filter.color
    if output == "count":
        return filter.uncertainty
    trap = int(color.max()) + 1
    if output == "localized":
        number = np.where(color > 1, np.int32(2), np.int32(1))
        trap = 3
    elif output == "cells":
        sets: dict[bytes, int] = {}
        number = np.ones_like(color)
        for state in np.flatnonzero(color > 1).tolist():
            number[state] = sets.setdefault(filter.cells(state).tobytes(), len(sets) + 2)
    else:
        return color
    if filter.open_world:
        number[-1] = trap
    return number


def _of_policy(policy: Policy, output: str) -> MooreMachine:
    angles = int(policy.turn.max()) + 1
    color = np.where(policy.turn < 0, np.int32(angles), policy.turn)
    sets: dict[bytes, int] = {}
    for end in policy.ends.tolist():
        cells = policy.cells(end).tobytes() if output == "cells" else b""
        color[end] = angles + 1 + sets.setdefault(cells, len(sets))
    states = policy.turn.size
    transition = np.full((states, int(policy.steps.max(initial=-1)) + 1), -1, np.int32)
    transition[np.repeat(np.arange(states), np.diff(policy.first)), policy.steps] = policy.target
    return MooreMachine(transition, color, runs=True, final=angles + 1)


def _in_runs(machine: MooreMachine, trap: int | None) -> MooreMachine:
    if trap is not None:
        raise ValueError("runs: expected a closed-world filter; a trap is entered between bumps")
    zero, one = machine.transition.T.tolist()
    number, queue, rows = {0: 0}, [0], []
    for state in queue:
        row: list[int] = []
        here = state
        while here >= 0:
            if len(row) == len(zero):
                raise ValueError(f"runs: from state {state} on the robot may never bump again")
            after = one[here]
            if after >= 0 and number.setdefault(after, len(number)) == len(queue):
                queue.append(after)
            row.append(number.get(after, -1))
            here = zero[here]
        rows.append(row)
    transition = np.full((len(rows), max(map(len, rows))), -1, np.int32)
    for state, row in enumerate(rows):
        transition[state, : len(row)] = row
    return MooreMachine(transition, machine.color[queue], runs=True, final=machine.final)
