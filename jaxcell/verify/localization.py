import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from ..bounce import LocalizationFilter, LocalizationPolicy, Slipped, bounce_map
from ..mapping import SimpleMap
from .bounce import compare_images
from .comparison import Comparison, sample


_STATES = 1000
_STARTS = 50
_COIN, _LOST = 0.5, 1e-4


def compare_filter(result: LocalizationFilter, simple_map: SimpleMap) -> list[Comparison]:
    """Compare a filter with computations on sparse matrices.

    The transitions of some states are compared with products of matrices, and knowledge cycles with
    the strongly connected components of the transition graph that no edge leaves.
    """
    filter, image = result.filter, np.asarray(simple_map.image)
    states, size = len(filter.transition), image.size
    shape, ones = (states, size), np.ones(filter.members.size, np.int32)
    member = scipy.sparse.csr_array((ones, filter.members, filter.offsets), shape=shape)
    sampled = sample(states, _STATES)
    wrong = []
    for observation in (0, 1):
        senses = np.flatnonzero(np.asarray(simple_map.bumped) == observation)
        entries = np.ones(senses.size, np.int32), (senses, image[senses])
        follows = scipy.sparse.csr_array(entries, shape=(size, size))
        after = filter.transition[sampled, observation]
        ours = member[np.maximum(after, 0)].multiply((after >= 0)[:, None]) != 0
        again = member[sampled] @ follows != 0
        wrong += [
            f"state {sampled[i]} and observation {observation}: the next state has other cells "
            "than the images have"
            for i in np.flatnonzero((ours != again).sum(axis=1)).tolist()
        ]
    what = "states of the filter, by products of sparse matrices"
    compared = [Comparison.exact(what, wrong, 2 * sampled.size)]

    # The trap, the state after observations that cannot occur on the map, is left out.
    known = states - filter.open_world
    source, target = np.repeat(np.arange(known), 2), filter.transition[:known].ravel()
    within = (target >= 0) & (target < known)
    source, target = source[within], target[within]
    graph = scipy.sparse.csr_array((np.ones(source.size), (source, target)), shape=(known, known))
    count, component = csgraph.connected_components(graph, connection="strong")
    ends = np.ones(count, bool)
    ends[component[source[component[source] != component[target]]]] = False
    wrong = [
        f"state {state} has colour {filter.color[state]}"
        for state in np.flatnonzero((filter.color[:known] > 1) != ends[component]).tolist()
    ]
    if len(filter.cycles) != ends.sum():
        wrong.append(f"{len(filter.cycles)} cycles, and {ends.sum()} components")
    what = "knowledge cycles, by strong components that nothing leaves"
    return [*compared, Comparison.exact(what, wrong, known + 1)]


def compare_policy(result: LocalizationPolicy) -> list[Comparison]:
    """Compare the possible cells of a policy with sets of cells that are followed step by step.

    A step replaces each cell by its image. [`jaxcell.verify.compare_images`][] compares the images.
    """
    mapped = bounce_map(result.cells, result.bounces, motion=result.motion)
    images, bumped = np.asarray(mapped.image), np.asarray(mapped.bumped)[0]
    compared = []
    for i, bounce in enumerate(result.bounces.tolist()):
        one = type(mapped)(mapped.image[i], mapped.bumped[i])
        compared.append(compare_images(result.cells, one, bounce, motion=result.motion))
    wrong, starts = [], sample(result.cells.size, _STARTS)
    for start in starts.tolist():
        cell, state, left, bumps = start, result.policy.start(), np.arange(bumped.size), 0
        while True:
            observation = int(bumped[cell])
            left = left[bumped[left] == observation]
            state, bumps = state.observe(observation), bumps + observation
            if state.localized or state.refuted:
                break
            angle = state.turn or 0
            cell, left = images[angle, cell], np.unique(images[angle, left])
        if not np.array_equal(state.cells, left):
            wrong.append(f"start {start}: the policy leaves other cells than the images do")
        if bumps != result.bumps_needed.ravel()[start]:
            wrong.append(f"start {start}: it takes {bumps} bumps")
    what = "cells that a policy leaves, by images of all cells"
    return [*compared, Comparison.exact(what, wrong, 2 * starts.size)]


def compare_slip(result: Slipped) -> list[Comparison]:
    """Compare the final belief of a run with probabilities that are normalised only at the end."""
    hidden, cells = result.hidden, result.cells
    weight = np.append(hidden.start, 0.0)
    for event in result.events.tolist():
        matrix = (hidden.moves, *hidden.bumps)[event].tocoo()
        after = np.zeros_like(weight)
        np.add.at(after, matrix.coords[1], matrix.data * weight[matrix.coords[0]] * (1 - _LOST))
        after[-1] = _COIN * (weight[-1] + _LOST * weight[:-1].sum())
        weight = after
    weight /= weight.sum()
    position = np.bincount(
        hidden.configuration % cells.positions, weight[:-1], minlength=cells.positions
    )
    again = np.append(position, weight[-1])
    reported = np.append(result.belief[-1], result.nowhere[-1])
    rows = np.asarray((hidden.moves + hidden.bumps[0]).sum(axis=1)).ravel()
    return [
        Comparison.close("belief at the end, normalised only there", reported, again, 1e-9),
        Comparison.close("sum of probabilities per fine cell", rows, np.ones_like(rows), 1e-6),
    ]
