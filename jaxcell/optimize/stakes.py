import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from ..base.divided import put_on_device
from ..base.shown import Shown
from ..base.wide import namespace


@dataclasses.dataclass(frozen=True, eq=False)
class Stakes(Shown):
    """The gains and losses of patroller and adversary at each vertex (Alam 2018, section 4.3.2)."""

    values: Float[np.ndarray, "vertices"] | None = None
    "The value of the goods to the patroller, `d_pat`; by default `1 / n` at each of `n` vertices."
    adversary_values: Float[np.ndarray, "vertices"] | None = None
    "The value of the goods to the adversary, `d_adv`; by default equal to `values`."
    rewards: Float[np.ndarray, "vertices"] | None = None
    "The gain of the patroller from a capture, `c_pat`; for its default see [`payoffs`][]."
    costs: Float[np.ndarray, "vertices"] | None = None
    "The penalty of a captured adversary, `c_adv`; for its default see [`payoffs`][]."


def payoffs(
    order: Int[Any, "strategies vertices"], stakes: Stakes | None = None
) -> tuple[Float[Array, "strategies vertices"], Float[Array, "strategies vertices"]]:
    """Compute the payoffs of a patroller and of an adversary that attacks a vertex (Alg. 4.2).

    A strategy of the patroller captures the adversary at its `k`-th closest of `n` vertices with
    probability `1 / 2**(k - 1)`, as in Table 4.2 of Alam 2018; the printed Alg. 4.2 has another
    exponent. After a capture the patroller gains the reward, by default `n - k + 1`, and the
    adversary pays the cost. The default cost `-k`, as in the source, is a gain. If the patroller
    fails, each gains its value of the goods there.

    **Arguments:** for each strategy, the vertices in ascending order of their mean hitting times,
    which may be traced; and the gains and losses at each vertex, by default as in Alg. 4.2.
    **Returns:** the payoffs of the patroller and of the adversary, for [`stackelberg`][].

    Two strategies, the first closest to vertex 0, the second closest to vertex 1:

        >>> import numpy as np
        >>> from jaxcell import optimize
        >>> patroller, adversary = optimize.payoffs(np.array([[0, 1], [1, 0]]))
        >>> patroller.tolist(), adversary.tolist()
        ([[2.0, 0.75], [0.75, 2.0]], [[1.0, 1.25], [1.25, 1.0]])
    """
    vertices = order.shape[1]
    if order.size == 0:
        raise ValueError(f"order: expected at least one strategy and vertex, got {order.shape}")
    xp = namespace(order)
    for strategy, row in enumerate(order) if xp is np else ():
        if not np.array_equal(np.sort(row), np.arange(vertices)):
            raise ValueError(
                f"order[{strategy}]: expected each vertex from 0 to {vertices - 1} once, got "
                f"{row.tolist()}"
            )
    given = {} if stakes is None else {k: v for k, v in vars(stakes).items() if v is not None}
    for name, numbers in given.items():
        if numbers.shape != (vertices,) or not np.isfinite(numbers).all():
            raise ValueError(
                f"{name}: expected {vertices} finite numbers, one per vertex, got {numbers}"
            )
    given = {name: numbers[None] for name, numbers in given.items()}
    place = xp.argsort(order, axis=1).astype(float)
    caught = 0.5**place
    goods = given.get("values", np.full((1, vertices), 1 / vertices))
    patroller = caught * given.get("rewards", vertices - place) + (1 - caught) * goods
    paid = -given["costs"] if "costs" in given else place + 1
    adversary = caught * paid + (1 - caught) * given.get("adversary_values", goods)
    return put_on_device((patroller, adversary))
