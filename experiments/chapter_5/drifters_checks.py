"""Checks and voyages for `drifters.py`: simulated drifters, ridges, and ways to a goal."""

import dataclasses
import math
from typing import Any

import jax
import numpy as np

from jaxcell.drift import (
    Comparison,
    Drifters,
    DriftStep,
    Flow,
    Sea,
    Voyage,
    Water,
    agreement,
    compare,
    discounted_voyage,
    drift_map,
    ftle,
    ridges,
    simulate_drifters,
    simulate_voyages,
    surest_voyage,
)
from jaxcell.mapping import Chain
from jaxcell.markov import arrival_probabilities, conditional_hitting_times, first_passage

from .drifters_sea import Layer, Ocean, double_gyre


HOURS = (1, 12, 24)
# Steps of a voyage, and the discounts that are tried; the source does not give its own.
SAILING = 72
DISCOUNTS = (0.9, 0.99)
DRIFTERS = 20_000
# The largest distance of border cells from a ridge, in cells.
NEAR = 1
# Steps of the map over which the flow is followed for its ridges, and those of Runge-Kutta in each.
STRETCH, FINE = 20, 10

Rows = list[dict[str, Any]]


# Replay.


@dataclasses.dataclass(frozen=True, eq=False)
class Check:
    """A map beside the simulated drifters that it is compared with."""

    name: str
    chain: Chain
    drifted: Drifters
    found: Comparison


def replays(ocean: Ocean, record: int, seed: int) -> tuple[Rows, list[Check]]:
    surface = ocean.layer(record)
    water, still, step = surface.water, surface.flow, surface.duration
    steps = int(np.ceil((HOURS[-1] + 1) * 3600 / step))
    points = drift_map(water, still, DriftStep(step, spread="sampled", edge="exit"))
    finer = drift_map(
        water,
        still,
        DriftStep(step, spread="sampled", edge="exit", samples=15, method="rk4", substeps=4),
    )
    cases = (
        ("as in the source", surface.chain, still, ocean.rho),
        ("points of the cell", points, still, 1.0),
        ("finer points", finer, still, 1.0),
        ("finer points, and tides", finer, Flow.of(ocean.currents), 1.0),
    )
    checks = []
    for place, (name, chain, flow, rho) in enumerate(cases):
        drifted = simulate_drifters(
            jax.random.fold_in(jax.random.key(seed), place),
            water,
            flow,
            list(ocean.starts),
            step,
            steps,
            drifters=DRIFTERS,
            rho=rho,
            start=3600 * ocean.hour(record),
        )
        checks.append(Check(name, chain, drifted, compare(water, chain, drifted, HOURS)))
    rows = []
    for check in checks:
        row = {"map": check.name}
        found = check.found
        for at, hour in enumerate(HOURS):
            # After no step there is nothing to compare.
            some = found.hours[at] > 0
            row[f"wrong, {hour} h"] = float(found.total_variation[at]) if some else None
            row[f"noise, {hour} h"] = float(found.sampling[at]) if some else None
            row[f"cells, {hour} h"] = float(found.transport[at]) if some else None
        rows.append(row)
    return rows, checks


# Ridges.


@dataclasses.dataclass(frozen=True, eq=False)
class Ridges:
    """The exponent of a flow, its ridges, and the groups."""

    name: str
    water: Water
    exponent: np.ndarray
    "Per hour."
    ridge: np.ndarray
    label: np.ndarray
    "The persistent group to which each cell leads, and no other; -1 if there are several."


def ridge_rows(ocean: Ocean, record: int) -> tuple[Rows, list[Ridges]]:
    points = ocean.layer(record, spread="sampled", edge="exit")
    water, flow = double_gyre()
    gyre = Layer.of(water, flow, None, spread="sampled", edge="exit", method="rk4", substeps=4)
    found, rows = [], []
    for name, layer in (("this sea", points), ("double gyre", gyre)):
        # The stretching of water on its way to the groups.
        exponent = ftle(layer.water, layer.flow, STRETCH * layer.duration, steps=STRETCH * FINE)
        ridge = ridges(layer.water, exponent)
        label = np.asarray(layer.behaviour.basin)
        found.append(Ridges(name, layer.water, 3600 * exponent, ridge, label))
        if len(np.unique(label)) > 1:
            agree = agreement(layer.water, label, ridge, within=NEAR)
            rows.append(
                {
                    "of": name,
                    "groups": layer.behaviour.groups.count,
                    "on ridges, %": 100 * float(ridge.mean()),
                    "borders near, %": 100 * agree.near,
                    "all near, %": 100 * agree.expected,
                    "ratio": agree.ratio,
                }
            )
    return rows, found


# Voyage: Figure 5.16.


@dataclasses.dataclass(frozen=True, eq=False)
class Voyages:
    """Policies to one goal."""

    sea: Sea
    duration: float
    goal: int
    policies: dict[str, Voyage]

    @property
    def discounted(self) -> Voyage:
        """The policy of the source, Alg. 5.5."""
        return self.policies[f"discount {DISCOUNTS[-1]}"]

    @property
    def surest(self) -> Voyage:
        return self.policies["surest"]


def voyages(ocean: Ocean, record: int, goal: int, edge: str) -> Voyages:
    """**Raises:** `RuntimeError` if a solve stalls."""
    sea, duration = ocean.sea(record, edge=edge)
    found = {
        f"discount {discount}": discounted_voyage(sea, goal, discount) for discount in DISCOUNTS
    }
    return Voyages(sea, duration, goal, found | {"surest": surest_voyage(sea, goal)})


def voyage_rows(of: str, found: Voyages, starts: tuple[int, ...], seed: int) -> Rows:
    """Compare the probabilities of policies with simulated drifters."""
    rows = []
    hours = found.duration / 3600
    drift = found.sea.drift
    promised = (
        arrival_probabilities(drift, found.goal, throw=False).value,
        conditional_hitting_times(drift, found.goal, throw=False).value,
    )
    for number, start in enumerate(starts):
        rows.append(
            {
                "edge": of,
                "policy": "only drifts",
                "start": number + 1,
                **_promised(*promised, start, hours),
                f"{SAILING}, steps": float(first_passage(drift, start, found.goal, SAILING).sum()),
                "seen": None,
                "errors": None,
            }
        )
    for place, (name, voyage) in enumerate(found.policies.items()):
        for number, start in enumerate(starts):
            key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), place), number)
            tracks = simulate_voyages(key, voyage, start, DRIFTERS, SAILING)
            told = float(first_passage(voyage.chain, start, found.goal, SAILING).sum())
            seen = float(np.asarray(tracks.arrived).mean())
            # One drifter more or less is no error.
            error = np.sqrt(max(told * (1 - told), 0) / DRIFTERS + 1 / DRIFTERS**2)
            rows.append(
                {
                    "edge": of,
                    "policy": name,
                    "start": number + 1,
                    **_promised(voyage.probability, voyage.conditional_time, start, hours),
                    f"{SAILING}, steps": told,
                    "seen": seen,
                    "errors": abs(seen - told) / error,
                }
            )
    return rows


def _promised(probability: Any, time: Any, start: int, hours: float) -> dict[str, Any]:
    probability, time = np.asarray(probability), np.asarray(time)
    arriving = np.isfinite(time)
    return {
        "least": float(probability.min()),
        "mean": float(probability.mean()),
        "median, h": float(np.median(time[arriving]) * hours),
        "arrives": float(probability[start]),
        "after, h": float(time[start] * hours) if arriving[start] else math.nan,
    }
