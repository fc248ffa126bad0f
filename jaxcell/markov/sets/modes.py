import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Complex

from ...base.certificate import Certificate
from ...mapping import Chain, ChainSequence
from .window import Window, leading_subspace


# Tolerance of the residual of eigenvectors of length 1.
TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Modes:
    """Leading eigenvalues of the matrix of one or several steps of a chain, with eigenvectors."""

    value: Complex[np.ndarray, "modes"]
    "The eigenvalues with the largest real parts, in descending order."
    right: Complex[np.ndarray, "modes cells"]
    """Right eigenvectors: functions with `P f = value f`. If the value is near 1, they are almost
    constant on each basin of attraction."""
    left: Complex[np.ndarray, "modes cells"]
    """Left eigenvectors: measures with `m P = value m`, which are large where mass gathers. The
    product of a measure and a function is 1 if both belong to the same mode, and 0 otherwise."""
    certificate: Certificate


def leading_modes(
    chain: Chain | ChainSequence,
    count: int,
    *,
    steps: int | None = None,
    start: int = 0,
    throw: bool = True,
) -> Modes:
    """Compute the leading eigenvalues of a chain, with right and left eigenvectors.

    A mode with eigenvalue `x` decays by a factor e in `-steps / log |x|` steps. Mass that leaves
    the space is lost: if the space has an open edge, even the first eigenvalue is less than 1.

    **Arguments:**

    - `count`: the number of eigenvalues. If this splits a conjugate pair, one more is returned.
    - `steps`: the number of steps whose product is `P`, by default one per phase of a sequence.
    - `start`: the phase of the first step of a sequence of chains.

    **Returns:** the modes. The residual of the certificate is the largest 2-norm of
    `P f - value f`, or of `m P - value m`, over eigenvectors of length 1.

    Two pairs of cells; in each step the chain moves to the other pair with probability 1/10:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> stay, go = np.full((2, 2), 0.45), np.full((2, 2), 0.05)
        >>> chain = mapping.Chain.from_scipy(np.block([[stay, go], [go, stay]]))
        >>> modes = markov.leading_modes(chain, 2)
        >>> modes.value.real.round(6).tolist()
        [1.0, 0.8]
        >>> np.sign(modes.right[1].real / modes.right[1, 0].real).tolist()
        [1.0, 1.0, -1.0, -1.0]
    """
    window = Window.of(chain, steps, start)
    check_count(count, window.cells)
    functions = leading_subspace(window.pull, window.cells, count, symmetric=False)
    vectors = functions.basis.shape[1]
    measures = leading_subspace(window.push, window.cells, vectors, symmetric=False)
    values, inner = np.linalg.eig(functions.block)
    order = np.argsort(-values.real, kind="stable")
    values, right = values[order], functions.basis @ inner[:, order]
    right = right / right[np.abs(right).argmax(axis=0), np.arange(vectors)]
    left = measures.basis @ np.linalg.pinv(right.T @ measures.basis)
    residual = max(_residual(window.pull, right, values), _residual(window.push, left, values))
    certificate = Certificate(functions.products + measures.products, residual, TOLERANCE)
    certificate.check("leading_modes", throw)
    value, right, left = (np.asarray(v, complex) for v in (values, right.T, left.T))
    return Modes(value, right, left, certificate)


def _residual(
    product: Callable[[np.ndarray], np.ndarray], vectors: np.ndarray, values: np.ndarray
) -> float:
    """Return the largest 2-norm of `product(v) - value v` over eigenvectors of length 1."""
    left = product(vectors) - values * vectors
    return float((np.linalg.norm(left, axis=0) / np.linalg.norm(vectors, axis=0)).max())


def check_count(count: int, cells: int) -> None:
    """Raise `ValueError` unless a chain of `cells` cells has at least `count` eigenvalues."""
    if not 1 <= count <= cells:
        raise ValueError(f"count: expected 1 to {cells}, the number of cells, got {count}")
