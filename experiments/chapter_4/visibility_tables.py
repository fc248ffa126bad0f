"""Make the rows of the tables of `visibility.py`, beside the numbers of the source."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxcell.optimize import Commitment, greedy_cover, minimum_commute, minimum_cover, stackelberg
from jaxcell.patrol import Attack, distributed_policies, vulnerability
from jaxcell.patrol.map import Policy, Reassignment, Vulnerability, reassign

from ..shared.report import Rows
from .visibility_site import SHARE, Site, among, stops


REPEATS = 10
ATTACKS = (20, 30, 40, 50, 100, 500)
SHORT, LONG = 20, 50
BY_TIME = [f"t = {t}" for t in ATTACKS]
# Means and standard deviations of Tables 4.4 (ms) and 4.5 (s), and probabilities of 4.6 and 4.7.
TABLE_4_4 = {
    "depot": ((2.7928, 0.0634), (2.8072, 0.0452)),
    "harbour": ((2.7715, 0.0845), (2.9198, 0.0674), (2.8001, 0.0855)),
}
TABLE_4_5 = {
    "depot": ((733.2722, 22.3968), (676.6925, 12.1284)),
    "harbour": ((779.4053, 9.6480), (744.9866, 10.0691), (752.8397, 14.4261)),
}
TABLES_4_6 = {
    "depot": ("Table 4.6", (0.5139118, 0.642008, 0.726392, 0.7844395, 0.9109307, 0.9926246)),
    "harbour": ("Table 4.7", (0.1902747, 0.2696536, 0.3383983, 0.3988624, 0.6166325, 0.9656368)),
}

# Tables 4.4 and 4.5.


def timed(program: Callable[[], Any]) -> tuple[float, float]:
    """Compute the mean and the standard deviation of the seconds of a call, after a first call."""
    program()
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        program()
        seconds.append(time.perf_counter() - began)
    return statistics.mean(seconds), statistics.stdev(seconds)


def cover_rows(site: Site) -> Rows:
    """Describe the cover of each robot."""
    rows = []
    for robot, policy in enumerate(site.policies):
        sets = site.visible[np.ix_(policy.cells, policy.cells)]
        choice = robot if site.regions is None else 0
        mean, deviation = timed(lambda sets=sets, choice=choice: greedy_cover(sets, choice))
        fewest = minimum_cover(sets).chosen.size
        told, spread = TABLE_4_4[site.name][robot]
        rows.append(
            {
                "map": site.name,
                "robot": robot + 1,
                "cells": policy.cells.size,
                "unseen": policy.uncovered.size,
                "greedy": policy.cover.size,
                "fewest": fewest,
                "ratio": policy.cover.size / fewest,
                "ms": 1000 * mean,
                "std": 1000 * deviation,
                "Alam 2018, ms": told,
                "Alam 2018, std ms": spread,
            }
        )
    return rows


def policy_rows(site: Site) -> Rows:
    """Describe the walk of each robot."""
    rows = []
    for robot, policy in enumerate(site.policies):
        part, number = among(site.graph, policy.cells)
        through = number[stops(policy)].tolist()
        mean, deviation = timed(lambda g=part, q=through: minimum_commute(g, q, SHARE))
        told, spread = TABLE_4_5[site.name][robot]
        rows.append(
            {
                "map": site.name,
                "robot": robot + 1,
                "cells": part.vertices,
                "edges": len(part.edges),
                "commute": policy.commute_time,
                "at h = 0": minimum_commute(part).commute_time,
                "gap": policy.certificate.residual,
                "s": mean,
                "std": deviation,
                "Alam 2018, s": told,
                "Alam 2018, std s": spread,
            }
        )
    return rows


# A robot is lost.


def reassignments(site: Site) -> tuple[Rows, list[Reassignment]]:
    """Compare capture by all robots, without each robot, and after its work is reassigned."""

    def row(state: str, policies: Sequence[Policy], silence: int | None = None) -> dict[str, Any]:
        sizes = " + ".join(str(policy.cells.size) for policy in policies)
        caught = site.caught((SHORT, LONG), policies)[:, site.targets]
        return {"state": state, "cells": sizes, "silence": silence, **least_and_mean(caught)}

    rows = [row("all robots", site.policies)]
    made = []
    for lost in range(len(site.policies)):
        left = [policy for robot, policy in enumerate(site.policies) if robot != lost]
        new = reassign(site.graph, site.visible, site.regions, site.policies, lost, share=SHARE)
        rows.append(row(f"without robot {lost + 1}", left))
        rows.append(row("  reassigned", new.policies, new.silence_limit))
        made.append(new)
    return rows, made


def least_and_mean(caught: np.ndarray) -> dict[str, float]:
    """Compute the least and the mean probability over cells, for `caught[short or long, cells]`."""
    return {
        f"{name}, {attack}": float(number)
        for attack, row in zip((SHORT, LONG), caught, strict=True)
        for name, number in (("least", row.min()), ("mean", row.mean()))
    }


# Tables 4.6 and 4.7.


def evaluate(site: Site, caught: np.ndarray, runs: int, seed: int) -> list[Vulnerability]:
    """Evaluate the typical cell, with the median probability for a long attack, and the weakest."""
    weakest = int(np.argmin(caught[ATTACKS.index(SHORT)]))
    typical = site.typical(caught[ATTACKS.index(LONG)])
    patrol = site.graph, site.visible.T, site.policies
    attack, key = Attack(ATTACKS, "uniform"), jax.random.key(seed)
    return [
        vulnerability(jax.random.fold_in(key, number), *patrol, target, attack, runs=runs)
        for number, target in enumerate((typical, weakest))
    ]


def capture_rows(site: Site, vulnerabilities: Sequence[Vulnerability]) -> Rows:
    """Compare the exact, simulated and fitted probabilities at both cells with the source."""
    rows = []
    for name, one in zip(("typical", "weakest"), vulnerabilities, strict=True):
        of = f"{site.name}, {name} {site.at(one.target)}"
        rows += [
            by_time(of, "exact", one.exact),
            by_time(of, "simulated", one.simulated),
            by_time(of, "fit", one.fitted),
            by_time(of, "fit - exact", one.fitted - one.exact),
        ]
    table, source = TABLES_4_6[site.name]
    return [*rows, by_time("Alam 2018, another map", table, source)]


def range_rows(caught: np.ndarray, of: str) -> Rows:
    """Describe the range over cells of the probabilities `caught[times, cells]`."""
    return [
        by_time(of, "weakest", caught.min(axis=1)),
        by_time(of, "median", np.median(caught, axis=1)),
        by_time(of, "strongest", caught.max(axis=1)),
    ]


def by_time(of: str, by: str, numbers: Sequence[float] | np.ndarray) -> dict[str, Any]:
    return {"of": of, "by": by, **{t: float(p) for t, p in zip(BY_TIME, numbers, strict=True)}}


# Mixtures against an adversary.


def play(caught: dict[str, np.ndarray]) -> list[Commitment]:
    """Compute the mixtures of policies with the strongest weakest cell, for both attacks.

    The adversary knows the mixture but not the policy in use, and gains the probability of escape.
    """
    return [stackelberg(leader, 1 - leader) for leader in np.stack(list(caught.values()), axis=1)]


def mixture_of(caught: dict[str, np.ndarray], one: Commitment) -> np.ndarray:
    """Compute the probabilities of capture by a mixture, `[attacks, cells]`."""
    return np.tensordot(np.asarray(one.weights), np.stack(list(caught.values())), axes=1)


def game_rows(site: Site, caught: dict[str, np.ndarray], mixtures: Sequence[Commitment]) -> Rows:
    """Describe the single policies, and their mixtures for the short and the long attack."""
    of_attack = dict(zip((SHORT, LONG), mixtures, strict=True))
    rows = []
    for place, (name, both) in enumerate(caught.items()):
        shares = {f"in mix, {t}": float(one.weights[place]) for t, one in of_attack.items()}
        rows.append({"policies": name, **alone(site, both), **shares})
    for attack, one in of_attack.items():
        rows.append({"policies": f"mix {attack}", **alone(site, mixture_of(caught, one))})
    return rows


def alone(site: Site, both: np.ndarray) -> dict[str, Any]:
    """Describe the probabilities `[short or long, cells]` of a policy, and the weakest cells."""
    attacked = {
        f"attacked, {attack}": site.at(int(np.argmin(caught)))
        for attack, caught in zip((SHORT, LONG), both, strict=True)
    }
    return {**least_and_mean(both), **attacked}


# Other numbers of robots and emphases.


def by_robots(site: Site, most: int) -> Rows:
    """Compute the capture by up to `most` robots."""
    policies = distributed_policies(site.graph, site.visible, most, SHARE)
    return [
        {"robots": m, **least_and_mean(site.caught((SHORT, LONG), policies[:m]))}
        for m in range(1, most + 1)
    ]


def by_share(site: Site) -> Rows:
    """Compute the commute time and the capture by the least share of the weight on the tour."""
    rows = []
    for share in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99):
        policies = distributed_policies(site.graph, site.visible, len(site.policies), share)
        caught = least_and_mean(site.caught((SHORT, LONG), policies))
        commute = statistics.mean(policy.commute_time for policy in policies)
        rows.append({"share": share, "commute": commute, **caught})
    return rows
