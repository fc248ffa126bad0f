import dataclasses

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from ...base.certificate import Certificate
from ...base.threads import one_blas_thread
from ...mapping import Chain, ChainSequence
from .modes import TOLERANCE, check_count
from .window import Subspace, Window, leading_subspace


# The shares of the largest value of a set above which cells belong to it, of which one is chosen.
_LEVELS = (0.0, 0.02, 0.05, *(np.arange(1, 10) / 10).tolist())
# Rounds of the rotation, and the change after which it stands still; of a constant vector, the
# part that is taken off, below 1 lest it vanish.
_MAX_ROUNDS, _STILL, _SHRINK = 1000, 1e-10, 0.99
# The share of what stays in a basin that gathers in its attracting region.
_GATHERED = 0.9
_TINY = np.finfo(float).tiny


@dataclasses.dataclass(frozen=True, eq=False)
class NearlyClosedSets:
    """Sets of cells that a chain hardly leaves, the one with the most mass first."""

    begin: Int[np.ndarray, "cells"]
    "The set of each cell when the window begins, -1 for none."
    end: Int[np.ndarray, "cells"]
    """The set of each cell when it ends: the same of almost-invariant sets; of coherent sets, where
    they have moved to; of attracting regions, the region in which mass gathers that stays."""
    leakage: Float[np.ndarray, "sets"]
    "The share of the mass of each set that is not in it after the window."
    steps: int
    "Of the window."
    value: Float[np.ndarray, "values"]
    """The leading eigenvalues, or singular values: 1 for what is closed. How many are near 1 says
    how many sets there are."""
    certificate: Certificate

    @property
    def count(self) -> int:
        """Number of sets."""
        return self.leakage.size

    @property
    def time(self) -> Float[np.ndarray, "sets"]:
        """The steps after which 1/e of the mass is left, if it goes on leaking so:
        `-steps / log(1 - leakage)`; `inf` for a closed set."""
        with np.errstate(divide="ignore"):
            return -self.steps / np.log1p(-self.leakage)


def almost_invariant_sets(
    chain: Chain | ChainSequence,
    count: int,
    mass: Float[np.ndarray, "cells"] | None = None,
    *,
    steps: int | None = None,
    start: int = 0,
    blur: Chain | None = None,
    throw: bool = True,
) -> NearlyClosedSets:
    """Find sets of cells that mass hardly leaves and hardly enters.

    Let `L` be the steps of the window, `p` the mass and `q = p L`. What goes from cell to cell, and
    the same backwards, is a reversible chain: `(p_i L_ij + p_j L_ji) / (p_i + q_i)`, which is the
    mean of the chain and its time reversal where `p` is stationary (Froyland 2005). Sparse vectors
    that span its leading eigenvectors (Froyland, Rock and Sakellariou 2019) have large values on
    one set each; a set is where its vector is the largest and above that level, of some, from which
    the share of the mass that stays is the largest. What leaves for the sink leaks.

    **Arguments:**

    - `chain`: the chain, or a sequence of chains, of which as many as there are phases are taken
        together by default.
    - `count`: how many sets at most; there are no more than eigenvalues above 1e-6, since rounding
        would decide where the others are.
    - `mass`: of each cell when the window begins, not negative; by default all alike. Cells without
        mass are in no set.
    - `steps`, `start`: the steps of the window, and the phase of the first.
    - `blur`: a chain that follows on the window while sets are looked for, such as one that goes to
        neighbouring cells. Without it a single cell that is mapped to itself is a set. Leakage is
        without it.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`NearlyClosedSets`][], of which `end` is `begin`. The residual of its certificate
    is the largest 2-norm of what orthonormal vectors that span the eigenvectors leave that span by.

    **Raises:** `ValueError` for arguments out of range or of another size; `RuntimeError` if the
    eigenvalues do not converge.

    Two pairs of cells, between which the chain goes in one of ten steps:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> stay, go = np.full((2, 2), 0.45), np.full((2, 2), 0.05)
        >>> chain = mapping.Chain.from_scipy(np.block([[stay, go], [go, stay]]))
        >>> sets = markov.almost_invariant_sets(chain, 2)
        >>> sets.begin.tolist(), sets.leakage.round(6).tolist(), sets.time.round(2).tolist()
        ([0, 0, 1, 1], [0.1, 0.1], [9.49, 9.49])
    """
    return _Search.of(chain, mass, steps, start, blur).sets(count, moving=False, throw=throw)


def coherent_sets(
    chain: Chain | ChainSequence,
    count: int,
    mass: Float[np.ndarray, "cells"] | None = None,
    *,
    steps: int | None = None,
    start: int = 0,
    blur: Chain | None = None,
    throw: bool = True,
) -> NearlyClosedSets:
    """Find sets of cells that move and hardly mix with what is around them, over a finite time.

    They come in pairs, where a set begins and where it ends. With `L` the steps of the window, `p`
    the mass and `q = p L`, they are what the leading singular vectors of the matrix
    `sqrt(p_i) L_ij / sqrt(q_j)` span (Froyland, Santitissadeekorn and Monahan 2010), on both of its
    sides with one rotation; else as [`almost_invariant_sets`][].

    **Arguments:** as for [`almost_invariant_sets`][].

    **Returns:** [`NearlyClosedSets`][], whose values are singular values.

    **Raises:** as [`almost_invariant_sets`][].

    Two pairs of cells that change places, but for one of ten:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> stay, go = np.full((2, 2), 0.05), np.full((2, 2), 0.45)
        >>> chain = mapping.Chain.from_scipy(np.block([[stay, go], [go, stay]]))
        >>> sets = markov.coherent_sets(chain, 2)
        >>> sets.begin.tolist(), sets.end.tolist(), sets.leakage.round(6).tolist()
        ([0, 0, 1, 1], [1, 1, 0, 0], [0.1, 0.1])
    """
    return _Search.of(chain, mass, steps, start, blur).sets(count, moving=True, throw=throw)


def attracting_regions(
    chain: Chain | ChainSequence,
    count: int,
    mass: Float[np.ndarray, "cells"] | None = None,
    *,
    steps: int | None = None,
    start: int = 0,
    blur: Chain | None = None,
    throw: bool = True,
) -> NearlyClosedSets:
    """Find regions in which mass gathers, and their basins, which it hardly leaves but may enter.

    On a basin a combination of the leading right eigenvectors of the window is almost constant, and
    the left eigenvectors have where mass gathers that stays in it (Froyland, Stuart and van Sebille
    2014): the region is the fewest cells with nine tenths of that.

    **Arguments:** as for [`almost_invariant_sets`][].

    **Returns:** [`NearlyClosedSets`][]; `begin` has the basins, `end` the regions within.

    **Raises:** as [`almost_invariant_sets`][].

    Cells 0 and 3 gather what is in 1 and 2, and lose a little of it to each other:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> P = [[0.99, 0, 0, 0.01], [0.5, 0.5, 0, 0], [0, 0, 0.5, 0.5], [0.01, 0, 0, 0.99]]
        >>> sets = markov.attracting_regions(mapping.Chain.from_scipy(np.array(P)), 2)
        >>> sets.begin.tolist(), sets.end.tolist(), sets.leakage.round(6).tolist()
        ([0, 0, 1, 1], [0, -1, -1, 1], [0.005, 0.005])
    """
    return _Search.of(chain, mass, steps, start, blur).attracting(count, throw=throw)


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """A window, and what is needed to look for sets in it."""

    window: Window
    blurred: Window
    "The window and what follows on it while sets are looked for."
    mass: Float[np.ndarray, "cells"]
    "When it begins; it sums to 1."

    @classmethod
    def of(
        cls,
        chain: Chain | ChainSequence,
        mass: Float[np.ndarray, "cells"] | None,
        steps: int | None,
        start: int,
        blur: Chain | None,
    ) -> "_Search":
        window = Window.of(chain, steps, start)
        mass = np.ones(window.cells) if mass is None else np.asarray(mass, float)
        if mass.shape != (window.cells,) or not (mass.min() >= 0 and 0 < mass.sum() < np.inf):
            raise ValueError(f"mass: expected {window.cells} numbers from 0 on, and some above")
        if blur is not None and blur.cells != window.cells:
            raise ValueError(f"blur: expected a chain of {window.cells} cells, got {blur.cells}")
        after = () if blur is None else Window.of(blur).matrices
        return cls(window, Window((*window.matrices, *after)), mass / mass.sum())

    def sets(self, count: int, *, moving: bool, throw: bool) -> NearlyClosedSets:
        """Those of the reversible chain between the beginning and the end of the window; or, not
        moving, of the one in which both are one."""
        cells, blurred = self.window.cells, self.blurred
        check_count(count, cells)
        before, after = self.mass[:, None], blurred.push(self.mass)[:, None]
        weight = np.concatenate([before, after]) if moving else (before + after) / 2
        root = np.sqrt(weight)
        over = _inverse(root)

        def product(vectors: np.ndarray) -> np.ndarray:
            values = over * vectors
            first, last = (values[:cells], values[cells:]) if moving else (values, values)
            there, back = before * blurred.pull(last), blurred.push(before * first)
            return over * (np.concatenate([there, back]) if moving else (there + back) / 2)

        span = leading_subspace(product, len(weight), count, symmetric=True)
        basis = span.above(TOLERANCE)
        on_sets = over * (basis @ _rotation(basis, root))
        first, last = (on_sets[:cells], on_sets[cells:]) if moving else (on_sets, None)
        found = self._thresholded(first, last, after[:, 0])
        values = np.linalg.eigvalsh(span.block)[::-1]
        return self._result(*found, values, span, throw)

    def attracting(self, count: int, *, throw: bool) -> NearlyClosedSets:
        """The basins, by functions, and the regions, by the measures that belong to them."""
        cells, blurred = self.window.cells, self.blurred
        check_count(count, cells)
        root = np.sqrt(self.mass[:, None])
        over = _inverse(root)
        functions = leading_subspace(
            lambda v: root * blurred.pull(over * v), cells, count, symmetric=False
        )
        measures = leading_subspace(
            lambda v: over * blurred.push(root * v), cells, count, symmetric=False
        )
        basis = functions.above(TOLERANCE)
        turned = basis @ _rotation(basis, root)
        on_sets = over * turned
        basin, _, leakage = self._thresholded(on_sets, None, self.mass)
        # Each measure gives the function of its basin 1, and those of others 0.
        images = measures.above(TOLERANCE)
        there = root * (images @ np.linalg.pinv(turned.T @ images))
        gathered = np.where(basin[:, None] == np.arange(there.shape[1]), there, 0)
        region = np.where(_densest(np.maximum(gathered, 0)).any(axis=1), basin, -1)
        values = np.sort(np.linalg.eigvals(functions.block).real)[::-1]
        return self._result(basin, region, leakage, values, functions, throw)

    def _thresholded(
        self,
        first: Float[np.ndarray, "cells sets"],
        last: Float[np.ndarray, "cells sets"] | None,
        after: Float[np.ndarray, "cells"],
    ) -> tuple[Int[np.ndarray, "cells"], Int[np.ndarray, "cells"], Float[np.ndarray, "sets"]]:
        """The sets when the window begins and ends, and what they leak, by the best levels.

        **Arguments:**

        - `first`, `last`: functions that are large on one set each, then and then; `None` where
            the sets do not move.
        - `after`: the mass that there is at the end, as it is while sets are looked for.
        """
        mass, sets = self.mass, np.arange(first.shape[1])
        high = np.maximum(first.max(axis=0), _TINY)
        first, last = first / high, None if last is None else last / high

        def members(level: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
            begin = _members(first, mass, level)
            return begin, begin if last is None else _members(last, after, level)

        def staying(window: Window, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
            there = (end[:, None] == sets).astype(float)
            return np.einsum("c,cs,cs->s", mass, begin[:, None] == sets, window.pull(there))

        best, levels = np.zeros(sets.size), np.ones(sets.size)
        for level in _LEVELS:
            begin, end = members(level)
            most = mass @ (begin[:, None] == sets) + after @ (end[:, None] == sets)
            score = staying(self.blurred, begin, end) / np.maximum(most, _TINY)
            better = score > best
            best, levels = np.where(better, score, best), np.where(better, level, levels)
        begin, end = members(levels)
        held = np.maximum(mass @ (begin[:, None] == sets), _TINY)
        return begin, end, (1 - staying(self.window, begin, end) / held).clip(0, 1)

    def _result(
        self,
        begin: Int[np.ndarray, "cells"],
        end: Int[np.ndarray, "cells"],
        leakage: Float[np.ndarray, "sets"],
        value: Float[np.ndarray, "values"],
        span: Subspace,
        throw: bool,
    ) -> NearlyClosedSets:
        """The sets that have some mass, in order of it."""
        certificate = Certificate(span.products, span.residual, TOLERANCE)
        certificate.check("nearly closed sets", throw)
        held = np.bincount(begin[begin >= 0], self.mass[begin >= 0], leakage.size)
        known, first = np.unique(begin, return_index=True)
        first = np.append(first, 0)[np.searchsorted(known, np.arange(held.size))]
        # Rounded, so that of equal mass the set of the smallest cell comes first.
        order = np.lexsort((first, -held.round(12)))[: np.count_nonzero(held)]
        # The last one is for cells in no set.
        number = np.full(held.size + 1, -1, np.int32)
        number[order] = np.arange(order.size)
        steps = len(self.window.matrices)
        return NearlyClosedSets(
            number[begin], number[end], leakage[order], steps, value, certificate
        )


def _members(
    values: Float[np.ndarray, "cells sets"],
    mass: Float[np.ndarray, "cells"],
    level: Float[np.ndarray, "sets"] | float,
) -> Int[np.ndarray, "cells"]:
    """The set of each cell with mass, the one with the largest value if it is above its level."""
    largest = values.argmax(axis=1)
    above = (values > level)[np.arange(mass.size), largest]
    return np.where(above & (mass > 0), largest, -1)


@one_blas_thread()
def _rotation(
    basis: Float[np.ndarray, "rows vectors"], root: Float[np.ndarray, "rows 1"]
) -> Float[np.ndarray, "vectors vectors"]:
    """The rotation after which the vectors of a basis are large on one set of rows each.

    That is SEBA (Froyland, Rock and Sakellariou 2019) in the space whose rows weigh `root**2`. It
    starts from rows that stand for one set each, by a pivoted factorisation (Damle, Minden and Ying
    2019), since a constant vector is no start: it would stay.
    """
    root = root / np.linalg.norm(root)
    shrink = _SHRINK * root
    _, pivots = scipy.linalg.qr(basis.T, mode="r", pivoting=True)
    rotation = _orthogonal(basis[pivots[: basis.shape[1]]].T)
    for _ in range(_MAX_ROUNDS):
        turned = basis @ rotation
        small = turned - turned.clip(-shrink, shrink)
        before = rotation
        rotation = _orthogonal(
            basis.T @ (small / np.maximum(np.linalg.norm(small, axis=0), _STILL))
        )
        if np.abs(rotation - before).max() <= _STILL:
            break
    sign = np.where(np.sum(root * small, axis=0) < 0, -1.0, 1.0)
    return rotation * sign


def _orthogonal(matrix: Float[np.ndarray, "rows rows"]) -> Float[np.ndarray, "rows rows"]:
    """The orthogonal matrix that is nearest to a matrix."""
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def _densest(mass: Float[np.ndarray, "cells sets"]) -> np.ndarray:
    """The fewest cells that have most of the mass of each set."""
    order = np.argsort(-mass, axis=0)
    held = np.cumsum(np.take_along_axis(mass, order, axis=0), axis=0)
    # Those before which some of it was still missing.
    wanted = held - np.take_along_axis(mass, order, axis=0) < _GATHERED * held[-1]
    found = np.zeros(mass.shape, bool)
    np.put_along_axis(found, order, wanted, axis=0)
    return found


def _inverse(root: Float[np.ndarray, "rows 1"]) -> Float[np.ndarray, "rows 1"]:
    """The inverse of numbers, 0 where they are 0."""
    return np.where(root > 0, 1 / np.where(root > 0, root, 1), 0)
