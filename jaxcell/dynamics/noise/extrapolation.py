"""Numbers of a chain, extrapolated to cells without width, and their errors."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...space.box import Box


@np.errstate(invalid="ignore")
def with_errors(solutions: Sequence[Mapping[str, Any]], boxes: Sequence[Box]) -> dict[str, Any]:
    """Extrapolate each number to cells without width, and estimate its error.

    `solutions` are those of `boxes`, the finest first. Logarithms are extrapolated, because times
    grow exponentially. The order is seen if the extrapolations from the two finer and from the two
    coarser boxes differ less than the first one from the number. Then the error is the correction,
    and at least half of the difference to the last box. Otherwise, or with fewer than three boxes,
    the number is that of the finest box, and the error its difference to the last solution. It
    includes the error of fewer modes.

    The difference of a single number may vanish by chance, so that all times have at least the
    largest relative error among the mean, the deviation and the rate, and probabilities `p` at
    least the largest relative difference to the last box among these, relative to `p (1 - p)`.
    Slopes cross zero, so that no other error bounds theirs: it is at least the whole difference.
    They may be infinite.
    """
    solved, last = solutions[0], solutions[-1]
    values, rough, residual = solved["numbers"], solved["rough"], solved["residual"]
    widths = [float((boxes[0].size / box.size) ** (1 / box.dimensions)) for box in boxes]
    gains = [1 / ((b / a) ** 2 - 1) if b > a else 0.0 for a, b in itertools.pairwise(widths)]

    def corrected(each: list[Any]) -> tuple[Any, Any]:
        """Return the correction, and whether the order is seen."""
        if len(each) < 3:
            return 0 * each[0], False
        a, b, c = each
        first, second = gains[0] * (a - b), gains[1] * (b - c)
        return first, np.abs(a + first - b - second) < np.abs(first)

    # Times are corrected together.
    _, together = corrected([np.log(one["numbers"]["mean_time"]) for one in solutions])
    found, errors = dict[str, Any](), dict[str, Any]()
    for name, value in values.items():
        every = [np.asarray(one["numbers"][name], float) for one in solutions]
        known = np.all([one > 0 for one in every], axis=0)
        shift, own = corrected([np.log(np.where(known, one, 1.0)) for one in every])
        seen = own if name == "probability" else together
        with np.errstate(over="ignore"):
            found[name] = value * np.exp(np.where(seen, shift, 0.0))
        correction, far = np.abs(found[name] - value), np.abs(value - every[-1])
        errors[name] = np.where(seen & known, np.maximum(correction, far / 2), far)
        errors[name] = errors[name] + np.abs(value - rough[name]) + residual * value
    if "probability" in found:
        found["probability"] = found["probability"] / found["probability"].sum()
    known = [name for name in ("mean_time", "deviation", "rate") if values.get(name, 0) > 0]
    least = max(errors[name] / found[name] for name in known)
    moved = max(abs(1 - last["numbers"][name] / values[name]) for name in known)
    for name, value in found.items():
        scale = moved * value * (1 - value) if name == "probability" else least * value
        errors[name] = np.maximum(errors[name], scale)
    if "slope" in solved:
        slope = solved["slope"]
        shift, far = corrected([one["slope"] for one in solutions])[0], abs(slope - last["slope"])
        found["slope"] = slope + np.where(together, shift, 0.0)
        errors["slope"] = np.where(together, np.maximum(np.abs(shift), far), far)
        # The derivative is the product of the slope, of the logarithm, and the mean time.
        mean, error = found["mean_time"], errors["mean_time"]
        found["derivative"] = found["slope"] * mean
        errors["derivative"] = errors["slope"] * mean + np.abs(found["slope"]) * error
    return found | {f"{name}_error": error for name, error in errors.items()}
