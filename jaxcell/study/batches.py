"""Batches of members of a sweep: one program of JAX computes the numbers of many studies."""

import operator
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from ..base.quantities import Quantity, Result, quantities, quantity
from .study import Wanted, every, scalars


if TYPE_CHECKING:
    import numpy as np


# Smallest number of members for which a program is faster than single runs, and the largest one of
# a batch.
_LEAST, _MOST = 8, 256

Numbers: TypeAlias = "dict[str, tuple[Quantity, np.ndarray]]"
Program: TypeAlias = Callable[..., tuple[Any, dict[str, Any]]]


def compiled(single: Callable[..., Result], names: tuple[str, ...]) -> Program:
    """Compile a function of one member for many members.

    **Arguments:** a function that JAX can trace, of arguments that members share and of a number
    per parameter of its own; and names of quantities of its result, or of derivatives, such as
    `d_distance_d_reliability`. **Returns:** a function of the shared arguments and of an array per
    parameter. It returns whether all certificates of each member hold, and an array per name.
    """
    import jax
    import jax.numpy as jnp

    from ..base.certificate import Certificate

    def values(own: dict[str, Any], shared: Any) -> Any:
        result = single(*shared, **own)
        parts = jax.tree.leaves(result, is_leaf=lambda part: isinstance(part, Certificate))
        sure = [part.converged for part in parts if isinstance(part, Certificate)]
        every = ((name, getattr(result, name)) for name in quantities(type(result)) if used(name))
        numbers = {name: jnp.asarray(value) for name, value in every if value is not None}
        smooth = {k: v for k, v in numbers.items() if jnp.issubdtype(v.dtype, jnp.floating)}
        return smooth, (jnp.stack(sure).all(), numbers)

    def used(name: str) -> bool:
        return name in names or any(one.startswith(f"d_{name}_d_") for one in names)

    def one(shared: Any, own: dict[str, Any]) -> Any:
        if not any(name.startswith("d_") for name in names):
            return values(own, shared)[1]
        slopes, (sure, numbers) = jax.jacfwd(values, has_aux=True)(own, shared)
        for name, by_parameter in slopes.items():
            for parameter, slope in by_parameter.items():
                finite = jnp.isfinite(numbers[name])
                numbers[f"d_{name}_d_{parameter}"] = jnp.where(finite, slope, jnp.nan)
        return sure, {name: number for name, number in numbers.items() if name in names}

    program = jax.jit(jax.vmap(one, (None, 0)))
    return lambda *shared, **own: program(shared, own)


def numbers_of(
    kind: type[Result],
    program: Callable[[tuple[str, ...]], Program],
    alone: Callable[..., Result],
    columns: "Mapping[str, np.ndarray]",
    wanted: Wanted,
) -> Numbers:
    """Compute the wanted quantities of members that are single numbers, and their derivatives.

    A derivative by a parameter of `columns`, `d_quantity_d_parameter`, is computed only if it is
    wanted by its name.

    A program is compiled once per number of members, so batches are powers of two, and the last
    member fills one. It cannot raise an error, so members whose certificates do not hold are
    computed alone, and so are a few members.

    **Arguments:** the class of results; a function that compiles a program of the parameters for
    the names of quantities, see [`compiled`][]; a function that computes the result of one member;
    and the parameters of all members.
    """
    import jax
    import numpy as np

    columns = {name: column.astype(float) for name, column in columns.items()}

    def of_one(i: int) -> dict[str, Any]:
        return scalars(alone(**{name: one[i].item() for name, one in columns.items()}), (), wanted)

    count = len(next(iter(columns.values())))
    described = {name: about for name, about in quantities(kind).items() if not about.dims}
    slopes = {
        f"d_{name}_d_{parameter}": quantity(
            "", f"derivative of the {about.meaning}, by the {parameter}", about.units
        )
        for name, about in described.items()
        for parameter in (columns if wanted is not every else ())
    }
    if count < _LEAST and not any(map(wanted, slopes)):
        each = [of_one(i) for i in range(count)]
        return {
            k: (about, np.stack([one[k][1] for one in each])) for k, (about, _) in each[0].items()
        }
    described |= slopes
    compute = program((*filter(wanted, described),))
    found = []
    for start in range(0, count, _MOST):
        size = min(_MOST, count - start)
        rows = start + np.minimum(np.arange(1 << (size - 1).bit_length()), size - 1)
        with jax.enable_x64(True):
            batch = jax.device_get(compute(**{name: one[rows] for name, one in columns.items()}))
        found.append(jax.tree.map(operator.itemgetter(slice(size)), batch))
    sure, numbers = jax.tree.map(lambda *parts: np.concatenate(parts), *found)
    # The numbers of a program have 32 bits where those of a single result have 64.
    numbers = {name: x.astype(int) if x.dtype.kind == "i" else x for name, x in numbers.items()}
    for i in np.flatnonzero(~sure).tolist():
        for name, (_, value) in of_one(i).items():
            numbers[name][i] = value
    return {name: (described[name], column) for name, column in numbers.items()}
