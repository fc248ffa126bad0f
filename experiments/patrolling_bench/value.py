"""The value of a strategy in a game, by NumPy alone: the rules of the bench.

A strategy is a JSON object. `robots` has the periods and visits of all robots, as `patrol.json` of
`jaxcell patrol guard`. `drawn` is a list of such schedules, each with its `chance`; one is drawn,
and begins at a random moment. `walk` is a random walk with memory: `states` are names of vertices,
and `moves` are triples of a state, the next state, and the probability.

The value is the least share of attacks that are stopped, over targets, relative to values: 1 less
the largest product of a target's value and the probability of success, divided by the largest
value. A *blind* adversary attacks at a random moment. A *watcher* sees the robots as they leave
vertices, knows the strategy and the state of its memory, and chooses the moment.
"""

import math
from fractions import Fraction
from typing import Any

import numpy as np


# Relative rounding error of times, and absolute one of probabilities.
ROUNDING, CHANCE = 1e-6, 1e-9
Document = dict[str, Any]


def value(game: Document, strategy: Document) -> float:
    """Compute the value of a strategy. **Raises:** `ValueError` if robots cannot follow it."""
    if "walk" in strategy:
        success = attacks_on_walk(game, strategy["walk"])
    elif "drawn" in strategy:
        if game["adversary"] != "blind":
            raise ValueError("drawn: a watcher sees which schedule is drawn; give one of `robots`")
        if abs(sum(one["chance"] for one in strategy["drawn"]) - 1) > CHANCE:
            raise ValueError("drawn: the chances do not add up to 1")
        success = sum(
            (one["chance"] * exposures(game, one["robots"]) for one in strategy["drawn"]),
            np.zeros(len(game["targets"])),
        )
    else:
        success = exposures(game, strategy["robots"])
        if game["adversary"] == "watcher":
            success = np.where(success > 0, 1.0, 0.0)
    worth = np.array([target.get("value", 1.0) for target in game["targets"]])
    return float(1 - (success * worth).max() / worth.max())


def ways(game: Document) -> dict[tuple[str, str], float]:
    return {(way["from"], way["to"]): way["time"] for way in game["ways"]}


def exposures(game: Document, robots: list[Document]) -> np.ndarray:
    """Compute the share of moments from which no robot visits each target during an attack."""
    if len(robots) != game["robots"]:
        raise ValueError(f"robots: expected {game['robots']}, got {len(robots)}")
    for number, robot in enumerate(robots):
        check(game, robot, f"robots[{number}]")
    return np.array([exposure(target, robots) for target in game["targets"]])


def check(game: Document, robot: Document, where: str) -> None:
    """Check that a robot has the time to walk from each visit to the next."""
    times, period, visits = ways(game), robot["period"], robot["visits"]
    for number, (visit, after) in enumerate(zip(visits, visits[1:] + visits[:1], strict=True)):
        leaves, next_ = visit.get("until", visit["time"]), after["time"]
        next_ += period * (number == len(visits) - 1)
        here, there = visit["vertex"], after["vertex"]
        needed = 0.0 if here == there else times.get((here, there), math.inf)
        if leaves < visit["time"] or next_ - leaves < needed * (1 - ROUNDING) - ROUNDING * period:
            raise ValueError(f"{where}.visits[{number}]: no time to go from {here} to {there}")


def exposure(target: Document, robots: list[Document]) -> float:
    """Compute the share of moments at which an attack on a target begins that succeeds."""
    there = [
        (robot["period"], visit["time"], visit.get("until", visit["time"]))
        for robot in robots
        for visit in robot["visits"]
        if visit["vertex"] == target["vertex"]
    ]
    if not there:
        return 1.0
    first = there[0][0]
    ratios = [Fraction(period / first).limit_denominator(1000) for period, *_ in there]
    common = math.lcm(*(r.numerator for r in ratios)) / math.gcd(*(r.denominator for r in ratios))
    period = first * common
    busy = []
    for (lasts, begin, end), ratio in zip(there, ratios, strict=True):
        if abs(lasts / first - ratio) > ROUNDING:
            raise ValueError(f"periods at {target['vertex']} have no common multiple")
        repeats = round(common / ratio)
        busy += [(begin % lasts + k * lasts, end - begin) for k in range(repeats)]
    busy.sort()
    late, last = 0.0, max(begin + stays for begin, stays in busy) - period
    for begin, stays in busy:
        gap = begin - last
        if gap > target["attack_time"] * (1 + ROUNDING):
            late += gap - target["attack_time"]
        last = max(last, begin + stays)
    return late / period


def attacks_on_walk(game: Document, walk: Document) -> np.ndarray:
    """Compute the largest probability that an attack on each target succeeds.

    The attack begins as the robot leaves a state. `reached[t, s]` is the probability that it
    arrives at the target within a time `t` after that.
    """
    if game["robots"] != 1 or game["adversary"] != "watcher":
        raise ValueError("walk: expected a game of one robot and a watcher")
    times, states = ways(game), walk["states"]
    begin, end, chance = (np.array(column) for column in zip(*walk["moves"], strict=True))
    given = [
        1 if states[i] == states[j] else times.get((states[i], states[j]), math.nan)
        for i, j in zip(begin.tolist(), end.tolist(), strict=True)
    ]
    lasts = np.array(given)
    if not (lasts == np.rint(lasts)).all() or (chance < 0).any():
        raise ValueError("walk: a move has no way or no whole time, or a negative probability")
    sums = np.bincount(begin, chance, len(states))
    if np.abs(sums - 1).max() > CHANCE:
        raise ValueError("walk: probabilities of the moves from a state do not add up to 1")
    success = []
    for target in game["targets"]:
        longest = math.floor(target["attack_time"] * (1 + ROUNDING))
        there = np.array([state == target["vertex"] for state in states])
        reached = np.zeros((longest + 1, len(states)))
        for time in range(1, longest + 1):
            left = (time - lasts).astype(int)
            arrives = np.where(there[end], 1.0, reached[np.maximum(left, 0), end])
            reached[time] = np.bincount(begin, chance * arrives * (left >= 0), len(states))
        success.append(1 - reached[longest].min())
    return np.array(success)


def shares(game: Document, walk: Document) -> dict[str, float]:
    """Compute the share of moves that begin at each vertex in the long run."""
    count = len(walk["states"])
    matrix = np.zeros((count, count))
    for begin, end, chance in walk["moves"]:
        matrix[begin, end] += chance
    system = np.append(matrix.T - np.eye(count), np.ones((1, count)), axis=0)
    share = np.linalg.lstsq(system, np.append(np.zeros(count), 1.0), rcond=None)[0]
    found = dict.fromkeys((vertex["name"] for vertex in game["vertices"]), 0.0)
    for state, part in zip(walk["states"], share.tolist(), strict=True):
        found[state] += part
    return found
