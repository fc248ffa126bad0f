"""The pseudo-inverse of the weighted Laplacian of a connected graph."""

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int


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
    laplacian[np.diag_indices(vertices)] = degree
    # A constant turns the eigenvalue 0 into one within the range of the others.
    shift = degree.mean()
    laplacian += shift / vertices
    # The transpose of a symmetric matrix is in the order that LAPACK overwrites.
    factor, info = scipy.linalg.lapack.dpotrf(laplacian.T, lower=1, overwrite_a=1)
    if info == 0:
        factor, info = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)
    if info:
        raise np.linalg.LinAlgError("the Laplacian is singular to rounding")
    return np.tril(factor) + np.tril(factor, -1).T - 1 / (shift * vertices)
