import re
import string
import textwrap
from collections.abc import Mapping

import numpy as np
from jaxtyping import Int

from ..filter import Filter


IN_FLASH = """\
 * On an AVR, where tables would fill the RAM, define JAXCELL_PROGMEM before including this file:
 * they then stay in flash, where no table may be larger than 32 KiB. */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef JAXCELL_PROGMEM
#include <avr/pgmspace.h>
#define ${NAME}_TABLE PROGMEM
#define ${NAME}_READ(bits, entry) ${NAME}_READ_##bits(entry)
#define ${NAME}_READ_8(entry) pgm_read_byte(&(entry))
#define ${NAME}_READ_16(entry) pgm_read_word(&(entry))
#define ${NAME}_READ_32(entry) pgm_read_dword(&(entry))
#else
#define ${NAME}_TABLE
#define ${NAME}_READ(bits, entry) (entry)
#endif
"""
"C template for all headers: the end of their first comment, and macros to read tables from flash."

USE = """\
 *
 *     ${name}_state state = ${NAME}_START;
 *     state = ${name}_next(state, observation);    after each observation, 0 or 1
"""
"C template for all headers: the usage example in their first comment."


def table(entries: str, name: str = "", size: str = "$states", bits: str = "") -> str:
    """Return the template of a C table; `fill` inserts `entries` and, by default, their width."""
    bits = bits or f"${{{entries}_bits}}"
    return (
        f"static const uint{bits}_t ${{name}}_{name or entries}[{size}] ${{NAME}}_TABLE = {{\n"
        f"${entries}\n"
        "};\n\n"
    )


def look_up(entry: str, names: str, beyond: str) -> str:
    """Return the template of a C function `entry(state)`, which reads from the table `names`.

    `beyond` is the result of the function for a state that does not exist.
    """
    return (
        f"static inline uint${{{entry}_bits}}_t ${{name}}_{entry}(${{name}}_state state) {{\n"
        f"    if ($at >= ${{NAME}}_STATES) return {beyond};\n"
        f"    return ${{NAME}}_READ(${entry}_bits, ${{name}}_{names}[$at]);\n"
        "}\n\n"
    )


TRANSITIONS = table("transition", size="$states][2", bits="${state_bits}")
"C template: the table of the next state for each state and observation."

OBSERVATION_NEXT = """\
static inline ${name}_state ${name}_next(${name}_state state, uint8_t observation) {
    if (state >= ${NAME}_STATES || observation > 1) return ${NAME}_IMPOSSIBLE;
    return ${NAME}_READ($state_bits, ${name}_transition[state][observation]);
}

"""
"C template: the function that returns the next state, from the table `TRANSITIONS`."

KNOWLEDGE = table("color", "colors") + table("uncertainty", "uncertainties")
"C template: the tables of the colour and the uncertainty of each state of a filter or a policy."

LOCALIZED = """\
/* 1 if the robot cannot be in the map, else 0. */
static inline int ${name}_refuted(${name}_state state) {
    return $refuted;
}

/* 1 if $localized, else 0. */
static inline int ${name}_localized(${name}_state state) {
    return ${name}_color(state) > ${NAME}_TRANSIENT_COLOR && !${name}_refuted(state);
}

#endif
"""
"C template: `refuted` and `localized`, the last functions in headers of filters and policies."

_TEMPLATE = string.Template(
    "/* A localization filter, made by jaxcell: $states states, $cycles knowledge cycles.\n"
    + USE
    + " *\n"
    + IN_FLASH
    + """\

typedef uint${state_bits}_t ${name}_state;

#define ${NAME}_STATES $states$suffix
#define ${NAME}_START 0
/* After an observation that cannot occur in the map, or is not 0 or 1; nothing follows it. */
#define ${NAME}_IMPOSSIBLE $impossible$suffix
/* The colour outside the knowledge cycles; theirs are 2 and more, and 0 is that of IMPOSSIBLE. */
#define ${NAME}_TRANSIENT_COLOR 1
$trap
"""
    + TRANSITIONS
    + KNOWLEDGE
    + OBSERVATION_NEXT
    + look_up("color", "colors", "0")
    + "/* The number of possible configurations. */\n"
    + look_up("uncertainty", "uncertainties", "0")
    + LOCALIZED
)


def to_c_header(filter: Filter, *, name: str = "filter") -> str:
    """Write a filter as a C99 header for a microcontroller: small tables and their functions.

    **Arguments:** a filter, and the prefix of every name in the header; characters that C does not
    allow become underscores. **Returns:** the text, with a comment that shows its use.

    The filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> filter = examples.ring()
        >>> [line for line in automata.to_c_header(filter).splitlines() if "STATES" in line][0]
        '#define FILTER_STATES 5u'
    """
    states = len(filter.transition)
    impossible = next(2**bits - 1 for bits in (8, 16, 32) if states < 2**bits)
    transition = filter.transition.astype("int64")
    transition[transition < 0] = impossible
    tables = {"transition": transition, "color": filter.color, "uncertainty": filter.uncertainty}
    bits = {table: bits_for(int(values.max())) for table, values in tables.items()}
    NAME = identifier(name).upper()
    trap = f"#define {NAME}_TRAP {filter.trap}\n" if filter.open_world else ""
    return fill(
        _TEMPLATE,
        name,
        states,
        tables,
        bits | {"state": bits_for(impossible)},
        cycles=len(filter.cycles),
        impossible=impossible,
        trap=trap,
        at="state",
        refuted=f"state >= {NAME}_STATES" + f" || state == {NAME}_TRAP" * filter.open_world,
        localized="the state is in a knowledge cycle",
    )


def fill(
    template: string.Template,
    name: str,
    states: int,
    tables: Mapping[str, Int[np.ndarray, "..."]],
    bits: Mapping[str, int],
    **fields: object,
) -> str:
    """Fill in a template: the entries of `tables`, integer widths in `bits`, and other fields."""
    name = identifier(name)
    fields |= {table: _rows(values) for table, values in tables.items()}
    fields |= {f"{table}_bits": width for table, width in bits.items()}
    suffix = "u" if states < 2**16 else "ul"
    return template.substitute(fields, name=name, NAME=name.upper(), states=states, suffix=suffix)


def identifier(name: str) -> str:
    """Convert a name to a prefix of C identifiers, which begins with a letter."""
    identifier = re.sub(r"[^A-Za-z0-9_]", "_", name).lstrip("_")
    return identifier if identifier[:1].isalpha() else f"filter_{identifier}".rstrip("_")


def bits_for(largest: int) -> int:
    """Return the number of bits of the smallest unsigned C type that holds a number."""
    return next(bits for bits in (8, 16, 32) if largest < 2**bits)


def _rows(values: Int[np.ndarray, "..."]) -> str:
    """Format the entries of a table, numbers or pairs of numbers, as lines of C."""
    entries = (str(v).replace("[", "{").replace("]", "}") for v in values.tolist())
    return textwrap.fill(", ".join(entries), 100, initial_indent="    ", subsequent_indent="    ")
