import string
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Int

from ..filter import Filter
from ..machine import MooreMachine, Output
from ..policy import Policy
from ..reduction.smallest import Smallest, smallest
from .c_header import IN_FLASH, OBSERVATION_NEXT, bits_for, identifier, rows_of
from .c_policy import RUN_NEXT, RUN_STATE, RUN_TABLES


_STATE = """\

typedef uint${at_bits}_t ${name}_state;

#define ${NAME}_STATES $states$suffix
#define ${NAME}_START 0
#define ${NAME}_IMPOSSIBLE $states$suffix
"""

_TABLES = """\
static const uint${at_bits}_t ${name}_transition[$states][2] ${NAME}_TABLE = {
$transition
};

"""

_HEADER = """\
/* The smallest machine with the outputs of a filter or a policy, made by jaxcell: $states states.
 *
 *     ${name}_state state = ${NAME}_START;
 *     state = ${name}_next(state, observation);    after each observation, 0 or 1
 *
 * It has an output after each $symbol. Observations that cannot occur in the map may lead to any
 * state: few of them are noticed.
 *
"""

_OUTPUTS = """\
static const uint${color_bits}_t ${name}_colors[$states] ${NAME}_TABLE = {
$color
};

"""

_FUNCTIONS = """\
/* The output of the state. */
static inline uint${color_bits}_t ${name}_color(${name}_state state) {
    if ($at >= ${NAME}_STATES) return 0;
    return ${NAME}_READ($color_bits, ${name}_colors[$at]);
}

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


def machine_to_c_header(machine: MooreMachine, *, name: str = "filter") -> str:
    """Write a machine as a C99 header for a microcontroller: tables, and functions for them.

    A machine that reads runs counts the steps since the last bump, so that the program passes
    observations, 0 for a step and 1 for a bump, to each kind of machine. Its output then stays the
    same from bump to bump.

    **Arguments:**

    - `machine`: for example the result of [`smallest`][].
    - `name`: the prefix of every name in the header; characters that C does not allow become
        underscores.

    **Returns:** the text of a `.h` file; a comment at its top shows its use.

    The smallest filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> machine = automata.smallest(examples.ring()).machine
        >>> text = automata.machine_to_c_header(machine)
        >>> [line for line in text.splitlines() if "STATES" in line][0]
        '#define FILTER_STATES 3u'
    """
    name = identifier(name)
    tables, bits = _tables(machine), table_bits(machine)
    states = len(machine.transition)
    text = string.Template(
        "".join(
            [
                _HEADER,
                IN_FLASH,
                RUN_STATE if machine.runs else _STATE,
                "\n",
                RUN_TABLES if machine.runs else _TABLES,
                _OUTPUTS,
                RUN_NEXT if machine.runs else OBSERVATION_NEXT,
                _FUNCTIONS,
            ]
        )
    )
    rows: dict[str, Iterable[str]] = {
        table: map(str, values.tolist()) for table, values in tables.items()
    }
    if not machine.runs:
        rows["transition"] = (f"{{{a}, {b}}}" for a, b in tables["transition"].tolist())
    return text.substitute(
        name=name,
        NAME=name.upper(),
        states=states,
        bounds=states + 1,
        bumps=tables["steps"].size if machine.runs else 0,
        suffix="u" if states < 2**16 else "ul",
        symbol="bump" if machine.runs else "observation",
        at="state.at" if machine.runs else "state",
        at_bits=bits_for(states),
        state_bits=bits_for(states),
        final=machine.final,
        **{f"{table}_bits": width for table, width in bits.items()},
        **{table: rows_of(entries) for table, entries in rows.items()},
    )


def fewest_bytes(
    source: Filter | Policy,
    output: Output | None = None,
    *,
    seconds: float | int = 60.0,
    say: Callable[[str], None] = lambda text: None,
) -> Smallest:
    """Find the smallest machine in observations and that in runs, and take the smaller tables.

    **Arguments:**

    - `source`, `output`: as in [`MooreMachine.of`][].
    - `seconds`, `say`: as in [`smallest`][], for each of the two machines.

    **Returns:** the machine whose tables take fewer bytes; observations are preferred.

    For three cells in a ring one state per run takes more bytes than one per observation:

        >>> from jaxcell import automata, examples
        >>> machine = automata.fewest_bytes(examples.ring()).machine
        >>> machine.runs, automata.machine_bytes(machine)
        (False, 9)
    """
    kinds = [False] if isinstance(source, Policy) or source.open_world else [False, True]
    machines = [MooreMachine.of(source, output, runs=runs) for runs in kinds]
    found = [smallest(machine, seconds=seconds, say=say) for machine in machines]
    return min(found, key=lambda each: machine_bytes(each.machine))


def table_bits(machine: MooreMachine) -> dict[str, int]:
    """Return the width of the entries of each table of [`machine_to_c_header`][]."""
    return {
        table: bits_for(max(int(values.max(initial=0)), table in _STATES and len(machine.color)))
        for table, values in _tables(machine).items()
    }


def machine_bytes(machine: MooreMachine) -> int:
    """Count the bytes of the tables of [`machine_to_c_header`][].

    **Arguments:**

    - `machine`: any machine.

    **Returns:** the bytes of all tables together.

    The smallest filter of a ring has three states of three bytes:

        >>> from jaxcell import automata, examples
        >>> automata.machine_bytes(automata.smallest(examples.ring()).machine)
        9
    """
    bits = table_bits(machine)
    return sum(values.size * bits[name] // 8 for name, values in _tables(machine).items())


# Tables of states, or of the number after the last one, which stands for IMPOSSIBLE.
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
