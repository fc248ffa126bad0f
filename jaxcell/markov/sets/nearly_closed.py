import dataclasses
from typing import TypeAlias

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from ...base.certificate import Certificate
from ...base.indices import as_array
from ...base.process import one_blas_thread
from ...base.shown import Pictured
from ...mapping import Chain, ChainLike, ChainSequence
from .modes import TOLERANCE, check_count
from .window import Subspace, Window, leading_subspace


_Labels: TypeAlias = Int[np.ndarray, "cells"]
_Mass: TypeAlias = Float[np.ndarray, "cells"]
_PerSet: TypeAlias = Float[np.ndarray, "sets"]
_Functions: TypeAlias = Float[np.ndarray, "cells sets"]

# Candidates for the level of a set. Cells belong to the set if their values are above this level,
# relative to the largest value.
_LEVELS = (0.0, 0.02, 0.05, *(np.arange(1, 10) / 10).tolist())
# Largest number of rounds of the rotation, and the change at which it ends. A round subtracts this
# share of a constant vector, less than 1 so that a constant vector does not vanish.
_MAX_ROUNDS, _STILL, _SHRINK = 1000, 1e-10, 0.99
# Share of the staying mass of a basin that its attracting region holds.
_GATHERED = 0.9
_TINY = np.finfo(float).tiny


@dataclasses.dataclass(frozen=True, eq=False)
class NearlyClosedSets(Pictured):
    """Sets of cells that a chain hardly leaves in several steps, in descending order of mass."""

    begin: Int[np.ndarray, "cells"]
    "The set that contains each cell before the steps, or -1 if no set does."
    end: Int[np.ndarray, "cells"]
    """The set that contains each cell after the steps, or -1 if no set does. It equals `begin` for
    almost-invariant sets. Coherent sets have moved; basins are reduced to attracting regions."""
    leakage: Float[np.ndarray, "sets"]
    "The share of the mass of each set that is outside the set after the steps."
    steps: int
    "Number of steps between `begin` and `end`, in which hardly any mass leaves the sets."
    value: Float[np.ndarray, "values"]
    """The leading eigenvalues or singular values. About as many of them are near 1 as there are
    sets; a closed set has the value 1."""
    certificate: Certificate

    @property
    def count(self) -> int:
        """Number of sets."""
        return self.leakage.size

    @property
    def time(self) -> Float[np.ndarray, "sets"]:
        """The number of steps after which a share 1/e of the mass of each set remains.

        It is `-steps / log(1 - leakage)` for a constant leakage, and `inf` for a closed set.
        """
        with np.errstate(divide="ignore"):
            return -self.steps / np.log1p(-self.leakage)


def almost_invariant_sets(
    chain: ChainLike | ChainSequence,
    count: int,
    mass: Float[np.ndarray, "cells"] | None = None,
    *,
    steps: int | None = None,
    start: int = 0,
    blur: ChainLike | None = None,
    throw: bool = True,
) -> NearlyClosedSets:
    """Find sets of cells that mass hardly leaves and hardly enters.

    It runs on the host, because the number of sets depends on the values.

    Let `L` be the product of the matrices of the steps, `p` the mass and `q = p L`. The reversible
    chain `(p_i L_ij + p_j L_ji) / (p_i + q_i)` is the mean of `L` and its time reversal if `p` is
    stationary (Froyland 2005). Its leading eigenvectors are rotated to sparse vectors, each of
    which is large on one set (Froyland, Rock and Sakellariou 2019). A set consists of the cells
    where its vector is the largest and exceeds a threshold. The threshold of a set is the one with
    the largest share of mass that stays in the set. Mass that leaves the space counts as leakage.

    **Arguments:**

    - `count`: largest number of sets. Eigenvalues of at most 1e-6 count as rounding errors, and
        yield no sets.
    - `mass`: the mass of each cell at the start, not negative, by default the same for all cells.
        Cells without mass are in no set.
    - `steps`: the number of steps, by default one per phase of a sequence of chains.
    - `start`: the phase of the first step of a sequence of chains.
    - `blur`: a chain that takes one more step in the search, such as a step to a neighbouring cell.
        Without it, a single cell that is mapped to itself is a set. The leakage ignores it.

    **Returns:** sets with an `end` equal to `begin`. The residual of the certificate shows how far
    the span of the eigenvectors is from invariant: it is the largest 2-norm, over an orthonormal
    basis of the span, of the part of a vector's image outside the span.

    Two pairs of cells; in each step the chain moves to the other pair with probability 1/10:

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
    chain: ChainLike | ChainSequence,
    count: int,
    mass: Float[np.ndarray, "cells"] | None = None,
    *,
    steps: int | None = None,
    start: int = 0,
    blur: ChainLike | None = None,
    throw: bool = True,
) -> NearlyClosedSets:
    """Find sets of cells that move and hardly mix with their surroundings, over a finite time.

    Each set has cells at the start and, in general, other cells at the end. With `L`, `p` and `q`
    as in [`almost_invariant_sets`][], both follow from the leading singular vectors of the matrix
    `sqrt(p_i) L_ij / sqrt(q_j)` (Froyland, Santitissadeekorn and Monahan 2010). The left and the
    right singular vectors are rotated by the same matrix, and the same threshold applies to both.

    **Arguments:** as for [`almost_invariant_sets`][]. **Returns:** sets and singular values.

    Two pairs of cells that exchange nine tenths of their mass:

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
    chain: ChainLike | ChainSequence,
    count: int,
    mass: Float[np.ndarray, "cells"] | None = None,
    *,
    steps: int | None = None,
    start: int = 0,
    blur: ChainLike | None = None,
    throw: bool = True,
) -> NearlyClosedSets:
    """Find regions where mass gathers, and their basins, which mass hardly leaves but may enter.

    On each basin some combination of the leading right eigenvectors is almost constant. The left
    eigenvectors are large where the mass that stays in the basin gathers (Froyland, Stuart and van
    Sebille 2014). A region is the fewest cells with nine tenths of this mass.

    **Arguments:** as for [`almost_invariant_sets`][]. **Returns:** the basins as `begin`, and
    the regions in them as `end`.

    Cells 0 and 3 gather the mass of cells 1 and 2, and lose a little to each other:

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
    """A search for sets that a chain hardly leaves in a window, a number of consecutive steps."""

    window: Window
    blurred: Window
    "The window, followed by a step of the chain `blur` if there is one."
    mass: _Mass
    "The mass of each cell at the start of the window, with sum 1."

    @classmethod
    def of(
        cls,
        chain: Chain | ChainSequence,
        mass: _Mass | None,
        steps: int | None,
        start: int,
        blur: Chain | None,
    ) -> "_Search":
        window = Window.of(chain, steps, start)
        mass = np.ones(window.cells) if mass is None else np.asarray(as_array(mass, "mass"), float)
        if mass.shape != (window.cells,) or not (mass.min() >= 0 and 0 < mass.sum() < np.inf):
            raise ValueError(f"mass: expected {window.cells} numbers of at least 0, not all 0")
        if blur is not None and blur.cells != window.cells:
            raise ValueError(f"blur: expected a chain of {window.cells} cells, got {blur.cells}")
        after = () if blur is None else Window.of(blur).matrices
        return cls(window, Window((*window.matrices, *after)), mass / mass.sum())

    def sets(self, count: int, *, moving: bool, throw: bool) -> NearlyClosedSets:
        """Find coherent sets if `moving` is true, and almost-invariant sets otherwise.

        Both follow from a reversible chain. Its states are the cells. For coherent sets, a cell at
        the start and the same cell at the end of the window are two different states.
        """
        cells, blurred = self.window.cells, self.blurred
        check_count(count, cells)
        before, after = self.mass[:, None], blurred.push(self.mass)[:, None]
        weight = np.concatenate([before, after]) if moving else (before + after) / 2
        root = np.sqrt(weight)
        over = _inverse_or_zero(root)

        def product(vectors: np.ndarray) -> np.ndarray:
            values = over * vectors
            first, last = (values[:cells], values[cells:]) if moving else (values, values)
            there, back = before * blurred.pull(last), blurred.push(before * first)
            return over * (np.concatenate([there, back]) if moving else (there + back) / 2)

        one, matrix = blurred.matrix, None
        if one is not None and not moving:
            half = one.multiply(over * before).multiply(over.T)
            matrix = (half + half.T) / 2
        span = leading_subspace(product, len(weight), count, symmetric=True, matrix=matrix)
        basis = span.above(TOLERANCE)
        on_sets = over * (basis @ _rotation(basis, root))
        first, last = (on_sets[:cells], on_sets[cells:]) if moving else (on_sets, None)
        numbered = self._thresholded(first, last, after[:, 0])
        values = np.linalg.eigvalsh(span.block)[::-1]
        return self._result(*numbered, values, span, throw)

    def attracting(self, count: int, *, throw: bool) -> NearlyClosedSets:
        """Find the basins from right eigenvectors, and their regions from left eigenvectors."""
        cells, blurred = self.window.cells, self.blurred
        check_count(count, cells)
        root = np.sqrt(self.mass[:, None])
        over = _inverse_or_zero(root)
        one = blurred.matrix
        matrix = None if one is None else one.multiply(root).multiply(over.T)
        back = None if matrix is None else matrix.T
        functions = leading_subspace(
            lambda v: root * blurred.pull(over * v), cells, count, symmetric=False, matrix=matrix
        )
        measures = leading_subspace(
            lambda v: over * blurred.push(root * v), cells, count, symmetric=False, matrix=back
        )
        basis = functions.above(TOLERANCE)
        turned = basis @ _rotation(basis, root)
        on_sets = over * turned
        basin, _, leakage = self._thresholded(on_sets, None, self.mass)
        # The product of a measure and a function is 1 for one basin, and 0 for two basins.
        images = measures.above(TOLERANCE)
        there = root * (images @ np.linalg.pinv(turned.T @ images))
        gathered = np.where(basin[:, None] == np.arange(there.shape[1]), there, 0)
        region = np.where(_densest(np.maximum(gathered, 0)).any(axis=1), basin, -1)
        values = np.sort(np.linalg.eigvals(functions.block).real)[::-1]
        return self._result(basin, region, leakage, values, functions, throw)

    def _thresholded(
        self, first: _Functions, last: _Functions | None, after: _Mass
    ) -> tuple[_Labels, _Labels, _PerSet]:
        """Choose a threshold for each set; return the sets at the start and end, and the leakage.

        Each column of `first` is large on one set at the start, and the same column of `last` on it
        at the end. `last` is `None` if sets stay. `after` is the mass at the end of `blurred`.
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
        begin: _Labels,
        end: _Labels,
        leakage: _PerSet,
        value: Float[np.ndarray, "values"],
        span: Subspace,
        throw: bool,
    ) -> NearlyClosedSets:
        """Return the sets in descending order of mass, without those that have no mass."""
        certificate = Certificate(span.products, span.residual, TOLERANCE)
        certificate.check("nearly closed sets", throw)
        held = np.bincount(begin[begin >= 0], self.mass[begin >= 0], leakage.size)
        known, first = np.unique(begin, return_index=True)
        first = np.append(first, 0)[np.searchsorted(known, np.arange(held.size))]
        # Sets with equal mass, up to rounding, are in the order of their smallest cells.
        order = np.lexsort((first, -held.round(12)))[: np.count_nonzero(held)]
        # The last entry, -1, is for cells in no set.
        number = np.full(held.size + 1, -1, np.int32)
        number[order] = np.arange(order.size)
        steps = len(self.window.matrices)
        return NearlyClosedSets(
            number[begin], number[end], leakage[order], steps, value, certificate
        )


def _members(values: _Functions, mass: _Mass, level: _PerSet | float) -> _Labels:
    """Assign each cell to the set with the largest value there, or -1 if none exceeds `level`."""
    largest = values.argmax(axis=1)
    above = (values > level)[np.arange(mass.size), largest]
    return np.where(above & (mass > 0), largest, -1)


@one_blas_thread()
def _rotation(
    basis: Float[np.ndarray, "rows vectors"], root: Float[np.ndarray, "rows 1"]
) -> Float[np.ndarray, "vectors vectors"]:
    """Rotate the vectors of a basis so that each is large on one set of rows.

    This is SEBA (Froyland, Rock and Sakellariou 2019) with the row weights `root**2`. It does not
    start from the basis itself, because a constant vector in it would never change, but from rows
    that each represent one set. A pivoted factorisation finds them (Damle, Minden and Ying 2019).
    """
    root = root / np.linalg.norm(root)
    shrink = _SHRINK * root
    _, pivots = scipy.linalg.qr(basis.T, mode="r", pivoting=True)
    rotation, _ = scipy.linalg.polar(basis[pivots[: basis.shape[1]]].T)
    for _ in range(_MAX_ROUNDS):
        turned = basis @ rotation
        small = turned - turned.clip(-shrink, shrink)
        before = rotation
        # The first factor is the nearest orthogonal matrix.
        rotation, _ = scipy.linalg.polar(
            basis.T @ (small / np.maximum(np.linalg.norm(small, axis=0), _STILL))
        )
        if np.abs(rotation - before).max() <= _STILL:
            break
    sign = np.where(np.sum(root * small, axis=0) < 0, -1.0, 1.0)
    return rotation * sign


def _densest(mass: _Functions) -> np.ndarray:
    """Return, for each set, a mask of the fewest cells that hold nine tenths of its mass."""
    order = np.argsort(-mass, axis=0)
    held = np.cumsum(np.take_along_axis(mass, order, axis=0), axis=0)
    # Cells are wanted while the mass of the cells before them is too small.
    wanted = held - np.take_along_axis(mass, order, axis=0) < _GATHERED * held[-1]
    densest = np.zeros(mass.shape, bool)
    np.put_along_axis(densest, order, wanted, axis=0)
    return densest


def _inverse_or_zero(root: Float[np.ndarray, "rows 1"]) -> Float[np.ndarray, "rows 1"]:
    return np.divide(1, root, out=np.zeros_like(root), where=root > 0)
