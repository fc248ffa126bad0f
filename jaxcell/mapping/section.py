import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from .groups import follow, periodic_cells


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Section:
    """The first-return map of a simple map to a set of its cells that every orbit meets.

    Outside the section the map must be one-to-one: no cell is the image of two cells outside, as on
    straight runs. Then a slot and a number of mappings to it identify a cell.

    The first-return map is a simple map with far fewer cells and the same cycles. The arrays may be
    longer than the section, so that many sections share one compiled program; `live` marks the
    slots in use.
    """

    successor: Int[Array | np.ndarray, "*batch slots"]
    "The slot to which each slot returns."
    duration: Int[Array | np.ndarray, "*batch slots"]
    "Number of mappings until the return, at least 1."
    lowest: Int[Array | np.ndarray, "*batch slots"]
    "The smallest cell of the full space until the return, inclusive."
    live: Bool[Array | np.ndarray, "*batch slots"]
    "A mask of the slots in use; other slots return to themselves."


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SectionGroups:
    """The periodic groups of the full space, given on a section.

    A cell that first meets the section in slot `s`, after `t` mappings, reaches `group[s]` in
    `max(0, t + lead[s])` mappings.
    """

    group: Int[Array, "*batch slots"]
    lead: Int[Array, "*batch slots"]
    period: Int[Array, "*batch groups"]
    "Period of each group in mappings of the full space; zeros past `count`."
    count: Int[Array, "*batch"]


def section_groups(section: Section, *, max_groups: int | None = None) -> SectionGroups:
    """Find the periodic groups of the full space, numbered as by [`periodic_groups`][].

    `max_groups` is an upper bound of the number of groups; a smaller bound sorts faster. By default
    the groups are counted first; under `jit` and `vmap` the number of slots is used instead.

    On a ring of cells 0, 1, 2, the section of cells 0 and 2, in slots 0 and 1:

        >>> import jax.numpy as jnp
        >>> from jaxcell import mapping
        >>> slots = [jnp.array(x) for x in ([1, 0], [2, 1], [1, 0])]
        >>> section = mapping.Section(*slots, live=jnp.array([True, True]))
        >>> groups = mapping.section_groups(section)
        >>> int(groups.count), int(groups.period[0]), groups.group.tolist()
        (1, 3, [0, 0])
    """
    find, number = section_cycles, _number
    for _ in range(section.live.ndim - 1):
        find, number = jax.vmap(find), jax.vmap(number, in_axes=(0, None))
    cycles = find(section)
    if max_groups is None:
        known = not isinstance(cycles.count, jax.core.Tracer)
        max_groups = bucket(int(np.max(cycles.count))) if known else section.live.shape[-1]
    return number(cycles, max_groups)


def bucket(size: int) -> int:
    """Round a size up to one of four per octave, so that many lengths share a program."""
    unit = 1 << max(0, (size - 1).bit_length() - 3)
    return -(-size // unit) * unit


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SectionCycles:
    """The groups of a section before they are numbered, each identified by its leading slot."""

    leader: Int[Array, "*batch slots"]
    leads: Bool[Array, "*batch slots"]
    lead: Int[Array, "*batch slots"]
    "See [`SectionGroups`][]."
    period: Int[Array, "*batch slots"]
    "The period of each group, at its leading slot; `lowest` is its smallest cell."
    lowest: Int[Array, "*batch slots"]
    count: Int[Array, "*batch"]


@jax.jit
def section_cycles(section: Section) -> SectionCycles:
    """Find the periodic groups of the full space on one section."""
    successor, duration = section.successor, section.duration
    dtype = successor.dtype
    slots = successor.shape[0]
    periodic = periodic_cells(successor)
    # All cells on the last return of a cycle into a slot are periodic; `into` is their number.
    target = jnp.where(periodic, successor, slots)
    into = jnp.zeros(slots, dtype).at[target].set(duration, mode="drop")
    # A transient slot is on the cycle as soon as it enters the part of a return in the cycle.
    arrives = periodic[successor]
    transient = jnp.where(arrives, 1 + jnp.maximum(0, duration - into[successor]), duration)
    leader, step = follow(successor, periodic, transient)
    leads = section.live & periodic & (leader == jnp.arange(slots, dtype=dtype))
    owner = jnp.where(periodic, leader, slots)
    largest = jnp.iinfo(dtype).max
    return SectionCycles(
        leader=leader,
        leads=leads,
        lead=jnp.where(periodic, 1 - into, step),
        period=jnp.zeros(slots, dtype).at[owner].add(duration, mode="drop"),
        lowest=jnp.full(slots, largest, dtype).at[owner].min(section.lowest, mode="drop"),
        count=jnp.sum(leads, dtype=dtype),
    )


@functools.partial(jax.jit, static_argnames="max_groups")
def _number(cycles: SectionCycles, max_groups: int) -> SectionGroups:
    slots = cycles.leader.shape[0]
    dtype = cycles.leader.dtype
    leaders = jnp.flatnonzero(cycles.leads, size=max_groups, fill_value=slots).astype(dtype)
    lowest = cycles.lowest.at[leaders].get(mode="fill", fill_value=jnp.iinfo(dtype).max)
    leaders = leaders[jnp.argsort(lowest)]
    number = jnp.full(slots, -1, dtype)
    number = number.at[leaders].set(jnp.arange(max_groups, dtype=dtype), mode="drop")
    return SectionGroups(
        group=number[cycles.leader],
        lead=cycles.lead,
        period=cycles.period.at[leaders].get(mode="fill", fill_value=0),
        count=cycles.count,
    )
