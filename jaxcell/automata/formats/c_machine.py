import string
from collections.abc import Callable

import numpy as np
from jaxtyping import Int

from ..filter import Filter
from ..machine import MooreMachine, Output
from ..policy import Policy
from ..reduction.smallest import Smallest, smallest
from .c_header import IN_FLASH, OBSERVATION_NEXT, TRANSITIONS, USE, bits_for, fill, look_up, table
from .c_policy import RUN_NEXT, RUN_STATE, RUN_TABLES


_STATE = """\

typedef uint${at_bits}_t ${name}_state;

#define ${NAME}_STATES $states$suffix
#define ${NAME}_START 0
#define ${NAME}_IMPOSSIBLE $states$suffix
"""

_HEADER = (
    "/* The smallest machine with the outputs of a filter or a policy, made by jaxcell: $states "
    "states.\n"
    + USE
    + """\
 *
 * It has an output after each $symbol. Observations that cannot occur in the map may lead to any
 * state: few of them are noticed.
 *
"""
    + IN_FLASH
)

_FUNCTIONS = (
    "/* The output of the state. */\n"
    + look_up("color", "colors", "0")
    + """\
/* 1 after an observation that is noticed to be impossible, else 0. */
static inline int ${name}_refuted(${name}_state state) {
    return $at >= ${NAME}_STATES;
}

/* 1 if the output ends the run, else 0. */
static inline int ${name}_localized(${name}_state state) {
    return !${name}_refuted(state) && ${name}_color(state) >= $final;
}

#endif
"""
)


def machine_to_c_header(machine: MooreMachine, *, name: str = "filter") -> str:
    """Write a machine as a C99 header for a microcontroller, as [`to_c_header`][] writes a filter.

    The C function always takes observations, 0 for a step and 1 for a bump. For a machine that
    reads runs of steps, it counts the steps since a bump, and the output changes only at bumps.

    **Arguments:** a machine, and the prefix of every name. **Returns:** the text.

    The smallest filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> machine = automata.smallest(examples.ring()).machine
        >>> text = automata.machine_to_c_header(machine)
        >>> [line for line in text.splitlines() if "STATES" in line][0]
        '#define FILTER_STATES 3u'
    """
    tables, states = _tables(machine), len(machine.transition)
    if machine.runs:
        parts = [RUN_STATE, "\n", RUN_TABLES, table("color", "colors"), RUN_NEXT]
    else:
        parts = [_STATE, "\n", TRANSITIONS, table("color", "colors"), OBSERVATION_NEXT]
    return fill(
        string.Template("".join([_HEADER, *parts, _FUNCTIONS])),
        name,
        states,
        tables,
        table_bits(machine) | {"at": bits_for(states), "state": bits_for(states)},
        bounds=states + 1,
        bumps=tables["steps"].size if machine.runs else 0,
        symbol="bump" if machine.runs else "observation",
        at="state.at" if machine.runs else "state",
        final=machine.final,
    )


def fewest_bytes(
    source: Filter | Policy,
    output: Output | None = None,
    *,
    seconds: float | int = 60.0,
    say: Callable[[str], None] = lambda text: None,
) -> Smallest:
    """Find the machine with the smallest tables in C, which may read observations or runs of steps.

    **Arguments:** `source` and `output` as in [`MooreMachine.of`][], and `seconds` and `say` as in
    [`smallest`][]. A closed-world filter takes two such searches, for observations and for runs.

    **Returns:** the search that found the smaller tables; for equal sizes, the search for a machine
    that reads observations.

    For three cells in a ring, the machine that reads runs takes more bytes:

        >>> from jaxcell import automata, examples
        >>> machine = automata.fewest_bytes(examples.ring()).machine
        >>> machine.runs, automata.machine_bytes(machine)
        (False, 9)
    """
    kinds = [False] if isinstance(source, Policy) or source.open_world else [False, True]
    machines = [MooreMachine.of(source, output, runs=runs) for runs in kinds]
    searches = [smallest(machine, seconds=seconds, say=say) for machine in machines]
    return min(searches, key=lambda search: machine_bytes(search.machine))


def table_bits(machine: MooreMachine) -> dict[str, int]:
    """Return the number of bits per entry of each table of [`machine_to_c_header`][]."""
    return {
        table: bits_for(max(int(values.max(initial=0)), table in _STATES and len(machine.color)))
        for table, values in _tables(machine).items()
    }


def machine_bytes(machine: MooreMachine) -> int:
    """Compute the total number of bytes of the tables of [`machine_to_c_header`][].

    **Arguments:** a machine. **Returns:** the number of bytes.

    The smallest filter of a ring has three states of three bytes:

        >>> from jaxcell import automata, examples
        >>> automata.machine_bytes(automata.smallest(examples.ring()).machine)
        9
    """
    bits = table_bits(machine)
    return sum(values.size * bits[name] // 8 for name, values in _tables(machine).items())


# Tables whose entries are states, or IMPOSSIBLE, the number after the last state.
_STATES = ("transition", "target")


def _tables(machine: MooreMachine) -> dict[str, Int[np.ndarray, "..."]]:
    transition = machine.transition
    if not machine.runs:
        after = np.where(transition < 0, len(transition), transition)
        return {"transition": after, "color": machine.color}
    state, steps = np.nonzero(transition >= 0)
    return {
        "first": np.searchsorted(state, np.arange(len(transition) + 1)),
        "steps": steps,
        "target": transition[state, steps],
        "color": machine.color,
    }
