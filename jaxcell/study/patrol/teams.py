"""The policies of the robots of the study `PatrolMap`."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ... import optimize, patrol
from ...base.limits import MAX_VERTICES
from ..study import Say
from .patrol_map import PatrolMap


# The shares among which "auto" chooses.
_SHARES = (0.0, 0.2, 0.5, 0.8)
MAX_ROBOTS = 20
"""Largest number of robots that `robots="auto"` tries."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Team:
    """The policies of robots; the fields are those of `PatrolledMap`."""

    policies: "tuple[patrol.map.Policy, ...]"
    least: float
    "The least probability of capture over the cells, for the first of the attack times."
    search: "patrol.map.CaptureSearch | None" = None
    share: Float[np.ndarray, "shares"] | None = None
    share_capture: Float[np.ndarray, "shares"] | None = None
    chosen_share: float | None = None


def find_team(
    study: PatrolMap,
    graph: optimize.Graph,
    visible: Bool[np.ndarray, "cells cells"],
    regions: "patrol.map.Regions | None",
    attack: patrol.Attack,
    say: Say,
) -> tuple[Team, Float[np.ndarray, "sizes"] | None]:
    """Find the robots of a study, or the fewest robots that reach its `capture`.

    **Returns:** the team; and with `capture`, the least probability of capture by each team.
    """
    most = min(MAX_ROBOTS, graph.vertices) if study.robots == "auto" else study.robots
    find: Callable[[int], Team]
    if study.strategy == "capture":
        find = functools.partial(_searched, study, graph, visible, attack, say)
    else:
        find = _commuting(study, graph, visible, regions, attack, most, say)
    if study.capture is None:
        return find(most), None
    reached: list[float] = []
    for robots in range(1, most + 1):
        team = find(robots)
        reached.append(team.least)
        say(f"a team of {robots} captures {team.least:.3f} at least")
        if team.least >= study.capture:
            break
    return team, np.array(reached)


def _searched(
    study: PatrolMap,
    graph: optimize.Graph,
    visible: Bool[np.ndarray, "cells cells"],
    attack: patrol.Attack,
    say: Say,
    robots: int,
) -> Team:
    """Search for the robots that capture most."""
    say(f"searching for the patrol of {robots} robots that captures most")
    options: Any = {
        "randomness": study.randomness,
        "starts": study.initial_walks,
        "seed": study.seed,
    }
    search = patrol.capture_policies(graph, visible, robots, attack, say=say, **options)
    return Team(policies=search.policies, least=search.value, search=search)


def _commuting(
    study: PatrolMap,
    graph: optimize.Graph,
    visible: Bool[np.ndarray, "cells cells"],
    regions: "patrol.map.Regions | None",
    attack: patrol.Attack,
    most: int,
    say: Say,
) -> Callable[[int], Team]:
    """Make policies for `most` robots; return a function that finds a team of the first of them.

    The policies have different shares of steps on tours, among which the study chooses.
    """
    shares = _SHARES if study.share == "auto" else tuple(sorted({0.0, study.share}))
    if graph.vertices > MAX_VERTICES:
        # One search takes a minute or more.
        shares = (0.0,) if study.share == "auto" else (study.share,)
    made = []
    for share in shares:
        say(f"making policies for {most} robots, with a share of {share:g}")
        if regions is None:
            made.append(patrol.distributed_policies(graph, visible, most, share))
        else:
            made.append(patrol.map.centralized_policies(graph, visible, regions, share))

    def team_of(robots: int) -> Team:
        teams = [policies[:robots] for policies in made]
        captures = [
            patrol.Capture.of(graph, visible, team, attack.first, regions) for team in teams
        ]
        least = np.array([capture.least[0] for capture in captures])
        # Captures that differ by rounding count as equal; the first of them is taken.
        auto = int(np.argmax(np.round(least, 9)))
        best = auto if study.share == "auto" else shares.index(study.share)
        return Team(
            policies=teams[best],
            least=float(least[best]),
            share=np.array(shares),
            share_capture=least,
            chosen_share=shares[best],
        )

    return team_of
