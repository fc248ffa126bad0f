import re
import string
import textwrap
from collections.abc import Iterable

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
"The end of the first comment, and the macros that read tables, in both kinds of headers."

OBSERVATION_NEXT = """\
static inline ${name}_state ${name}_next(${name}_state state, uint8_t observation) {
    if (state >= ${NAME}_STATES || observation > 1) return ${NAME}_IMPOSSIBLE;
    return ${NAME}_READ($state_bits, ${name}_transition[state][observation]);
}

"""
"""The function of a state and an observation, each of which leads to a state."""

_TEMPLATE = string.Template(
    """\
/* A localization filter, made by jaxcell: $states states, $cycles knowledge cycles.
 *
 *     ${name}_state state = ${NAME}_START;
 *     state = ${name}_next(state, observation);    after each observation, 0 or 1
 *
"""
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
static const uint${state_bits}_t ${name}_transition[$states][2] ${NAME}_TABLE = {
$transition
};

static const uint${color_bits}_t ${name}_colors[$states] ${NAME}_TABLE = {
$color
};

static const uint${uncertainty_bits}_t ${name}_uncertainties[$states] ${NAME}_TABLE = {
$uncertainty
};

"""
    + OBSERVATION_NEXT
    + """\
static inline uint${color_bits}_t ${name}_color(${name}_state state) {
    if (state >= ${NAME}_STATES) return 0;
    return ${NAME}_READ($color_bits, ${name}_colors[state]);
}

/* The number of possible configurations. */
static inline uint${uncertainty_bits}_t ${name}_uncertainty(${name}_state state) {
    if (state >= ${NAME}_STATES) return 0;
    return ${NAME}_READ($uncertainty_bits, ${name}_uncertainties[state]);
}

/* 1 if the robot cannot be in the map, else 0. */
static inline int ${name}_refuted(${name}_state state) {
    return $refuted;
}

/* 1 if the state is in a knowledge cycle, else 0. */
static inline int ${name}_localized(${name}_state state) {
    return ${name}_color(state) > ${NAME}_TRANSIENT_COLOR && !${name}_refuted(state);
}

#endif
"""
)


def to_c_header(filter: Filter, *, name: str = "filter") -> str:
    """Write the filter as a C99 header for a microcontroller: small tables, and functions for them.

    **Arguments:**

    - `filter`: a localization filter.
    - `name`: the prefix of every name in the header; characters that C does not allow become
        underscores.

    **Returns:** the text of a `.h` file; a comment at its top shows its use.

    The filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> filter = examples.ring()
        >>> [line for line in automata.to_c_header(filter).splitlines() if "STATES" in line][0]
        '#define FILTER_STATES 5u'
    """
    name = identifier(name)
    states = len(filter.transition)
    impossible = next(2**bits - 1 for bits in (8, 16, 32) if states < 2**bits)
    transition = filter.transition.astype("int64")
    transition[transition < 0] = impossible
    trap = f"#define {name.upper()}_TRAP {filter.trap}\n" if filter.open_world else ""
    refuted = f"state >= {name.upper()}_STATES"
    return _TEMPLATE.substitute(
        name=name,
        NAME=name.upper(),
        states=states,
        cycles=len(filter.cycles),
        impossible=impossible,
        suffix="u" if impossible < 2**16 else "ul",
        trap=trap,
        refuted=f"{refuted} || state == {name.upper()}_TRAP" if filter.open_world else refuted,
        state_bits=bits_for(impossible),
        color_bits=bits_for(int(filter.color.max())),
        uncertainty_bits=bits_for(int(filter.uncertainty.max())),
        transition=rows_of(f"{{{zero}, {one}}}" for zero, one in transition.tolist()),
        color=rows_of(map(str, filter.color.tolist())),
        uncertainty=rows_of(map(str, filter.uncertainty.tolist())),
    )


def identifier(name: str) -> str:
    """Make a prefix of C identifiers: letters, digits and underscores, a letter first."""
    identifier = re.sub(r"[^A-Za-z0-9_]", "_", name).lstrip("_")
    return identifier if identifier[:1].isalpha() else f"filter_{identifier}".rstrip("_")


def bits_for(largest: int) -> int:
    """Return the width of the type that holds numbers up to the largest."""
    return next(bits for bits in (8, 16, 32) if largest < 2**bits)


def rows_of(entries: Iterable[str]) -> str:
    """Format the entries of a table in lines."""
    return textwrap.fill(", ".join(entries), 100, initial_indent="    ", subsequent_indent="    ")
