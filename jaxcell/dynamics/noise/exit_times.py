import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.linalg
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from ...base import memory
from ...base.formatting import did_you_mean
from ...base.precision import require_x64
from ...base.process import one_blas_thread
from ...base.shown import Shown
from ...markov.transient import Transient
from ...space.box import Box
from ..imaging import mapped_points
from ..maps import Flow, Map
from ..system import System
from .chains import sampled
from .deviations import listed
from .ends import Region
from .escape import escape, posed
from .windows import Windows, changes, matrix


# Number of values between which solutions are interpolated.
_NODES = 8
# Distance of these values: so far, images move by this share of the deviation of the noise.
_MOVES = 1 / 12
# Numbers of times that it is halved where the residual is too large.
_LEVELS = range(5)
# Largest residual of a member, and in the middle of an interval in which it is interpolated.
_TOLERANCE, _MIDDLE = 1e-7, 2e-8
# Smaller numbers of visits, relative to the largest one, are rounding.
_LEAST = 1e-16


@dataclasses.dataclass(frozen=True, eq=False)
class ExitTimes(Shown):
    """Mean times that a noisy system stays, along values of a parameter."""

    mean_time: Float[np.ndarray, "members"]
    derivative: Float[np.ndarray, "members"]
    "The derivative of the mean time by the parameter."
    residual: Float[np.ndarray, "members"]
    """A bound on the relative error of the mean time, for given probabilities: the product of the
    relative residuals of times and of visits."""
    alone: Bool[np.ndarray, "members"]
    "The members that [`escape`][] computed, because their residual was above 1e-7."
    solved: int
    "The number of chains between which solutions were interpolated."


def exit_times(
    system: System,
    name: str,
    values: npt.ArrayLike,
    *,
    noise: float | tuple[float, ...],
    start: Sequence[float | int] | np.ndarray,
    into: Mapping[str, Region] | Region | None = None,
    out_of: Region | None = None,
) -> ExitTimes:
    """Compute the mean time that a noisy system stays, for many values of a parameter.

    The times are those of [`escape`][] for a map with noise once per mapping. Chains are solved
    only at values on a lattice. In between, the logarithms of times and of visits to cells are
    interpolated. Every member has a chain of its own, with which residuals are computed: if `r` is
    what is missing in the equation of the interpolated times, the visits times `r` correct the mean
    time to second order. The derivative is that of the corrected time (Schweitzer 1968). The
    lattice depends on the speed of the images in the parameter, relative to the noise, and is
    refined where residuals are large. So a member does not depend on the others.

    **Arguments:**

    - `system`: a map that is not a flow, with a box and parameters.
    - `name`, `values`: a parameter of the system, and its values.
    - `noise`, `start`, `into`, `out_of`: as in [`escape`][]; the noise is not 0 along any axis.

    **Returns:** an [`ExitTimes`][].

    A particle that jumps between two wells:

        >>> import numpy as np
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([-2], [2], cells=[60], axes="clamp")
        >>> well = dynamics.System(lambda x, p: x + 0.3 * (p["a"] * x - x**3), box, {"a": 1.0})
        >>> found = dynamics.exit_times(
        ...     well, "a", np.linspace(1, 1.2, 30),
        ...     noise=0.2, start=[-1], into=lambda x: x[:, 0] > 0,
        ... )
        >>> found.mean_time[[0, -1]].round(1).tolist(), int(found.alone.sum())
        ([358.7, 1309.9], 0)
    """
    values = np.asarray(values, float)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError("values: expected finite numbers, one for each member")
    about: dict[str, Any] = {"noise": noise, "start": start, "into": into, "out_of": out_of}
    family = Family.of(system, name, **about)
    found = [family.at(value) for value in values.tolist()]
    alone = np.array([one is None for one in found], bool)
    for k in np.flatnonzero(alone):
        own = {**system.params, name: float(values[k])}
        one = escape(system, params=own, gradient=True, **about)
        slopes = dict(zip(one.cause or (), np.asarray(one.derivative).tolist(), strict=True))
        found[k] = one.mean_time, slopes[name], one.residual
    mean, slope, residual = np.array(found, float).reshape(-1, 3).T
    return ExitTimes(mean, slope, residual, alone, len(family.nodes))


@dataclasses.dataclass(frozen=True, eq=False)
class Family:
    """The chains of a noisy map along a parameter, with the solutions of some of them."""

    map: Map
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
    width: float
    "The distance of the nodes of the coarsest lattice."
    nodes: dict[float, Any] = dataclasses.field(default_factory=dict)
    "Logarithms of the times and of the visits, keyed by the value of the parameter."
    levels: dict[tuple[int, int], bool] = dataclasses.field(default_factory=dict)
    "Flags of the intervals in which solutions are interpolated, keyed by level and number."

    @classmethod
    def of(
        cls, system: System, name: str, noise: Any, start: Any, into: Any, out_of: Any
    ) -> "Family":
        """Raise `ValueError` for wrong arguments, and choose the lattice."""
        require_x64("exit times")
        map, _, ends = posed(system, None, into, out_of)
        box, params = ends.box, dict(system.params)
        if isinstance(map, Flow):
            raise ValueError("system: expected a map with noise once per mapping, got a flow")
        if name not in params:
            meant = did_you_mean(name, params)
            raise ValueError(f"name: expected one of {', '.join(params)}, got {name!r}{meant}")
        each = np.array(listed(noise, box.dimensions), float)
        if each.shape != (box.dimensions,) or not (np.isfinite(each) & (each > 0)).all():
            raise ValueError(f"noise: expected {box.dimensions} numbers above 0, got {noise}")
        memory.check(32 * box.size**2, f"exit times of {box.size} cells", "use fewer cells")
        alive = ends.open
        points = sampled(box, np.flatnonzero(alive).astype(np.int32))
        weight = ends.weights([float(one) for one in start], odd=False)[: box.size][alive]
        rest = (1 - ends.share.sum(axis=0)) * alive[ends.nearest]
        row = np.maximum(np.cumsum(alive) - 1, 0)[ends.nearest]
        speed = _speed(map, params, name, points) / each
        width = _MOVES / (float(np.sqrt((speed**2).mean())) or 1.0)
        width = 2.0 ** np.floor(np.log2(width))
        return cls(map, ends.around, params, name, each, points, weight, rest, row, width)

    @one_blas_thread()
    def at(self, value: float) -> tuple[float, float, float] | None:
        """Compute the mean time, its derivative and the residual; `None` if it is too large."""
        for level in _LEVELS:
            width = self.width / 2**level
            cell = int(np.floor(value / width))
            if (level, cell) not in self.levels:
                middle = self._between((cell + 0.5) * width, cell, width)
                self.levels[level, cell] = middle is not None and middle[2] <= _MIDDLE
            if self.levels[level, cell]:
                found = self._between(value, cell, width)
                return found if found is not None and found[2] <= _TOLERANCE else None
        return None

    def _between(self, value: float, cell: int, width: float) -> tuple[float, float, float] | None:
        """Interpolate between the nodes around an interval of the lattice, and check."""
        at = np.array([(cell + k) * width for k in range(1 - _NODES // 2, 1 + _NODES // 2)])
        solved = [self._node(one) for one in at.tolist()]
        if any(one is None for one in solved):
            return None
        share, slope = _interpolation(at, value)
        # Of times and visits: values, and derivatives by the parameter.
        each = np.stack(solved, axis=-1)
        both = np.exp(each @ share)
        moves = both * (each @ slope)
        (mean, by, residual), left, astray = self._checked(value, *both)
        # The mean time with the first correction, and its derivative along the interpolation.
        return mean, by + float(moves[1] @ left + astray @ moves[0]), residual

    def _node(self, value: float) -> Any:
        """Solve the chain of a value; `None` if it cannot be solved."""
        if value not in self.nodes:
            self.nodes[value] = self._solved(value)
        return self.nodes[value]

    def _windows(self, value: float) -> Windows:
        params = {name: jnp.asarray(one, float) for name, one in self.params.items()}
        params[self.name] = jnp.asarray(value, float)
        return Windows.of(
            self.map, self.around, params, self.noise, self.points, self.rest, self.row
        )

    def _checked(self, value: float, time: Any, visits: Any) -> tuple[Any, Any, Any]:
        """Compute the mean time, derivative and residual, and the residual of each cell."""
        windows = self._windows(value)
        slope = {name: jnp.asarray(float(name == self.name)) for name in windows.params}
        change, by, after = map(np.asarray, changes(windows, slope, time, visits))
        left, astray = 1 + change, self.weight + after - visits
        mean = float(self.weight @ time + visits @ left)
        worst, other = float(np.abs(left).max()), float(np.abs(astray) @ time) / mean
        residual = worst * other / (1 - worst) if worst < 1 else np.inf
        return (mean, float(visits @ by), residual), left, astray

    def _solved(self, value: float) -> Any:
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

    return np.nan_to_num(jax.jvp(image, (float(params[name]),), (1.0,))[1])


def _interpolation(at: np.ndarray, value: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of values at nodes in the polynomial through them, and its slope."""
    shares, slopes = np.ones(at.size), np.zeros(at.size)
    for k, own in enumerate(at):
        for other in np.delete(at, k):
            slopes[k] = (slopes[k] * (value - other) + shares[k]) / (own - other)
            shares[k] *= (value - other) / (own - other)
    return shares, slopes
