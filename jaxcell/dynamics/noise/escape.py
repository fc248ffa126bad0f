import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import csr_array, diags_array

from ...base.certificate import Certificate
from ...base.quantities import derived, quantity
from ...mapping import Chain
from ...mapping.classes import reaching
from ...markov import hitting_times, most_probable_path
from ...markov.hitting import TOLERANCE
from ...markov.transient import Transient
from ...space.box import Box
from ..imaging import OnBox, axis_names
from ..maps import Flow, Map, with_params
from ..system import System
from .chains import chain, matrices
from .deviations import listed
from .diffusion import diffusion_to, regions_of
from .ends import Ends, Region, within
from .law import Law
from .words import answer_of


# The probabilities of the quantiles.
SHARES = 0.05, 0.5, 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class Escape(OnBox):
    """The time that a noisy system stays in a region, and where it leaves."""

    title: ClassVar[str] = "Time until a noisy system leaves"
    leading: ClassVar[tuple[str, ...]] = ("mean_time", "mean_time_error")
    tables: ClassVar[Mapping[str, str]] = {
        "share": "quantiles",
        "end": "ends",
        "cause": "elasticities",
    }
    picture: ClassVar[str] = "logarithm"

    box: Box
    continuous: bool
    "`True` for noise in continuous time; `False` for noise once per mapping."
    mean_time: Annotated[float, quantity("", "mean time until it leaves", kind="time")]
    mean_time_error: Annotated[float, quantity("", "its error", kind="time")]
    deviation: Annotated[float, quantity("", "standard deviation of the time", kind="time")]
    deviation_error: Annotated[float, quantity("", "error of the standard deviation", kind="time")]
    rate: Annotated[float, quantity("", "rate at which it leaves in the long run")]
    """The rate per unit of time, or the probability per mapping, with which a system leaves that
    has stayed for long: the decay rate of the quasi-stationary distribution."""
    rate_error: Annotated[float, quantity("", "error of the rate")]
    within: Annotated[
        Float[np.ndarray, "shares"],
        quantity("share", "time within which this share leaves", kind="time"),
    ]
    within_error: Annotated[
        Float[np.ndarray, "shares"], quantity("share", "error of this time", kind="time")
    ]
    end: Annotated[tuple[str, ...], quantity("end", "end", kind="text")]
    "The names of the ends: regions, and sides of the box."
    probability: Annotated[
        Float[np.ndarray, "ends"], quantity("end", "probability of this end", kind="share")
    ]
    probability_error: Annotated[
        Float[np.ndarray, "ends"], quantity("end", "error of the probability")
    ]
    time: Annotated[
        Float[np.ndarray, "cells"], quantity("cell", "mean time from the cell", kind="time")
    ]
    committor: Annotated[
        Float[np.ndarray, "ends cells"],
        quantity("end cell", "probability of the end from the cell", kind="share"),
    ]
    quasi_stationary: Annotated[
        Float[np.ndarray, "cells"],
        quantity("cell", "probability of the cell after a long stay", kind="distribution"),
    ]
    path: Annotated[
        Float[np.ndarray, "points axes"], quantity("point axis", "most probable path to the end")
    ]
    """The path with the largest product of probabilities, of steps that leave a cell, from the
    start to an end: the one that nearly all runs follow if noise is small."""
    residual: Annotated[
        float, quantity("", "bound on the relative error of the solver", kind="residual")
    ]
    start: tuple[float, ...] | None = None
    "The start; `None` for the quasi-stationary distribution."
    cause: Annotated[tuple[str, ...] | None, quantity("cause", "parameter", kind="text")] = None
    "The parameters, and the noise, with `gradient`."
    derivative: Annotated[
        Float[np.ndarray, "causes"] | None, quantity("cause", "derivative of the mean time")
    ] = None
    elasticity: Annotated[
        Float[np.ndarray, "causes"] | None,
        quantity("cause", "percent more time for one percent more of it"),
    ] = None
    labels: tuple[str, ...] = ()
    "The names of the axes. Without names, the axes are called `x0`, `x1`, ..."

    @derived("share", "share of runs", "1", kind="coordinate")
    def share(self) -> Float[np.ndarray, "shares"]:
        return np.array(SHARES)

    @derived("cell", "decimal logarithm of the mean time from the cell")
    def logarithm(self) -> Float[np.ndarray, "cells"]:
        return np.log10(np.where(self.time > 0, self.time, np.nan))

    @property
    def answer(self) -> tuple[str, ...]:
        return answer_of(self)

    @property
    def remarks(self) -> tuple[str, ...]:
        if not self.mean_time_error <= 0.1 * self.mean_time:
            return (
                "The error is more than a tenth of the mean time: take more cells, or cells that "
                "are smaller than the distance over which noise and drift balance.",
            )
        return ()


@dataclasses.dataclass(frozen=True, eq=False)
class _Stopped:
    """A chain that stops at its ends, with its solution."""

    ends: Ends
    matrix: csr_array
    duration: float
    continuous: bool

    def solve(self, start: Sequence[float] | None) -> dict[str, Any]:
        """Compute the fields of [`Escape`][] without errors, and the laws."""
        ends, size = self.ends, self.ends.box.size
        stops = np.arange(ends.cells) >= size
        alive = ~stops
        alive[:size] &= self._open
        if not (can := reaching(self.matrix, stops))[alive].all():
            raise ValueError(
                f"into: cannot be reached from {np.count_nonzero(alive & ~can)} of "
                f"{np.count_nonzero(alive)} cells, so that times are infinite; expected more noise "
                "or fewer cells outside of all basins"
            )
        part = Transient.of(self.matrix, alive)
        solved = part.expect(self.matrix[alive][:, size:].toarray())
        steps = solved.value[:, -1]
        values = np.zeros((len(ends.names) + 1, ends.cells))
        values[:-1, size:] = np.eye(len(ends.names))
        values[:, alive] = solved.value.T
        longest = float(steps.max())
        about = longest, self.continuous
        if start is None:
            weight = np.zeros(ends.cells)
            begin = np.full(part.cells.size, 1 / part.cells.size)
            weight[alive] = Law.of(part, begin, *about)[0].quasi
        else:
            weight = ends.weights(start, odd=self.continuous)
        law, rough = Law.of(part, weight[alive], *about)
        # In units of the longest time, because squares may be too large for 64 bits.
        second = 2 * weight[alive] @ part.expect(steps[:, None] / longest).value[:, 0] / longest
        mean = float(weight @ values[-1])
        part_of = mean / longest
        variance = second - part_of**2 - (0 if self.continuous else part_of / longest)
        quasi = np.zeros(size)
        quasi[alive[:size]] = law.quasi

        def numbers(law: Law) -> dict[str, Any]:
            return {
                "mean_time": self.duration * mean,
                "deviation": self.duration * longest * max(variance, 0.0) ** 0.5,
                "rate": law.rate / self.duration,
                "within": self.duration * np.array([law.quantile(share) for share in SHARES]),
                "probability": (values[:-1] @ weight).clip(0, 1),
            }

        return {
            "numbers": numbers(law),
            "rough": numbers(rough),
            "time": self.duration * values[-1, :size],
            "committor": values[:-1, :size].clip(0, 1),
            "quasi_stationary": quasi,
            "residual": float(solved.relative[:, -1].max(initial=0.0)),
            "weight": weight,
        }

    def path(self, weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "points axes"]:
        """Find the most probable path from the likeliest cell of a start to an end."""
        size = self.ends.box.size
        moves = csr_array(self.matrix - diags_array(self.matrix.diagonal()))
        moves.eliminate_zeros()
        each = moves @ np.ones(self.ends.cells)
        moves = csr_array(diags_array(1 / np.where(each > 0, each, 1)) @ moves)
        cells, _ = most_probable_path(
            Chain.from_scipy(moves), int(weight.argmax()), np.arange(size, self.ends.cells)
        )
        return self.ends.box.centre(cells[:-1].astype(np.int32))

    @property
    def _open(self) -> np.ndarray:
        """A mask of the cells that are not completely in a region."""
        if self.continuous:
            return self.ends.alive
        return self.ends.shares().sum(axis=0) < 1


def escape(
    system: System | Map,
    box: Box | None = None,
    params: Any = None,
    *,
    noise: float | Array | tuple[float | Array, ...] | Callable[..., Any],
    start: Sequence[float | int] | np.ndarray | None = None,
    into: Mapping[str, Region] | Region | None = None,
    out_of: Region | None = None,
    gradient: bool = False,
    labels: tuple[str, ...] = (),
    **options: Any,
) -> Escape:
    """Compute how long a noisy system stays, and where it leaves.

    The system ends in a region, outside of a region, or at a side of the box that is a sink,
    whichever comes first. It runs on the host.

    A [`jaxcell.dynamics.flow`][] has noise in continuous time, `dX = f(X) dt + s dW`, and its chain
    is a [`jaxcell.dynamics.diffusion`][]. Any other map has normal noise once per mapping, and its
    chain is a [`jaxcell.dynamics.chain`][]. Times are in units of time, or in mappings.

    **Arguments:**

    - `system`: a [`System`][jaxcell.dynamics.System], or a flow or a map with its `box`.
    - `box`, `params`: replace those of the system.
    - `noise`: the standard deviation of the noise, one number, one per axis, or a function of the
        state and the parameters: per square root of time for a flow, otherwise per mapping.
    - `start`: the coordinates of the start; by default the start is distributed as in the long run
        among the systems that have not left, the quasi-stationary distribution.
    - `into`: a region where the system ends, or several by their names, as in
        [`jaxcell.dynamics.diffusion`][].
    - `out_of`: a region that the system leaves. Cells of attractors and basins are regions:
        `basins.attractor_cells[0]`, `basins.basin == 0`.
    - `gradient`: whether to differentiate the mean time by each parameter and the noise.
    - `labels`: names of the axes.
    - `options`: further options of [`jaxcell.dynamics.chain`][] for maps.

    **Returns:** an [`Escape`][]. Each error is the difference to the result with cells of twice the
    width for flows, and three times the width for maps, whose chain also has half of the samples
    and the tail of the noise. It includes that of the law, whose number of modes is limited.

    A particle in the left one of two wells:

        >>> from jaxcell import dynamics, space
        >>> well = dynamics.flow(lambda x, p: x - x**3, dt=0.05)
        >>> box = space.Box([-3], [1], cells=[200], axes="clamp")
        >>> left = dynamics.escape(
        ...     well, box, noise=0.4, start=[-1], into=lambda x: x[:, 0] >= 0
        ... )
        >>> round(left.mean_time, 1), left.mean_time_error < 0.1
        (57.5, True)
    """
    if isinstance(system, System):
        params = dict(system.params) if params is None else params
        labels = labels or system.labels
    map, regions, ends = posed(system, box, into, out_of)
    box, continuous = ends.box, isinstance(map, Flow)
    if start is not None:
        start = tuple(float(one) for one in start)
        ends.weights(start, odd=continuous)
    if isinstance(map, Flow):
        if options:
            raise ValueError(f"options: a flow has none, got {', '.join(options)}")
        half = Box(box.lower, box.upper, [max(2, n // 2) for n in box.cells], box.axes)
        # Cells of a region are those of the finer box.
        same = {name: within(region, box, name) for name, region in regions.items()}
        whole, coarse = (
            _diffused(map, each, params, noise) for each in (ends, Ends.of(half, same))
        )
    else:
        both = matrices(map, box, params, noise=noise, **options)[:2]
        whole, coarse = (_Stopped(ends, ends.stopped(rows), 1.0, False) for rows in both)
    solved, other = whole.solve(start), coarse.solve(start)
    Certificate(0, solved["residual"], TOLERANCE).check("escape", True)
    values, errors = solved["numbers"], _errors(solved, other["numbers"])
    causes: dict[str, Any] = {}
    if gradient:
        about = solved["weight"], values["mean_time"], options
        causes = _elasticities(map, ends, params, noise, *about)
    fields = {name: solved[name] for name in ("time", "committor", "quasi_stationary", "residual")}
    return Escape(
        box=box,
        continuous=continuous,
        end=_named(ends.names, axis_names(box, labels)),
        start=start,
        labels=labels,
        path=whole.path(solved["weight"]),
        **{name: _plain(value) for name, value in {**values, **errors}.items()},
        **fields,
        **causes,
    )


def posed(
    system: System | Map, box: Box | None, into: Any, out_of: Region | None
) -> tuple[Map, dict[str, Any], Ends]:
    """Return the map, the regions and the ends of a question about [`escape`][]."""
    map: Map = system.map if isinstance(system, System) else with_params(system, 2, "map")
    if box is None and isinstance(system, System):
        box = system.box
    if box is None:
        raise ValueError("box: expected a box for a map")
    regions = regions_of(into, box)
    if out_of is not None:
        inside = within(out_of, box, "out_of")
        regions["outside"] = lambda points: ~inside(points)
    ends = Ends.of(box, regions, sides=isinstance(map, Flow))
    if not ends.names:
        raise ValueError(
            "into: expected a region where the system ends, or a box with an axis that is a sink"
        )
    if not ends.alive.any():
        raise ValueError(
            "into: the centre of every cell is in a region where the system ends; expected a box "
            "with cells outside of all regions"
        )
    return map, regions, ends


def _plain(value: Any) -> Any:
    return value if np.ndim(value) else float(value)


def _errors(solved: Mapping[str, Any], moved: Mapping[str, Any]) -> dict[str, Any]:
    """Estimate the error of each number from a coarser chain, fewer modes, and the solver.

    The difference of a single number may vanish by chance, so that all times have at least the
    largest relative error among the mean, the deviation and the rate, and so have probabilities
    `p`, relative to `p (1 - p)`.
    """
    values, rough, residual = solved["numbers"], solved["rough"], solved["residual"]
    errors = {
        name: abs(value - moved[name]) + abs(value - rough[name]) + residual * value
        for name, value in values.items()
    }
    known = [name for name in ("mean_time", "deviation", "rate") if values[name] > 0]
    least = max(errors[name] / values[name] for name in known)
    for name, value in values.items():
        scale = value * (1 - value) if name == "probability" else value
        errors[name] = np.maximum(errors[name], least * scale)
    return {f"{name}_error": error for name, error in errors.items()}


def _diffused(map: Flow, ends: Ends, params: Any, noise: Any) -> _Stopped:
    found = diffusion_to(map, ends, params, noise)
    return _Stopped(ends, found.chain.to_scipy(), float(found.duration), True)


def _named(ends: tuple[str, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """Replace the numbers of axes in the names of sides by their names."""
    sides = {
        f"{side} x{k}": f"{side} {n}" for k, n in enumerate(names) for side in ("below", "above")
    }
    return tuple(sides.get(name, name) for name in ends)


@dataclasses.dataclass(frozen=True)
class _OfBoth:
    """A function of a point and of pairs of parameters and a factor of the noise."""

    function: Callable[..., Any]
    noisy: bool

    def __call__(self, x: Any, both: Any) -> Any:
        value = jnp.asarray(self.function(x, both[0]))
        return both[1] * value if self.noisy else value


def _elasticities(
    map: Any, ends: Ends, params: Any, noise: Any, weight: np.ndarray, time: float, options: Any
) -> dict[str, Any]:
    """Differentiate the mean time by each parameter and by a factor of the noise."""
    size, stops = ends.box.size, np.arange(ends.cells) >= ends.box.size
    own = _OfBoth(map.field if isinstance(map, Flow) else map, False)
    function = _OfBoth(with_params(noise, 2, "noise"), True) if callable(noise) else None

    def mean_time(both: Any) -> Any:
        noisy: Any = function
        if function is None:
            noisy = tuple(both[1] * one for one in listed(noise, ends.box.dimensions))
        duration: Any = 1.0
        if isinstance(map, Flow):
            one = diffusion_to(own, ends, both, noisy)
            stopped, duration = one.chain, one.duration
        else:
            rows = chain(own, ends.box, both, noise=noisy, **options)
            share = ends.shares()
            matrix = rows.probability.T
            out = [rows.leaving[:, None]] * (len(ends.names) - len(share))
            upper = jnp.hstack([matrix * (1 - share.sum(axis=0))[None], matrix @ share.T, *out])
            lower = np.eye(ends.cells)[size:]
            stopped = Chain.from_scipy(jnp.vstack([upper, lower]))
        steps = hitting_times(stopped, stops, throw=False).value
        return duration * (steps @ weight)

    known = {} if params is None else params
    slope, by_noise = jax.grad(mean_time)((jax.tree.map(jnp.asarray, known), jnp.asarray(1.0)))
    named = {
        jax.tree_util.keystr(path, simple=True): (value, jax.tree.leaves(slope)[k])
        for k, (path, value) in enumerate(jax.tree_util.tree_leaves_with_path(known))
    }
    each = {n: (v, s) for n, (v, s) in named.items() if np.ndim(v) == 0}
    derivative = np.array([float(s) for _, s in each.values()] + [float(by_noise)])
    value = np.array([float(v) for v, _ in each.values()] + [1.0])
    return {
        "cause": (*each, "noise"),
        "derivative": derivative,
        "elasticity": derivative * value / time,
    }
