from collections.abc import Callable
from typing import Any


# Of the way to the nearest bound, so that weights stay positive.
_SHORT_OF_THE_BOUND = 0.99


def predictor_corrector(
    inverse: Callable[[Any], Any],
    gain: Any,
    sums: Any,
    totals: Any,
    live: Any,
    point: tuple[Any, Any, Any],
) -> tuple[Any, Any, Any]:
    """One step of Mehrotra's predictor and corrector, on arrays of NumPy or of JAX.

    It goes towards `gain + pressure = sums prices`, `sums' weights = totals` and `weights pressure
    = 0`, and keeps weights and pressures positive.

    **Arguments:**

    - `inverse`: divides by the Hessian with `pressure / weights` on its diagonal.
    - `gain`: array `[weights]`, by how much each weight lowers what is to be least.
    - `sums`: array `[weights, prices]`, which weights each bound sums.
    - `totals`: array `[prices]`, what these sums are to be.
    - `live`: boolean array `[weights]`; the others stay 0.
    - `point`: the weights, their pressures, and the prices of the bounds.

    **Returns:** the next point.
    """
    weights, pressure, prices = point
    xp = weights.__array_namespace__()
    safe = xp.where(live, weights, 1.0)
    residual = xp.where(live, sums @ prices - gain - pressure, 0.0)
    missing = totals - sums.T @ weights
    moved = inverse(sums)
    small = sums.T @ moved

    def solve(aim):  # type: ignore[no-untyped-def]
        along = inverse(aim / safe - residual)
        d_prices = xp.linalg.solve(small, sums.T @ along - missing)
        d_weights = along - moved @ d_prices
        return d_weights, (aim - pressure * d_weights) / safe, d_prices

    def length(d_weights, d_pressure):  # type: ignore[no-untyped-def]
        """The longest step, of at most 1, after which nothing is negative."""
        shrink = xp.where(live, xp.maximum(-d_weights / safe, -d_pressure / pressure), 0.0)
        return 1 / xp.maximum(1.0, xp.max(shrink))

    product = weights * pressure
    count = xp.sum(live, dtype=float)
    mean = xp.sum(product) / count
    d_weights, d_pressure, _ = solve(-product)
    ahead = length(d_weights, d_pressure)
    after = (weights + ahead * d_weights) @ (pressure + ahead * d_pressure) / count
    centre = (after / mean) ** 3 * mean
    aim = xp.where(live, centre - product - d_weights * d_pressure, 0.0)
    d_weights, d_pressure, d_prices = solve(aim)
    ahead = _SHORT_OF_THE_BOUND * length(d_weights, d_pressure)
    return weights + ahead * d_weights, pressure + ahead * d_pressure, prices + ahead * d_prices
