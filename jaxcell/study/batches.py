"""Batches of members of a sweep: one program of JAX computes the numbers of many studies."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from ..base.quantities import Quantity, Result, quantities, quantity
from .study import Wanted, every, scalars


if TYPE_CHECKING:
    import numpy as np


# Number of members in a call of a program. It reaches the rounding, so that all calls have it.
_BLOCK = 16

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
    inner: "np.ndarray",
) -> Numbers:
    """Compute the wanted quantities of members that are single numbers, and their derivatives.

    A derivative by a parameter of `columns`, `d_quantity_d_parameter`, is computed only if it is
    wanted by its name.

    A program computes blocks of one size, which the last member fills, so that the numbers of a
    member do not depend on the others. It cannot raise an error, so members whose certificates do
    not hold are computed alone.

    **Arguments:** the class of results; a function that compiles a program of the parameters for
    the names of quantities, see [`compiled`][]; a function that computes the result of one member;
    the parameters of all members; and which members the program computes. Others, whose parameters
    are at an edge, are computed alone; their derivatives are NaN.
    """
    import jax
    import numpy as np

    columns = {name: column.astype(float) for name, column in columns.items()}
    described = {name: about for name, about in quantities(kind).items() if not about.dims}
    slopes = {
        f"d_{name}_d_{parameter}": (
            name,
            quantity("", f"derivative of the {about.meaning}, by the {parameter}", about.units),
        )
        for name, about in described.items()
        for parameter in (columns if wanted is not every else ())
        if wanted(f"d_{name}_d_{parameter}")
    }
    bases = {name for name, _ in slopes.values()}

    def of_one(i: int) -> dict[str, Any]:
        own = {name: one[i].item() for name, one in columns.items()}
        found = scalars(alone(**own), (), lambda name: wanted(name) or name in bases)
        numbers = {name: value for name, (_, value) in found.items() if wanted(name)}
        smooth = {name for name, (_, value) in found.items() if value.dtype.kind == "f"}
        return numbers | {name: np.nan for name, (base, _) in slopes.items() if base in smooth}

    described |= {name: about for name, (_, about) in slopes.items()}
    compute = program((*filter(wanted, described),))
    numbers: dict[str, np.ndarray] = {}

    def fill(rows: Any, found: Mapping[str, Any]) -> None:
        for name, value in found.items():
            # The numbers of a program have 32 bits where those of a single result have 64.
            kind = {"i": int, "f": float}.get(np.asarray(value).dtype.kind, bool)
            numbers.setdefault(name, np.empty(inner.size, kind))[rows] = value

    places, sure = np.flatnonzero(inner), inner.copy()
    for start in range(0, places.size, _BLOCK):
        rows = places[start : start + _BLOCK]
        block = np.append(rows, np.repeat(rows[-1:], _BLOCK - rows.size))
        with jax.enable_x64(True):
            given = {name: one[block] for name, one in columns.items()}
            sure[rows], found = jax.tree.map(
                lambda part, count=rows.size: part[:count], jax.device_get(compute(**given))
            )
        fill(rows, found)
    for i in np.flatnonzero(~sure).tolist():
        fill(i, of_one(i))
    return {name: (described[name], column) for name, column in numbers.items()}


def stacked(found: Sequence[Numbers], which: "np.ndarray") -> Numbers:
    """Give each member the numbers of one of several results; NaN where that has none.

    **Arguments:** the numbers of each result, and the index of the result of each member.
    """
    import numpy as np

    described = {name: about for one in found for name, (about, _) in one.items()}
    missing = {name: (about, np.asarray(np.nan)) for name, about in described.items()}
    whole = [missing | dict(one) for one in found]
    return {
        name: (about, np.stack([one[name][1] for one in whole])[which])
        for name, about in described.items()
    }
