import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..base.indices import as_array, check_indices
from ..base.shown import Shown
from .groups import follow, periodic_cells


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Section(Shown):
    """The first-return map of a simple map to a *section*, a set of cells that every orbit meets.

    It is a simple map with far fewer cells and the same cycles. Each cell of the section has a
    *slot*, an index into the arrays. The arrays may be longer than the section, so that many
    sections share one compiled program; `live` marks the slots in use.

    Outside the section the map must be one-to-one: no cell is the image of two cells outside, as on
    straight runs. Then the first slot on the orbit of a cell, and the time until the orbit meets
    it, identify the cell.
    """

    successor: Int[Array | np.ndarray, "*batch slots"]
    "The slot to which each slot returns."
    duration: Int[Array | np.ndarray, "*batch slots"]
    "Number of applications of the map until the return, at least 1."
    lowest: Int[Array | np.ndarray, "*batch slots"]
    "The lowest cell number on the orbit from each slot to its successor, including the successor."
    live: Bool[Array | np.ndarray, "*batch slots"]
    "A mask of the slots in use. The other slots are padding, and return to themselves."


def bucket(size: int) -> int:
    """Round a size up to one of four sizes per power of 2, so that few programs are compiled."""
    unit = 1 << max(0, (size - 1).bit_length() - 3)
    return -(-size // unit) * unit


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SectionCycles(Shown):
    """The periodic groups of a map, found from a section. One slot of each group is its *leader*.

    A cell that first meets the section in slot `s`, after `t` applications of the map, reaches the
    group of `leader[s]` after `max(0, t + lead[s])` applications.
    """

    leader: Int[Array, "*batch slots"]
    "The leader of the group that each slot reaches."
    leads: Bool[Array, "*batch slots"]
    "A mask of the leaders."
    lead: Int[Array, "*batch slots"]
    """Number of applications of the map from each slot to its group. If a slot is in its group, all
    cells of the return that ends at the slot are in the group, too. Then the number is 1 minus the
    duration of this return, so 0 or negative."""
    period: Int[Array, "*batch slots"]
    "The period of each group, in the entry of its leader."
    lowest: Int[Array, "*batch slots"]
    "The lowest cell number of each group, in the entry of its leader."


def section_cycles(section: Section) -> SectionCycles:
    """Find the periodic groups of a map from its first-return map to a section.

    **Arguments:** a section. **Returns:** the group that each of its slots reaches.

    The section of cells 0 and 2, in slots 0 and 1, of a ring of cells 0, 1, 2:

        >>> import jax.numpy as jnp
        >>> from jaxcell import mapping
        >>> successor, duration, lowest = (jnp.array(x) for x in ([1, 0], [2, 1], [1, 0]))
        >>> section = mapping.Section(successor, duration, lowest, live=jnp.array([True, True]))
        >>> cycles = mapping.section_cycles(section)
        >>> cycles.leads.tolist(), int(cycles.period[0])
        ([True, False], 3)
    """
    names = [field.name for field in dataclasses.fields(section)]
    arrays = {name: as_array(getattr(section, name), name) for name in names}
    shape = arrays["successor"].shape
    for name, array in arrays.items():
        whole = array.dtype == bool if name == "live" else jnp.issubdtype(array.dtype, jnp.integer)
        if array.shape != shape or not shape or (array.size and not whole):
            noun = "a mask" if name == "live" else "whole numbers"
            raise ValueError(
                f"{name}: expected {noun} of slots like successor, got {list(array.shape)} of "
                f"{array.dtype}"
            )
    arrays["successor"] = check_indices(arrays["successor"], shape[-1], "successor", "slot")
    return _section_cycles(Section(**arrays))


@jax.jit
def _section_cycles(section: Section) -> SectionCycles:
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
    owner = jnp.where(periodic, leader, slots)
    largest = jnp.iinfo(dtype).max
    return SectionCycles(
        leader=leader,
        leads=section.live & periodic & (leader == jnp.arange(slots, dtype=dtype)),
        lead=jnp.where(periodic, 1 - into, step),
        period=jnp.zeros(slots, dtype).at[owner].add(duration, mode="drop"),
        lowest=jnp.full(slots, largest, dtype).at[owner].min(section.lowest, mode="drop"),
    )
