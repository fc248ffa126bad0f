"""Weighted Laplacian of a connected graph: its pseudo-inverse and its derivatives by edges."""

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int


# Number of edges whose differences of rows of the inverse are in memory at once.
_ROWS = 256


def pseudo_inverse(
    vertices: int, edges: Int[np.ndarray, "edges 2"], weights: Float[np.ndarray, "edges"]
) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the pseudo-inverse of `sum_e w_e b_e b_e'`; `b_e` is the difference of the ends of
    `e`.

    **Raises:** `numpy.linalg.LinAlgError` if weights leave separate parts, up to rounding.
    """
    tail, head = edges.T
    laplacian = np.zeros((vertices, vertices))
    laplacian[tail, head] = laplacian[head, tail] = -weights
    degree = -laplacian.sum(axis=0)
    laplacian.flat[:: vertices + 1] = degree
    # A constant moves the eigenvalue 0 into the range of the other eigenvalues.
    shift = degree.mean()
    laplacian += shift / vertices
    # LAPACK overwrites the order of the transpose, which is the same matrix.
    factor, info = scipy.linalg.lapack.dpotrf(laplacian.T, lower=1, overwrite_a=1)
    if info == 0:
        factor, info = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)
    if info:
        raise np.linalg.LinAlgError("the Laplacian is singular to rounding")
    # LAPACK leaves the zeros above the diagonal.
    inverse = factor + factor.T
    inverse.flat[:: vertices + 1] /= 2
    inverse -= 1 / (shift * vertices)
    return inverse


def resistance_gains(
    vertices: int, edges: Int[np.ndarray, "edges 2"], weights: Float[np.ndarray, "edges"]
) -> tuple[float, Float[np.ndarray, "edges"]]:
    """Compute the sum of the reciprocal eigenvalues, and its decrease per unit of each weight."""
    inverse = pseudo_inverse(vertices, edges, weights)
    tail, head = edges.T
    gain = np.empty(len(edges))
    for first in range(0, len(edges), _ROWS):
        block = slice(first, first + _ROWS)
        columns = inverse[tail[block]] - inverse[head[block]]
        gain[block] = np.einsum("en,en->e", columns, columns)
    return float(np.trace(inverse)), gain
