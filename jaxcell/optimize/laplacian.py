"""The weighted Laplacian of a connected graph: its pseudo-inverse, and what edges do to it."""

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int


# Rows of the inverse whose differences are held at once.
_ROWS = 256


def pseudo_inverse(
    vertices: int, edges: Int[np.ndarray, "edges 2"], weights: Float[np.ndarray, "edges"]
) -> Float[np.ndarray, "vertices vertices"]:
    """The pseudo-inverse of `sum_e w_e b_e b_e'`, `b_e` the difference of the ends of edge `e`.

    **Raises:** `numpy.linalg.LinAlgError` if weights leave parts that are separate to rounding.
    """
    tail, head = edges.T
    laplacian = np.zeros((vertices, vertices))
    laplacian[tail, head] = laplacian[head, tail] = -weights
    degree = -laplacian.sum(axis=0)
    laplacian.flat[:: vertices + 1] = degree
    # A constant turns the eigenvalue 0 into one within the range of the others.
    shift = degree.mean()
    laplacian += shift / vertices
    # The transpose of a symmetric matrix is in the order that LAPACK overwrites.
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
    """The sum of the reciprocal eigenvalues, and by how much each weight lowers it.

    **Raises:** as [`pseudo_inverse`][].
    """
    inverse = pseudo_inverse(vertices, edges, weights)
    tail, head = edges.T
    gain = np.empty(len(edges))
    for first in range(0, len(edges), _ROWS):
        some = slice(first, first + _ROWS)
        columns = inverse[tail[some]] - inverse[head[some]]
        gain[some] = np.einsum("en,en->e", columns, columns)
    return float(np.trace(inverse)), gain
