import numpy as np

from ..bounce import LocalizationPolicy, bounce_map
from .bounce import compare_images
from .comparison import Comparison, sample


_STARTS = 50


def compare_policy(found: LocalizationPolicy) -> list[Comparison]:
    """Compare a policy with a set of cells that is moved one step at a time, and the images that
    move it with steps in the free space.
    """
    mapped = bounce_map(found.cells, found.bounces, motion=found.motion)
    images, bumped = np.asarray(mapped.image), np.asarray(mapped.bumped)[0]
    compared = []
    for i, bounce in enumerate(found.bounces.tolist()):
        one = type(mapped)(mapped.image[i], mapped.bumped[i])
        compared.append(compare_images(found.cells, one, bounce, motion=found.motion))
    wrong, starts = [], sample(found.cells.size, _STARTS)
    for start in starts.tolist():
        cell, state, left, bumps = start, found.policy.start(), np.arange(bumped.size), 0
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
        if bumps != found.bumps_needed.ravel()[start]:
            wrong.append(f"start {start}: it takes {bumps} bumps")
    what = "cells that a policy leaves, by images of all cells"
    return [*compared, Comparison.exact(what, wrong, 2 * starts.size)]
