import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import jax
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import csr_array, diags_array

from ...base.certificate import Certificate
from ...base.quantities import derived, quantity
from ...mapping import Chain
from ...mapping.classes import reaching
from ...markov import most_probable_path
from ...markov.hitting import TOLERANCE
from ...markov.transient import Transient
from ...space.box import Box
from ..imaging import OnBox, axis_names, torn_axes
from ..maps import Flow, Map, with_params
from ..system import System
from .chains import is_law, matrix
from .deviations import is_covariance
from .diffusion import diffusion_to, regions_of
from .ends import Ends, Region, within
from .extrapolation import with_errors
from .law import Law, visits_of
from .sensitivity import LONG, Sensitivity
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
    departure: Annotated[
        Float[np.ndarray, "cells"],
        quantity("cell", "probability of the cell from which it leaves", kind="distribution"),
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
    """With `gradient`, the parameters, and `noise`, a factor of the given noise. It is called
    `noise_factor` if `noise` is a parameter."""
    derivative: Annotated[
        Float[np.ndarray, "causes"] | None, quantity("cause", "derivative of the mean time")
    ] = None
    derivative_error: Annotated[
        Float[np.ndarray, "causes"] | None, quantity("cause", "error of the derivative")
    ] = None
    elasticity: Annotated[
        Float[np.ndarray, "causes"] | None,
        quantity("cause", "percent more time for one percent more of it"),
    ] = None
    elasticity_error: Annotated[
        Float[np.ndarray, "causes"] | None, quantity("cause", "error of the elasticity")
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

    def solve(self, start: Sequence[float] | None, about: Any = None) -> dict[str, Any]:
        """Compute the fields of [`Escape`][] without errors, and the laws.

        With `about`, a map and its parameters, noise and options, also derivatives.
        """
        ends, size = self.ends, self.ends.box.size
        stops = np.arange(ends.cells) >= size
        alive = ~stops
        alive[:size] &= ends.alive if self.continuous else ends.open
        if not (can := reaching(self.matrix, stops))[alive].all():
            if ends.regions and len(ends.regions) == len(ends.names) and not ends.share.any():
                raise ValueError(
                    "into: no cell of the box is in a region where the system ends; expected a "
                    "region in the box"
                )
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
        each = visits_of(part, longest, self.continuous), longest, self.continuous
        if start is None:
            weight = np.zeros(ends.cells)
            begin = np.full(part.cells.size, 1 / part.cells.size)
            weight[alive] = Law.of(begin, *each)[0].quasi
        else:
            weight = ends.weights(start, odd=self.continuous)
        law, rough = Law.of(weight[alive], *each)
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

        visits = part.visits(weight[alive], by_entries=longest > LONG).value
        departure = np.zeros(size)
        departure[alive[:size]] = visits * (self.matrix[alive][:, size:] @ np.ones(len(ends.names)))
        derived = {}
        if about is not None:
            sensitivity = Sensitivity.of(
                ends,
                self.matrix,
                part,
                visits,
                weight[alive],
                steps,
                settled=start is None,
                continuous=self.continuous,
            )
            derived["slope"] = sensitivity.slopes(*about)
        return derived | {
            "numbers": numbers(law),
            "rough": numbers(rough),
            "time": self.duration * values[-1, :size],
            "committor": values[:-1, :size].clip(0, 1),
            "quasi_stationary": quasi,
            "departure": departure,
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


def escape(
    system: System | Map,
    box: Box | None = None,
    params: Any = None,
    *,
    noise: float | Array | np.ndarray | tuple[float | Array, ...] | Callable[..., Any],
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
        For a map with two axes it may be a covariance matrix.
    - `start`: the coordinates of the start; by default the start is distributed as in the long run
        among the systems that have not left, the quasi-stationary distribution.
    - `into`: a region where the system ends, or several by their names, as in
        [`jaxcell.dynamics.diffusion`][].
    - `out_of`: a region that the system leaves. Cells of attractors and basins are regions:
        `basins.attractor_cells[0]`, `basins.basin == 0`.
    - `gradient`: whether to differentiate the mean time by each parameter and the noise.
    - `labels`: names of the axes.
    - `options`: further options of [`jaxcell.dynamics.chain`][] for maps.

    **Returns:** an [`Escape`][]. Its numbers are extrapolated to cells without width, from the box
    and from cells of 1.5 and 2 times the width, if these show that errors fall with the square of
    the width. Then each error is the correction, and at least half of the difference to the widest
    cells; otherwise it is this difference. With a distribution function as noise, whose cells may
    be the states themselves, nothing is extrapolated, and the error is the difference to a chain
    with points from cells of three times the width. Errors include that of the law, whose number of
    modes is limited. Numbers per cell are those of the box.

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
    for path, value in jax.tree_util.tree_leaves_with_path(params):
        if np.isnan(value).any():
            name = jax.tree_util.keystr(path, simple=True)
            raise ValueError(f"params: {name}: expected a number, got {value}")
    map, ends = posed(system, box, into, out_of)
    box, continuous = ends.box, isinstance(map, Flow)
    if start is not None:
        start = tuple(float(one) for one in start)
        ends.weights(start, odd=continuous)
    if isinstance(map, Flow):
        if options:
            raise ValueError(f"options: a flow has none, got {', '.join(options)}")
    else:
        torn_axes(map, box, [params])
    # The cells of a discrete distribution may be the states themselves.
    discrete = is_law(noise) and not continuous
    levels = (ends,) if discrete else ends.levels
    if gradient and (discrete or is_covariance(noise)):
        raise ValueError(
            "gradient: there is none by a distribution function or a covariance matrix; expected "
            "standard deviations as noise"
        )
    about = map, params, noise, options
    chains = [_chain_of(*about, each) for each in levels]
    if discrete:
        chains.append(_chain_of(*about, ends, second=True))
    whole, *_ = chains
    solved, *others = (one.solve(start, about if gradient else None) for one in chains)
    Certificate(0, solved["residual"], TOLERANCE).check("escape", True)
    values = with_errors([solved, *others], [each.box for each in levels])
    kept = "time", "committor", "quasi_stationary", "departure", "residual"
    fields = {name: solved[name] for name in kept}
    if gradient:
        error = values.pop("slope_error")
        named = _scalars(params)
        named["noise" if "noise" not in named else "noise_factor"] = 1.0
        elasticity = np.array(list(named.values()))
        # Slopes may be infinite where a parameter is 0.
        with np.errstate(invalid="ignore"):
            values |= {
                "elasticity": values.pop("slope") * elasticity,
                "elasticity_error": error * np.abs(elasticity),
            }
        fields["cause"] = tuple(named)
    return Escape(
        box=box,
        continuous=continuous,
        end=_named(ends.names, axis_names(box, labels)),
        start=start,
        labels=labels,
        path=whole.path(solved["weight"]),
        **{name: _plain(value) for name, value in values.items()},
        **fields,
    )


def posed(
    system: System | Map, box: Box | None, into: Any, out_of: Region | None
) -> tuple[Map, Ends]:
    """Return the map and the ends of a question about [`escape`][]."""
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
    return map, ends


def _plain(value: Any) -> Any:
    return value if np.ndim(value) else float(value)


def _chain_of(
    map: Any, params: Any, noise: Any, options: Any, ends: Ends, second: bool = False
) -> _Stopped:
    if isinstance(map, Flow):
        found = diffusion_to(map, ends, params, noise)
        return _Stopped(ends, found.chain.to_scipy(), float(found.duration), True)
    about = {"noise": noise, "onto": ends.around, "second": second, **options}
    rows = matrix(map, ends.box, params, finite=ends.open, **about)
    return _Stopped(ends, ends.stopped(rows), 1.0, False)


def _named(ends: tuple[str, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """Replace the numbers of axes in the names of sides by their names."""
    sides = {
        f"{side} x{k}": f"{side} {n}" for k, n in enumerate(names) for side in ("below", "above")
    }
    return tuple(sides.get(name, name) for name in ends)


def _scalars(params: Any) -> dict[str, float]:
    """Return the parameters that are single numbers, by their names."""
    known = {} if params is None else params
    return {
        jax.tree_util.keystr(path, simple=True): float(value)
        for path, value in jax.tree_util.tree_leaves_with_path(known)
        if np.ndim(value) == 0
    }
