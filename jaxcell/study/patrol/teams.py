"""The policies of the robots of the study `PatrolMap`."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ... import optimize, patrol
from ...base.limits import MAX_VERTICES
from ..study import Say, silent
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


def teams_at_times(
    study: PatrolMap,
    graph: optimize.Graph,
    visible: Bool[np.ndarray, "cells cells"],
    regions: "patrol.map.Regions | None",
    times: Sequence[int],
) -> "list[tuple[Team, patrol.Capture]]":
    """Find the robots of studies that differ in a single attack time, and what they capture."""
    robots = int(study.robots)
    made = _at_shares(study, graph, visible, regions, robots, silent)
    attack = patrol.Attack(times, study.distribution)
    captures = [patrol.Capture.of(graph, visible, team, attack, regions) for team in made.values()]
    teams = []
    for row in range(len(times)):
        each = [capture.at(row) for capture in captures]
        team = _best(study, made, [capture.least[0] for capture in each])
        chosen = [share == team.chosen_share for share in made].index(True)
        teams.append((team, each[chosen]))
    return teams


def _commuting(
    study: PatrolMap,
    graph: optimize.Graph,
    visible: Bool[np.ndarray, "cells cells"],
    regions: "patrol.map.Regions | None",
    attack: patrol.Attack,
    most: int,
    say: Say,
) -> Callable[[int], Team]:
    """Make policies for `most` robots; return a function that finds a team of the first of them."""
    made = _at_shares(study, graph, visible, regions, most, say)

    def team_of(robots: int) -> Team:
        teams = {share: policies[:robots] for share, policies in made.items()}
        captures = [
            patrol.Capture.of(graph, visible, team, attack.first, regions)
            for team in teams.values()
        ]
        return _best(study, teams, [capture.least[0] for capture in captures])

    return team_of


def _at_shares(
    study: PatrolMap,
    graph: optimize.Graph,
    visible: Bool[np.ndarray, "cells cells"],
    regions: "patrol.map.Regions | None",
    most: int,
    say: Say,
) -> "dict[float, tuple[patrol.map.Policy, ...]]":
    """Make policies with different shares of steps on tours, among which the study chooses."""
    shares = _SHARES if study.share == "auto" else tuple(sorted({0.0, study.share}))
    if graph.vertices > MAX_VERTICES:
        # One search takes a minute or more.
        shares = (0.0,) if study.share == "auto" else (study.share,)
    made = {}
    for share in shares:
        say(f"making policies for {most} robots, with a share of {share:g}")
        if regions is None:
            made[share] = patrol.distributed_policies(graph, visible, most, share)
        else:
            made[share] = patrol.map.centralized_policies(graph, visible, regions, share)
    return made


def _best(
    study: PatrolMap, teams: "dict[float, tuple[patrol.map.Policy, ...]]", captured: list[float]
) -> Team:
    """Choose among teams with different shares by the least probability of capture of each."""
    shares, least = list(teams), np.array(captured)
    # Captures that differ by rounding count as equal; the first of them is taken.
    auto = int(np.argmax(np.round(least, 9)))
    best = auto if study.share == "auto" else shares.index(study.share)
    return Team(
        policies=teams[shares[best]],
        least=float(least[best]),
        share=np.array(shares),
        share_capture=least,
        chosen_share=shares[best],
    )
