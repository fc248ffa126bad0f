"""The interval transform: a JAX program becomes a program that encloses its values on a box.

The program is traced, and each of its primitives is replaced by a rule for intervals. The result is
a JAX program, too: `jax.vmap` batches boxes, and `jax.jit` compiles it.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal, jaxpr_as_fun
from jaxtyping import Array, Float, Num

from ...base.precision import require_x64
from ..maps import Map
from ..sines import without_polynomials
from . import functions, interval
from .interval import LINE, ONE, Interval, hull, point, where


def enclose(
    map: Map,
    params: Any,
    lower: Num[Array | np.ndarray, "axes"],
    upper: Num[Array | np.ndarray, "axes"],
    *,
    mean_value: bool = True,
) -> tuple[Float[Array, "axes"], Float[Array, "axes"]]:
    """Enclose the image of a box under a map, with outward rounding.

    The result encloses the images that the program of the map would have in real arithmetic. Points
    whose image is not a real number, such as the logarithm of a negative number, have no image.

    **Arguments:** a map, its parameters, and the corners of a box, which are widened to 64 bits. If
    `mean_value` is true, the image is intersected with that of the mean value theorem,
    `f(centre) + f'(box) (box - centre)`, which is much smaller for small boxes. The theorem is not
    used if a comparison in the program may be true at some points of the box and false at others.

    Raises `ValueError` for a corner that is NaN, or above the upper corner; under `jit` and `vmap`,
    where corners have no values, the image is NaN. Raises `RuntimeError` if JAX traces it with 32
    bits.

    **Returns:** the lower and upper corners of the image. They have no derivatives, because they
    are rounded by their bits: a derivative of `enclose` raises `ValueError`.

    The sine has a crest in this interval:

        >>> import math
        >>> import jax.numpy as jnp
        >>> import numpy as np
        >>> from jaxcell import dynamics
        >>> lower, upper = dynamics.enclose(
        ...     lambda x, p: jnp.sin(x), None, np.array([1.0]), np.array([2.0])
        ... )
        >>> float(upper[0]), abs(float(lower[0]) - math.sin(1.0)) < 1e-14
        (1.0, True)
    """

    require_x64("enclose")
    lower, upper = boxes(lower, upper)
    if lower.ndim != 1:
        raise ValueError(f"box: expected corners [axes], got shape {list(lower.shape)}")

    def function(x):  # type: ignore[no-untyped-def]
        return jnp.asarray(map(x, params))

    def program(function: Callable[..., Any]) -> ClosedJaxpr:
        traced = without_polynomials(jax.make_jaxpr(function)(lower))
        return traced.replace(consts=jax.tree.map(_constant, traced.consts))

    lower, upper, params = jax.tree.map(_constant, (lower, upper, params))
    box, decided = Interval(lower, upper), [jnp.array(True)]
    traced = program(function)
    (image,) = evaluate(traced, [box], decided)
    if mean_value:
        # Any point of the box may be its centre.
        centre = point(jnp.clip(lower / 2 + upper / 2, lower, upper))
        plain = jaxpr_as_fun(traced)
        (nearer,) = evaluate(traced, [centre], [])
        for axis in range(lower.size):
            along = jnp.zeros_like(lower).at[axis].set(1.0)

            def slope(x, along=along):  # type: ignore[no-untyped-def]
                return jax.jvp(plain, (x,), (along,))[1][0]

            try:
                (column,) = evaluate(program(slope), [box], [])
            except ValueError as error:
                raise ValueError(
                    f"{error}; this is in its derivative, which Intervals(map, mean_value=False) "
                    "does not use"
                ) from None
            away = interval.sub(*(Interval(a.lower[axis], a.upper[axis]) for a in (box, centre)))
            nearer = interval.add(nearer, interval.mul(column, away))
        smooth = functools.reduce(jnp.logical_and, decided)
        nearer = where(smooth, nearer, LINE)
        image = Interval(
            jnp.maximum(image.lower, nearer.lower), jnp.minimum(image.upper, nearer.upper)
        )
    valid = jnp.all(lower <= upper)
    return jnp.where(valid, image.lower, jnp.nan), jnp.where(valid, image.upper, jnp.nan)


def boxes(lower: Any, upper: Any) -> tuple[Any, Any]:
    """Return corners of boxes as 64-bit numbers, after a check unless JAX traces them."""
    if any(isinstance(corner, jax.core.Tracer) for corner in (lower, upper)):
        lower, upper = jnp.asarray(lower, jnp.float64), jnp.asarray(upper, jnp.float64)
    else:
        lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
        if lower.shape == upper.shape and not (lower <= upper).all():
            row = tuple(np.argwhere(~(lower <= upper))[0])
            raise ValueError(
                f"box: expected a lower corner below the upper one, got {lower[row]} and "
                f"{upper[row]} in coordinate {row[-1] if row else 0}"
            )
    if lower.shape != upper.shape:
        raise ValueError(
            f"box: expected corners of one shape, got {list(lower.shape)} and {list(upper.shape)}"
        )
    return lower, upper


def evaluate(program: ClosedJaxpr, values: list[Any], decided: list[Any]) -> list[Any]:
    """Evaluate a program with intervals as its floating-point arguments.

    Floating-point results are intervals, as are other results that may vary within the intervals.
    For each comparison, a mask is appended to `decided`: `False` where its result may vary.
    """
    inner = program.jaxpr
    known = dict(zip(inner.constvars, (_exact(value) for value in program.consts), strict=True))
    known |= zip(inner.invars, values, strict=True)
    for step in inner.eqns:
        arguments = [
            _exact(atom.val) if isinstance(atom, Literal) else known[atom] for atom in step.invars
        ]
        known |= zip(step.outvars, _results(step, arguments, decided), strict=True)
    return [
        _exact(atom.val) if isinstance(atom, Literal) else known[atom] for atom in inner.outvars
    ]


@jax.custom_jvp
def _constant(value: Any) -> Any:
    """Return a number whose derivative raises, instead of the zero that rounding would give."""
    return value


@_constant.defjvp
def _refused(_: Any, __: Any) -> Any:
    raise ValueError(
        "enclose: expected no derivative; its results are rounded outward, which has none. "
        "Differentiate the map itself, or take differences of enclosures"
    )


def _exact(value: Any) -> Any:
    return point(value) if jnp.issubdtype(jnp.result_type(value), jnp.floating) else value


def _results(step: JaxprEqn, values: list[Any], decided: list[Any]) -> list[Any]:
    name, params = step.primitive.name, step.params
    inner: Any = params.get("jaxpr", params.get("call_jaxpr"))
    if name == "scan":
        return _scan(step, values, decided)
    if name == "cond":
        return _cond(step, values, decided)
    if name in _OWN_DERIVATIVE:
        decided.append(jnp.array(False))
    if name in _CALLS:
        inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
        return evaluate(inner, values, decided)
    outputs: list[Any] = [variable.aval for variable in step.outvars]
    kinds = [value.dtype for value in outputs]
    floating = any(jnp.issubdtype(kind, jnp.floating) for kind in kinds)
    if any(jnp.issubdtype(kind, jnp.floating) and kind != jnp.float64 for kind in kinds):
        raise ValueError(f"map: expected numbers of float64, got {kinds[0]} from {name}")
    certain = not any(isinstance(value, Interval) for value in values)
    if certain and (name in _EXACT or not floating):
        results = step.primitive.bind(*values, **params)
        results = results if step.primitive.multiple_results else [results]
        return [_exact(result) for result in results]
    integers = any(jnp.issubdtype(kind, jnp.integer) for kind in kinds)
    if name in _RULES and (name == "select_n" or not integers):
        return [_RULES[name](step, decided, *values)]
    if name in _ENDS and not (name in _BY_INDEX and any(map(_uncertain_index, values))):
        return _of_ends(step, values, decided)
    raise ValueError(
        f"map: the primitive {name} of JAX has no rule for intervals"
        f"{' of uncertain whole numbers' if integers or name in _BY_INDEX else ''}; write the map "
        "with other functions, or take images of points, dynamics.Corners(map), which prove nothing"
    )


def _interval(value: Any) -> Interval:
    """Convert a value to an interval, which is a single point if the value is certain."""
    return value if isinstance(value, Interval) else Interval(value, value)


def _uncertain_index(value: Any) -> bool:
    return isinstance(value, Interval) and jnp.issubdtype(value.lower.dtype, jnp.integer)


def _of_ends(step: JaxprEqn, values: list[Any], decided: list[Any]) -> list[Any]:
    """Enclose an operation that increases with each argument, from its results for the ends."""

    def at(ends: list[Any]) -> list[Any]:
        results = step.primitive.bind(*ends, **step.params)
        return list(results) if step.primitive.multiple_results else [results]

    intervals = [*map(_interval, values)]
    lower = at([a.lower for a in intervals])
    points = all(a.lower is a.upper for a in intervals)
    upper = lower if points else at([a.upper for a in intervals])
    name, results = step.primitive.name, [*map(Interval, lower, upper)]
    if name in _STEPS:
        decided += [jnp.all(a.lower == a.upper) for a in results]
    elif name in ("max", "min"):
        a, b = values
        decided.append(jnp.all((a.lower >= b.upper) | (b.lower >= a.upper)))
    elif name == "gather":
        # Places outside are filled with NaN.
        return [interval.unless(jnp.isnan(a.lower), a) for a in results]
    return results


def _scan(step: JaxprEqn, values: list[Any], decided: list[Any]) -> list[Any]:
    params = step.params
    if "ft_in" in params:  # JAX 0.12 and newer
        constants, carries, _ = map(len, params["ft_in"].unpack())
    else:
        constants, carries = params["num_consts"], params["num_carry"]
    fixed, varying = values[:constants], values[constants:]
    first, rows = varying[:carries], varying[carries:]

    def body(state, row):  # type: ignore[no-untyped-def]
        carry, known = state
        here = [known]
        results = evaluate(params["jaxpr"], [*fixed, *carry, *row], here)
        kept = zip(results[:carries], carry, strict=True)
        if any(isinstance(a, Interval) > isinstance(b, Interval) for a, b in kept):
            raise ValueError("map: a loop keeps the result of a comparison that is not certain")
        known = functools.reduce(jnp.logical_and, here)
        return (results[:carries], known), results[carries:]

    state = jax.tree.map(jnp.asarray, (first, True))
    options = {"length": params["length"], "reverse": params["reverse"]}
    (last, known), stacked = jax.lax.scan(body, state, rows, **options)
    decided.append(known)
    return [*last, *stacked]


def _cond(step: JaxprEqn, values: list[Any], decided: list[Any]) -> list[Any]:
    index, *operands = values
    low, high = _interval(index)
    decided.append(low == high)
    branches = [evaluate(branch, operands, decided) for branch in step.params["branches"]]
    results = []
    for ends in zip(*branches, strict=True):
        parts = [*map(_interval, ends)]
        result = where(high == 0, parts[0], parts[-1])
        for k, part in enumerate(parts):
            # The first possible branch is alone, and further ones extend it.
            possible = (low <= k) & (k <= high)
            result = where(possible, where(low == k, part, hull([result, part])), result)
        results.append(result)
    return results


def _select(_: Any, decided: list[Any], which: Any, *values: Any) -> Interval:
    cases = [*map(_interval, values)]
    if not isinstance(which, Interval):
        ends = (jax.lax.select_n(which, *(case[k] for case in cases)) for k in (0, 1))
        return Interval(*ends)
    decided.append(jnp.all(which.lower == which.upper))
    either = where(which.lower, cases[1], hull(cases))
    return where(which.upper, either, cases[0])


def _equal(a: Interval, b: Interval) -> Interval:
    surely = (a.lower == b.upper) & (a.upper == b.lower)
    return Interval(surely, (a.lower <= b.upper) & (b.lower <= a.upper))


def _less(a: Interval, b: Interval) -> Interval:
    return Interval(a.upper < b.lower, a.lower < b.upper)


def _not(a: Interval) -> Interval:
    return Interval(~a.upper, ~a.lower)


def _absolute(_: Any, decided: list[Any], a: Interval) -> Interval:
    decided.append(jnp.all((a.lower >= 0) | (a.upper <= 0)))
    return interval.absolute(a)


def _remainder(_: Any, decided: list[Any], a: Interval, b: Interval) -> Interval:
    """Enclose the remainder, whose sign is that of `a`."""
    turns = Interval(*(jnp.trunc(x) for x in interval.div(a, b)))
    known = (turns.lower == turns.upper) & jnp.isfinite(turns.lower)
    decided.append(jnp.all(known))
    turn = jnp.where(known, turns.lower, 0.0)
    rest = interval.sub(a, interval.mul(Interval(turn, turn), b))
    most = interval.absolute(b).upper
    low, high = jnp.where(a.lower < 0, -most, 0.0), jnp.where(a.upper > 0, most, 0.0)
    return where(
        known,
        Interval(jnp.clip(rest.lower, low, high), jnp.clip(rest.upper, low, high)),
        Interval(low, high),
    )


def _sum(step: JaxprEqn, _: Any, a: Interval) -> Interval:
    for axis in sorted(step.params["axes"], reverse=True):
        a = interval.total(a, int(axis))
    return a


def _dot(step: JaxprEqn, _: Any, a: Interval, b: Interval) -> Interval:
    """Enclose `dot_general`: a product of arrays that are broadcast, then summed over some axes."""
    summed, batch = step.params["dimension_numbers"]
    sides = []
    for k, value in enumerate((a, b)):
        free = [n for n in range(value.lower.ndim) if n not in (*summed[k], *batch[k])]
        order, sizes = [*batch[k], *free, *summed[k]], value.lower.shape
        shape = [sizes[n] for n in batch[k]] + [1] * 2 + [-1]
        shape[len(batch[k]) + k] = functools.reduce(int.__mul__, (sizes[n] for n in free), 1)
        shape[-1] = functools.reduce(int.__mul__, (sizes[n] for n in summed[k]), 1)
        sides.append(Interval(*(x.transpose(order).reshape(shape) for x in value)))
    whole = interval.total(interval.mul(*sides), len(batch[0]) + 2)
    output: Any = step.outvars[0].aval
    return Interval(*(x.reshape(output.shape) for x in whole))


def _plain(function: Callable[..., Interval]) -> Callable[..., Interval]:
    """Adapt a function of intervals to the arguments of rules: `step`, `decided` and values."""
    return lambda _, __, *values: function(*map(_interval, values))


_PLAIN: dict[str, Callable[..., Interval]] = {
    "add": interval.add,
    "add_any": interval.add,
    "cos": functions.cos,
    "cosh": functions.cosh,
    "div": interval.div,
    "eq": _equal,
    "exp": functions.exp,
    "expm1": lambda a: interval.sub(functions.exp(a), ONE),
    "ge": lambda a, b: _not(_less(a, b)),
    "gt": lambda a, b: _less(b, a),
    "le": lambda a, b: _not(_less(b, a)),
    "log": functions.log,
    "log1p": lambda a: functions.log(interval.add(a, ONE)),
    "logistic": functions.logistic,
    "lt": _less,
    "ne": lambda a, b: _not(_equal(a, b)),
    "neg": interval.neg,
    "not": _not,
    "one_minus_square": lambda a: interval.sub(ONE, interval.square(a)),
    "pow": functions.power,
    "rsqrt": lambda a: interval.div(ONE, interval.sqrt(a)),
    "sin": functions.sin,
    "sinh": functions.sinh,
    "sqrt": interval.sqrt,
    "square": interval.square,
    "sub": interval.sub,
    "tan": lambda a: interval.div(functions.sin(a), functions.cos(a)),
    "tanh": functions.tanh,
}
_RULES: dict[str, Callable[..., Interval]] = {
    **{name: _plain(rule) for name, rule in _PLAIN.items()},
    "abs": _absolute,
    "convert_element_type": lambda step, decided, a: _of_ends(step, [a], decided)[0],
    "dot_general": _dot,
    "integer_pow": lambda step, _, a: interval.power(a, step.params["y"]),
    "mul": lambda _, __, a, b: interval.square(a) if a is b else interval.mul(a, b),
    "reduce_sum": _sum,
    "rem": _remainder,
    "select_n": _select,
}
# Primitives that grow with each argument, or only move numbers; whole numbers are exact.
_STEPS = {"ceil", "clamp", "convert_element_type", "floor", "round", "sign"}
_STEPS |= {"reduce_max", "reduce_min"}
_BY_INDEX = {"dynamic_slice", "dynamic_update_slice", "gather", "scatter"}
_ENDS = _STEPS | {
    *("and", "broadcast_in_dim", "concatenate", "copy", "copy_p", "dynamic_slice"),
    *("dynamic_update_slice", "expand_dims", "gather", "max", "min", "or", "pad", "reshape"),
    *("rev", "scatter", "slice", "split", "squeeze", "stack", "stop_gradient", "transpose"),
    "unstack",
}
# Primitives whose floating-point results are exact for whole numbers.
_EXACT = {"convert_element_type", "iota"}
# Calls whose derivative need not be that of their values: the mean value theorem is not applied.
_OWN_DERIVATIVE = {"custom_jvp_call", "custom_vjp_call", "stop_gradient"}
_CALLS = {
    *("checkpoint", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit"),
    *("pjit", "remat", "remat2"),
}
