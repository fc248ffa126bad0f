"""The chains of a noisy map along a parameter, of which few are solved."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from ...base import memory
from ...base.formatting import did_you_mean
from ...base.precision import require_x64
from ...base.process import one_blas_thread
from ...markov.transient import Transient
from ...space.box import Box
from ..imaging import check_finite, mapped_points
from ..maps import Flow, Map
from ..system import System
from .chains import sampled
from .deviations import listed
from .ends import Ends
from .escape import posed
from .extrapolation import with_errors
from .windows import Windows, changes, matrix


# Number of values between which solutions are interpolated.
_NODES = 8
# Distance of these values: so far, images move by this share of the deviation of the noise.
_MOVES = 1 / 12
# Numbers of times that it is halved where the residual is too large.
_LEVELS = range(5)
# Largest residual of a member, and in the middle of an interval in which it is interpolated.
_TOLERANCE, _MIDDLE = 4e-10, 1e-10
# Largest bound on the relative error of interpolated visits there.
_VISITS = 1e-7
# Smaller numbers of visits, relative to the largest one, are rounding.
_LEAST = 1e-16


@dataclasses.dataclass(frozen=True, eq=False)
class Family:
    """The chains of a noisy map along a parameter, with the solutions of some of them."""

    map: Map
    box: Box
    around: Box
    params: dict[str, Any]
    name: str
    noise: Float[np.ndarray, "axes"]
    points: Float[np.ndarray, "rows samples axes"]
    "The points of the cells that are not completely in a region: the rows of the chains."
    weight: Float[np.ndarray, "rows"]
    "The weights of the rows around the start."
    rest: Float[np.ndarray, "around"]
    "The share of each cell of `around` in which the chain goes on, in the row of the next field."
    row: Int[np.ndarray, "around"]
    region: Float[np.ndarray, "regions rows"] | None
    "The share of each cell in each region, for chains that stop where they began."
    width: float
    "The distance of the nodes of the coarsest lattice."
    coarser: tuple["Family", ...] = ()
    "The chains of boxes with wider cells."
    nodes: dict[float, Any] = dataclasses.field(default_factory=dict)
    "Logarithms of the times and of the visits, by the values of the parameter that are solved."
    levels: dict[tuple[int, int], bool] = dataclasses.field(default_factory=dict)
    "Flags of the intervals in which solutions are interpolated, keyed by level and number."

    @classmethod
    def of(
        cls,
        system: System,
        name: str,
        *,
        noise: Any,
        start: Any,
        into: Any,
        out_of: Any,
        back: bool = False,
    ) -> "Family":
        """Raise `ValueError` for wrong arguments, and choose the lattice.

        With `back`, the chains do not stop in regions, but where they began: at the cell of the
        start.
        """
        require_x64("exit times")
        map, ends = posed(system, None, into, out_of)
        box, params = ends.box, dict(system.params)
        if isinstance(map, Flow):
            raise ValueError("system: expected a map with noise once per mapping, got a flow")
        if name not in params:
            meant = did_you_mean(name, params)
            raise ValueError(f"name: expected one of {', '.join(params)}, got {name!r}{meant}")
        each = np.array(listed(noise, box.dimensions), float)
        if each.shape != (box.dimensions,) or not (np.isfinite(each) & (each > 0)).all():
            raise ValueError(f"noise: expected {box.dimensions} numbers above 0, got {noise}")
        if back and "sink" in box.axes:
            raise ValueError("shares: a system that leaves the box at a sink has no long run")
        memory.check(32 * box.size**2, f"exit times of {box.size} cells", "use fewer cells")

        def chains(ends: Ends) -> "Family":
            box = ends.box
            alive, rest, region = ends.open, 1 - ends.share.sum(axis=0), None
            weight = ends.weights([float(one) for one in start], odd=False)[: box.size]
            if back:
                home = np.arange(box.size) == weight.argmax()
                alive, rest, weight = np.ones(box.size, bool), 1.0 - home[ends.nearest], 1.0 * home
                inner = box.centre(np.arange(box.size, dtype=np.int32))
                region = ends.share[:, ends.around.index(inner)]
            points = sampled(box, np.flatnonzero(alive).astype(np.int32))
            weight, rest = weight[alive], rest * alive[ends.nearest]
            row = np.maximum(np.cumsum(alive) - 1, 0)[ends.nearest]
            speed = _speed(map, params, name, points) / each
            width = _MOVES / (float(np.sqrt((speed**2).mean())) or 1.0)
            width = 2.0 ** np.floor(np.log2(width))
            rows = points, weight, rest, row, region
            return cls(map, box, ends.around, params, name, each, *rows, width)

        whole, *coarser = (chains(one) for one in ends.levels[: 1 if back else None])
        return dataclasses.replace(whole, coarser=tuple(coarser))

    @one_blas_thread()
    def at(self, value: float) -> dict[str, float] | None:
        """Compute the numbers of [`with_errors`][] and `residual`; `None` if this is too large.

        Raise `ValueError` if an image is not finite.
        """
        solutions, every = list[dict[str, Any]](), (self, *self.coarser)
        for one in every:
            one._check(value)
            at = one._lattice(value)
            found = None if at is None else one._between(value, at)
            if found is None or not found[2] <= _TOLERANCE:
                return None
            mean, by, residual, _, square = found
            numbers = {"mean_time": mean, "deviation": max(square - mean**2, 0.0) ** 0.5}
            # The probability of leaving, after a stay as long as the system is expected to go on.
            numbers["rate"] = 2 * mean / (square + mean)
            about = {"slope": by / mean, "residual": residual}
            solutions.append({"numbers": numbers, "rough": numbers, **about})
        residual = max(one["residual"] for one in solutions)
        whole = with_errors(solutions, [one.box for one in every]) | {"residual": residual}
        return {name: float(number) for name, number in whole.items()}

    @one_blas_thread()
    def shares(self, value: float, alone: bool = False) -> Float[np.ndarray, "regions"]:
        """Compute the share of visits in each region; NaN if the chain cannot be solved.

        `alone` solves the chain of this value.
        """
        assert self.region is not None
        self._check(value)
        at = None if alone else self._lattice(value)
        each = self._nodes([value] if at is None else at.tolist())
        if each is None:
            return np.full(len(self.region), np.nan)
        visits = np.exp(each[1] @ (np.ones(1) if at is None else _interpolation(at, value)[0]))
        return self.region @ visits / visits.sum()

    def _lattice(self, value: float) -> np.ndarray | None:
        """Return the nodes around a value, of the coarsest lattice with small errors there."""
        for level in _LEVELS:
            width = self.width / 2**level
            cell = int(np.floor(value / width))
            at = (cell + np.arange(1 - _NODES // 2, 1 + _NODES // 2)) * width
            if (level, cell) not in self.levels:
                found = self._between((cell + 0.5) * width, at)
                number, most = (2, _MIDDLE) if self.region is None else (3, _VISITS)
                self.levels[level, cell] = found is not None and found[number] <= most
            if self.levels[level, cell]:
                return at
        return None

    def _between(self, value: float, at: np.ndarray) -> tuple[float, ...] | None:
        """Interpolate between nodes; return the numbers of `_checked` and the mean square time."""
        each = self._nodes(at.tolist())
        if each is None:
            return None
        share, slope = _interpolation(at, value)
        # Of times and visits: values, and derivatives by the parameter.
        both = np.exp(each @ share)
        moves = both * (each @ slope)
        (mean, by, *errors), left, astray = self._checked(value, *both)
        square = 2 * float(both[0] @ both[1]) - mean
        # The mean time with the first correction, and its derivative along the interpolation.
        return mean, by + float(moves[1] @ left + astray @ moves[0]), *errors, square

    def _nodes(self, values: list[float]) -> Any:
        """Solve the chains of values, those of nodes once; `None` if any chain cannot be solved."""
        for value in values:
            if value not in self.nodes:
                self.nodes[value] = self._solved(value)
        each = [self.nodes[value] for value in values]
        return None if any(one is None for one in each) else np.stack(each, axis=-1)

    def _check(self, value: float) -> None:
        own = {**self.params, self.name: value}
        check_finite(np.asarray(mapped_points(self.map, own, self.points)), self.points, own)

    def _windows(self, value: float) -> Windows:
        params = {name: jnp.asarray(one, float) for name, one in self.params.items()}
        params[self.name] = jnp.asarray(value, float)
        return Windows.of(
            self.map, self.around, params, self.noise, self.points, self.rest, self.row
        )

    def _checked(self, value: float, time: Any, visits: Any) -> tuple[Any, Any, Any]:
        """Compute the mean time and its derivative, errors, and the residuals of each cell.

        The errors are bounds on those of the mean time and of the sum of the visits, relative.
        """
        windows = self._windows(value)
        slope = {name: jnp.asarray(float(name == self.name)) for name in windows.params}
        change, by, after = map(np.asarray, changes(windows, slope, time, visits))
        left, astray = 1 + change, self.weight + after - visits
        mean = float(self.weight @ time + visits @ left)
        worst, other = float(np.abs(left).max()), float(np.abs(astray) @ time) / mean
        missing = other / (1 - worst) if worst < 1 else np.inf
        return (mean, float(visits @ by), worst * missing, missing), left, astray

    def _solved(self, value: float) -> Any:
        try:
            self._check(value)
        except ValueError:
            return None
        size = len(self.points)
        inside = np.asarray(matrix(self._windows(value)))[:size, :size]
        factor = scipy.linalg.lu_factor(np.eye(size) - inside, overwrite_a=True, check_finite=False)

        def solve(right: Any, adjoint: int) -> np.ndarray:
            return scipy.linalg.lu_solve(factor, right, adjoint, check_finite=False)

        time, visits = solve(np.ones(size), 0), solve(self.weight, 1)
        _, left, astray = self._checked(value, time, visits)
        time, visits = time + solve(left, 0), visits + solve(astray, 1)
        residual = self._checked(value, time, visits)[0][2]
        if not np.isfinite(time).all():
            return None
        if not (residual <= _MIDDLE / 10 and (time > 0).all()):
            # Other factorisations lose digits of long times.
            part = Transient.of(csr_array(inside), np.ones(size, bool))
            time = part.expect(np.empty((size, 0))).value[:, 0]
            visits = part.visited(self.weight[:, None])[0][:, 0]
        if not (np.isfinite(time).all() and (time > 0).all()):
            return None
        visits = np.maximum(visits, _LEAST * visits.max())
        return np.log(np.stack([time, visits]))


def _speed(map: Map, params: dict[str, Any], name: str, points: Any) -> np.ndarray:
    """Compute the derivative of the images of points by a parameter."""

    def image(value: Any) -> Any:
        return mapped_points(map, {**params, name: value}, points)

    return np.nan_to_num(jax.jvp(image, (float(params[name]),), (1.0,))[1], posinf=0, neginf=0)


def _interpolation(at: np.ndarray, value: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of values at nodes in the polynomial through them, and its slope."""
    shares, slopes = np.ones(at.size), np.zeros(at.size)
    for k, own in enumerate(at):
        for other in np.delete(at, k):
            slopes[k] = (slopes[k] * (value - other) + shares[k]) / (own - other)
            shares[k] *= (value - other) / (own - other)
    return shares, slopes
