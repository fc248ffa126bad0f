from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...currents.component import FASTEST_CURRENT
from ...currents.sphere import EARTH_RADIUS, on_sphere


# The largest error of a position by satellite, in metres.
_POSITION_ERROR = 1000.0


def possible_observations(
    lon: Float[np.ndarray, "observations"],
    lat: Float[np.ndarray, "observations"],
    time: Float[np.ndarray, "observations"],
    drifter: Int[np.ndarray, "observations"],
    fastest: float | int = FASTEST_CURRENT,
) -> Bool[np.ndarray, "observations"]:
    """Mark the observations that each drifter can pass in turn, at `fastest` (m/s) or slower.

    Observations that rest at exactly 0 N 0 E are fixes without satellites, also of a drifter that
    never had another fix. In the others, impossible moves cut a track into pieces. The longest
    piece is kept, and of the pieces before and after it those that the nearest kept piece reaches,
    from the observation that it reaches on.
    Observations are sorted by drifter and time.
    """
    null = (lon == 0) & (lat == 0)
    rests = null[:-1] & null[1:] & (np.diff(drifter) == 0)
    kept = ~(np.append(rests, False) | np.append(False, rests))[: null.size]
    kept[kept] = _passable(fastest, *(column[kept] for column in (lon, lat, time, drifter)))
    return kept


def _passable(
    fastest: float | int,
    lon: Float[np.ndarray, "observations"],
    lat: Float[np.ndarray, "observations"],
    time: Float[np.ndarray, "observations"],
    drifter: Int[np.ndarray, "observations"],
) -> Bool[np.ndarray, "observations"]:
    place = on_sphere(lon, lat)

    def reaches(i: Any, j: Any) -> Any:
        chord = np.linalg.norm(place[:, i] - place[:, j], axis=0)
        metres = 2 * EARTH_RADIUS * np.arcsin((chord / 2).clip(max=1))
        return metres <= fastest * np.abs(time[i] - time[j]) + _POSITION_ERROR

    index = np.arange(time.size)
    cut = (np.diff(drifter) == 0) & ~reaches(index[:-1], index[1:])
    kept = np.ones(time.size, bool)
    for owner in np.unique(drifter[:-1][cut]):
        begin, end = np.searchsorted(drifter, [owner, owner + 1])
        pieces = np.split(index[begin:end], np.flatnonzero(cut[begin : end - 1]) + 1)
        kept[begin:end] = False
        longest = max(range(len(pieces)), key=lambda k: pieces[k].size)
        for pieces_on in (pieces[longest:], [piece[::-1] for piece in pieces[longest::-1]]):
            last = pieces_on[0][0]
            for piece in pieces_on:
                # Two fixes in a few seconds are apart by their errors only.
                if (reached := reaches(np.full_like(piece, last), piece)).any():
                    kept[piece[reached.argmax() :]], last = True, piece[-1]
    return kept
