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
        names = escape.names[0] if len(escape.names) == 1 else f"({', '.join(escape.names)})"
        last = [f"{x:.3g}" for x in escape.path[-1]]
        place = last[0] if len(last) == 1 else f"({', '.join(last)})"
        sentences.append(f"The most probable path ends with a mapping from {names} = {place}.")
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
