"""Sentences that say how long a noisy system stays, and where it leaves."""

from typing import Any

import numpy as np


def answer_of(escape: Any) -> tuple[str, ...]:
    """Describe an [`Escape`][jaxcell.dynamics.Escape]."""
    early, middle, late = (_number(time) for time in escape.within)
    error = _number(escape.mean_time_error)
    unit = "time units" if escape.continuous else "mappings"
    sentences = [
        f"It stays {_about(escape.mean_time, escape.mean_time_error)} {unit} on average "
        f"(error {error}). 5 % of the runs leave before {early}, half before {middle}, and 5 % "
        f"stay longer than {late}."
    ]
    if len(escape.end) > 1:
        order = np.argsort(-escape.probability, kind="stable")
        seen = [k for k in order[:4] if escape.probability[k] >= 0.0005]
        shares = [f"{escape.end[k]} {escape.probability[k]:.1%}" for k in seen]
        sentences.append(f"It leaves to: {', '.join(shares)}.")
    if not escape.continuous:
        places = [
            f"{name} = {low:.3g} to {high:.3g}"
            for name, (low, high) in zip(escape.names, _usual(escape), strict=True)
        ]
        last = ", ".join(f"{x:.3g}" for x in escape.path[-1])
        sentences.append(
            f"90 % of the runs leave from {', '.join(places)}; the most probable path, from {last}."
        )
    if escape.elasticity is not None:
        order = np.argsort(-np.abs(escape.elasticity), kind="stable")
        each = [
            f"1 % more {escape.cause[k]}: {abs(escape.elasticity[k]):.2g} % "
            f"{'more' if escape.elasticity[k] > 0 else 'less'} time"
            for k in order[:4]
        ]
        sentences.append(f"{'; '.join(each)}.")
    return tuple(sentences)


def _number(value: float) -> str:
    return f"{value:.2g}" if abs(value) < 10 else f"{value:.3g}"


def _about(value: float, error: float) -> str:
    """Write a number with the digits that its error leaves."""
    if not 0 < error < value < np.inf:
        return _number(value)
    digits = int(np.clip(np.ceil(np.log10(value / error)) + 1, 2, 6))
    return f"{value:.{digits}g}"


def _usual(escape: Any) -> list[np.ndarray]:
    """Return, for each axis, the 5 % and 95 % quantiles of the place from which a system leaves."""
    share = escape.departure.reshape(escape.box.cells)
    ranges = []
    for axis in range(share.ndim):
        along = share.sum(axis=tuple(k for k in range(share.ndim) if k != axis)).cumsum()
        at = np.searchsorted(along, [0.05 * along[-1], 0.95 * along[-1]])
        ranges.append(escape.box.ticks(axis)[at])
    return ranges
