import math

import numpy as np
from jaxtyping import Float, Int

from ..walls import Boundary, bump_gains, draw_places, run_to_wall
from .anywhere import AnywhereSettings, SetFollower
from .run_log import LoggedRun


# The turns toward the wall that are compared, in radians.
_BUMP_TURNS = np.radians(np.arange(-2.0, 8.01, 0.5))
# Whenever the possible places have at most this extent in metres, the turns are compared by this
# number of the following runs.
_EXTENT, _RUNS = 1.5, 3
# The number of places that are drawn from a set, and of the best ones among them. Around the best
# places, others are drawn with these standard deviations, in metres along the wall and in radians.
_DRAWN, _BEST = 1000, 10
_SPREADS = (0.03, 0.02), (0.01, 0.007), (0.003, 0.002)
# The largest error of a run that counts, in metres. A larger error means another wall.
_FAR = 0.5


def estimate_bump_turn(run: LoggedRun, settings: AnywhereSettings) -> float:
    """Estimate the angle by which a bump turns a robot, from a log of `run_anywhere`.

    Angles from -2 to 8 degrees are compared by simulation. At each bump where the robot is
    localized to 1.5 m, starts (places and headings) are drawn from its possible places. From each
    start, a simulated robot drives the next three straight runs with each of the angles. More
    starts are drawn near those with the smallest squared errors of the run lengths. The angle with
    the smallest sum of errors over all bumps is returned.

    **Returns:** the angle in radians by which a bump at 45 degrees turns the robot toward the wall;
    see [`jaxcell.space.Slip`][].

    **Raises:** `ValueError` if no three runs follow a bump where the robot is localized to 1.5 m.
    """
    follower, filter = SetFollower(settings), settings.filter
    lengths, turns, states = [], [], []
    for length, turn in follower.follow(run):
        lengths.append(math.inf if length is None else length)
        turns.append(turn or 0.0)
        states.append(follower.likeliest if follower.extent <= _EXTENT else None)
    rng = np.random.default_rng(0)
    error, windows = np.zeros(_BUMP_TURNS.size), 0
    for first, state in enumerate(states[: -_RUNS or None]):
        if state is not None:
            windows += 1
            place, heading, _ = draw_places(filter, state, 1, _DRAWN, rng)
            window = slice(first, first + _RUNS)
            error += _least_error(
                filter.boundary,
                np.tile(place, (_BUMP_TURNS.size, 1, 1)),
                np.tile(heading, (_BUMP_TURNS.size, 1)),
                turns[window],
                lengths[first + 1 : first + 1 + _RUNS],
                filter.errors.displacement / 2,
                rng,
            )
    if not windows:
        raise ValueError(
            f"the robot is never localized to {_EXTENT:g} m and then drives {_RUNS} straight runs: "
            "expected a longer run"
        )
    return float(_BUMP_TURNS[error.argmin()])


def _least_error(
    boundary: Boundary,
    place: Float[np.ndarray, "bump_turns places 2"],
    heading: Float[np.ndarray, "bump_turns places"],
    turns: list[float],
    lengths: list[float],
    back: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "bump_turns"]:
    """Search at random near the starts for the least `_squared_error` of each bump turn."""
    error = _squared_error(boundary, place, heading, turns, lengths, back)
    for along, aside in _SPREADS:
        best = np.argsort(error, axis=1)[:, :_BEST]
        place = np.take_along_axis(place, best[:, :, None], axis=1).repeat(_BEST, axis=1)
        heading = np.take_along_axis(heading, best, axis=1).repeat(_BEST, axis=1)
        tangent = boundary.tangent[_wall_at(boundary, place.reshape(-1, 2))].reshape(place.shape)
        place = place + along * rng.standard_normal(heading.shape)[:, :, None] * tangent
        heading = heading + aside * rng.standard_normal(heading.shape)
        error = _squared_error(boundary, place, heading, turns, lengths, back)
    return error.min(axis=1)


def _squared_error(
    boundary: Boundary,
    place: Float[np.ndarray, "bump_turns places 2"],
    heading: Float[np.ndarray, "bump_turns places"],
    turns: list[float],
    lengths: list[float],
    back: float,
) -> Float[np.ndarray, "bump_turns places"]:
    """Sum the squared errors of the run lengths, in m², for each bump turn and each start.

    After bump `i`, the robot backs off by `back` metres, turns `turns[i]`, and drives `lengths[i]`.
    """
    shape = heading.shape
    by_bump, place, heading = _BUMP_TURNS.repeat(shape[1]), place.reshape(-1, 2), heading.ravel()
    wall = _wall_at(boundary, place)
    error = np.zeros(by_bump.size)
    for turn, length in zip(turns, lengths, strict=True):
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        heading = heading + bump_gains(boundary, wall, heading, by_bump)[0] + turn
        wall, arc, run = run_to_wall(boundary, place - back * ahead, heading)
        place = boundary.point(wall, arc)
        error += np.minimum((run - length) ** 2, _FAR**2)
    return error.reshape(shape)


def _wall_at(boundary: Boundary, place: Float[np.ndarray, "places 2"]) -> Int[np.ndarray, "places"]:
    offset = place[:, None] - boundary.begin
    along = (offset * boundary.tangent).sum(axis=2)
    beyond = np.maximum(np.maximum(-along, along - boundary.length), 0.0)
    return np.hypot((offset * boundary.normal).sum(axis=2), beyond).argmin(axis=1)
