import string

import numpy as np

from ..policy import Policy
from .c_header import (
    IN_FLASH,
    KNOWLEDGE,
    LOCALIZED,
    USE,
    bits_for,
    fill,
    identifier,
    look_up,
    table,
)


RUN_STATE = """\

/* The knowledge at the last bump, and the steps since then. */
typedef struct {
    uint${at_bits}_t at;
    uint${steps_bits}_t steps;
} ${name}_state;

#define ${NAME}_STATES $states$suffix
#define ${NAME}_START {0, 0}
/* After an observation that cannot occur in the map; nothing follows it. */
#define ${NAME}_IMPOSSIBLE $states$suffix
"""
"C template: the state type and constants of a policy, or of a machine that reads runs of steps."

RUN_TABLES = (
    "/* The start of the next bumps of each state in the two tables after this. */\n"
    + table("first", size="$bounds")
    + table("steps", size="$bumps")
    + table("target", size="$bumps", bits="${at_bits}")
)
"C template: tables of the possible runs of steps after each state, and of the states after them."

RUN_NEXT = """\
static inline ${name}_state ${name}_next(${name}_state state, uint8_t observation) {
    const ${name}_state impossible = {${NAME}_IMPOSSIBLE, 0};
    uint${first_bits}_t bump, end;
    if (state.at >= ${NAME}_STATES || observation > 1) return impossible;
    bump = ${NAME}_READ($first_bits, ${name}_first[state.at]);
    end = ${NAME}_READ($first_bits, ${name}_first[state.at + 1]);
    if (bump == end) return impossible;
    if (observation == 0) {
        if (state.steps >= ${NAME}_READ($steps_bits, ${name}_steps[end - 1])) return impossible;
        state.steps++;
        return state;
    }
    for (; bump < end; bump++) {
        if (${NAME}_READ($steps_bits, ${name}_steps[bump]) == state.steps) {
            state.at = ${NAME}_READ($at_bits, ${name}_target[bump]);
            state.steps = 0;
            return state;
        }
    }
    return impossible;
}

"""
"C template: the function that returns the next state, from the tables `RUN_TABLES`."

_TEMPLATE = string.Template(
    "/* A localization policy, made by jaxcell: $states states, $ends of which are ends.\n"
    + USE
    + " *     turn = ${name}_turn(state);                  which angle to turn by now, if any\n *\n"
    + IN_FLASH
    + RUN_STATE
    + """\
#define ${NAME}_NO_TURN $no_turn
/* The colour until the robot is localized; the ends have 2 and more, and the last is that of
 * IMPOSSIBLE. */
#define ${NAME}_TRANSIENT_COLOR 1

"""
    + RUN_TABLES
    + table("turn", "turns", bits="8")
    + KNOWLEDGE
    + RUN_NEXT
    + """\
/* The number of the angle to turn by now, or NO_TURN. */
static inline uint8_t ${name}_turn(${name}_state state) {
    if (state.at >= ${NAME}_STATES || state.steps > 0) return ${NAME}_NO_TURN;
    return ${NAME}_READ(8, ${name}_turns[state.at]);
}

"""
    + look_up("color", "colors", "$last_color")
    + "/* The number of possible configurations at the last bump. */\n"
    + look_up("uncertainty", "uncertainties", "0")
    + LOCALIZED
)

_NO_TURN = 255


def policy_to_c_header(policy: Policy, *, name: str = "policy") -> str:
    """Write a policy as a C99 header for a microcontroller, as [`to_c_header`][] writes a filter.

    **Arguments:** a policy, and the prefix of every name. **Returns:** the text.

    The policy of a robot that always bumps after two steps:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> policy = automata.Policy(
        ...     turn=np.int32([-1, -1]), first=np.int32([0, 1, 1]), steps=np.int32([2]),
        ...     target=np.int32([1]), offsets=np.int32([0, 2, 3]), members=np.int32([0, 1, 1]),
        ... )
        >>> text = automata.policy_to_c_header(policy)
        >>> [line for line in text.splitlines() if "STATES" in line][0]
        '#define POLICY_STATES 2u'
    """
    if policy.turn.max() >= _NO_TURN:
        raise ValueError(f"turn: expected at most {_NO_TURN} angles, got {policy.turn.max() + 1}")
    bits = policy_bits(policy)
    tables = {table: getattr(policy, table) for table in bits}
    tables["turn"] = np.where(policy.turn < 0, _NO_TURN, policy.turn)
    return fill(
        _TEMPLATE,
        name,
        policy.turn.size,
        tables,
        bits | {"at": bits["target"]},
        bounds=policy.turn.size + 1,
        bumps=policy.steps.size,
        ends=policy.ends.size,
        no_turn=_NO_TURN,
        last_color=policy.ends.size + 2,
        at="state.at",
        refuted=f"state.at >= {identifier(name).upper()}_STATES",
        localized="the policy has ended",
    )


def policy_bits(policy: Policy) -> dict[str, int]:
    """Return the number of bits per entry of each table of [`policy_to_c_header`][]."""
    largest = {
        "first": policy.steps.size,
        # Counters never exceed the longest run.
        "steps": int(policy.steps.max()),
        # The number after the last state stands for IMPOSSIBLE.
        "target": policy.turn.size,
        "turn": _NO_TURN,
        "color": policy.ends.size + 2,
        "uncertainty": int(policy.uncertainty.max()),
    }
    return {table: bits_for(value) for table, value in largest.items()}
