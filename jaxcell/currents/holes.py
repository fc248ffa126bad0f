"""Holes in the water: small groups of squares without data, as they are common in radar."""

import dataclasses

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float, Int

from .fields import Field


MOST = 9
"""The largest number of squares of a hole that is filled."""
_AROUND = np.ones((3, 3))


def holes(
    gaps: Bool[np.ndarray, "y x"], water: Bool[np.ndarray, "y x"]
) -> tuple[Int[np.ndarray, "y x"], Int[np.ndarray, "holes"]]:
    """Find groups of squares without data that the water encloses.

    **Returns:** the number of the hole of each square, -1 for none, and the squares of each hole.
    Squares that meet at corners are in one hole. A hole touches neither land nor the edge.
    """
    label, count = scipy.ndimage.label(gaps, _AROUND)
    beyond = scipy.ndimage.minimum_filter(water | gaps, 3, mode="constant", cval=False)
    inside = np.ones(count + 1, bool)
    inside[0] = False
    inside[label[gaps & ~beyond]] = False
    number = np.where(inside, np.cumsum(inside) - 1, -1)[label]
    return number, np.bincount(number[number >= 0], minlength=int(inside.sum()))


def fill_holes(field: Field) -> Field:
    """Fill holes of at most `MOST` squares with the mean velocity around them, from their rims."""
    water, u, v = field.water.copy(), field.u.copy(), field.v.copy()
    filled = 0
    for layer in range(len(water)):
        number, size = holes(~(water[layer] | field.land[layer]), water[layer])
        wanted = (number >= 0) & np.append(size <= MOST, False)[number]
        filled += int(wanted.sum())
        while wanted.any():
            known = _sums(water[layer].astype(float))
            rim = wanted & (known > 0)
            for values in (u, v):
                total = _sums(np.where(water[layer], values[:, layer], 0.0))
                values[:, layer, rim] = total[:, rim] / known[rim]
            water[layer] |= rim
            wanted &= ~rim
    note = f"{filled} squares without data, in holes of up to {MOST} squares, are filled"
    return dataclasses.replace(field, u=u, v=v, water=water, notes=(*field.notes, note))


def _sums(values: Float[np.ndarray, "*records y x"]) -> Float[np.ndarray, "*records y x"]:
    """Sum the values of each square and its neighbours."""
    weights = _AROUND.reshape((1,) * (values.ndim - 2) + (3, 3))
    return scipy.ndimage.correlate(values, weights, mode="constant")
