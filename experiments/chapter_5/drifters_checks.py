"""Compute the checks and voyages of `drifters.py`: simulated drifters, ridges, and policies."""

import dataclasses
import math
from typing import Any

import numpy as np

from jaxcell.drift import (
    DriftStep,
    Sea,
    Voyage,
    Water,
    agreement,
    discounted_voyage,
    drift_map,
    ftle,
    ridges,
    surest_voyage,
)
from jaxcell.mapping import Chain
from jaxcell.markov import arrival_probabilities, conditional_hitting_times, first_passage

from ..shared.report import Rows
from .drifters_sea import Layer, Ocean, double_gyre
from .drifters_truth import Check, Simulation, arrival


HOURS = (1, 12, 24)
# The number of steps of a voyage, and its discounts, which the source does not have.
SAILING = 72
DISCOUNTS = (0.9, 0.99)
DRIFTERS = 20_000
# The largest distance of border cells from a ridge, in cells.
NEAR = 1
# The steps of the map for the exponent, and the Runge-Kutta steps in each.
STRETCH, FINE = 20, 10


# Comparison with simulated drifters.


def replays(ocean: Ocean, record: int, seed: int) -> tuple[Rows, list[Check]]:
    """Compare four maps of the surface with drifters that are simulated without the library."""
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
        ("as in the source", surface.chain, record, ocean.rho),
        ("points of the cell", points, record, 1.0),
        ("finer points", finer, record, 1.0),
        ("finer points, and tides", finer, None, 1.0),
    )
    checks = []
    for place, (name, chain, at, rho) in enumerate(cases):
        simulation = Simulation(ocean.currents, 0, at, water.wraps)
        random, begin = np.random.default_rng([seed, place]), 3600 * ocean.hour(record)
        cell = simulation.run(ocean.starts, step, steps, begin, rho, DRIFTERS, random)
        checks.append(Check.of(name, chain, simulation, cell, step, HOURS))
    rows = []
    for check in checks:
        row: dict[str, Any] = {"map": check.name}
        columns = {"wrong": check.wrong, "noise": check.noise, "cells": check.apart}
        for at, hour in enumerate(HOURS):
            for name, values in columns.items():
                # There is nothing to compare before the first step.
                row[f"{name}, {hour} h"] = values[at] if check.hours[at] > 0 else None
        rows.append(row)
    return rows, checks


# Ridges.


@dataclasses.dataclass(frozen=True, eq=False)
class Ridges:
    """The Lyapunov exponent of a flow per hour, its ridges, and the groups, by cell."""

    name: str
    water: Water
    exponent: np.ndarray
    ridge: np.ndarray
    label: np.ndarray
    "The only persistent group to which each cell leads; -1 if there are several."


def ridge_rows(ocean: Ocean, record: int) -> tuple[Rows, list[Ridges]]:
    """Compare the borders between groups with ridges, for this sea and for a double gyre.

    Both are computed by the library, from one flow: this shows how they relate, and checks neither.
    """
    points = ocean.layer(record, spread="sampled", edge="exit")
    water, flow = double_gyre()
    gyre = Layer.of(water, flow, None, spread="sampled", edge="exit", method="rk4", substeps=4)
    of_layers, rows = [], []
    for name, layer in (("this sea", points), ("double gyre", gyre)):
        exponent = ftle(layer.water, layer.flow, STRETCH * layer.duration, steps=STRETCH * FINE)
        ridge = ridges(layer.water, exponent)
        label = np.asarray(layer.behaviour.basin)
        of_layers.append(Ridges(name, layer.water, 3600 * exponent, ridge, label))
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
    return rows, of_layers


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
    """Compute the policies to a goal.

    **Raises:** `RuntimeError` if a solver does not converge.
    """
    sea, duration = ocean.sea(record, edge=edge)
    policies = {
        f"discount {discount}": discounted_voyage(sea, goal, discount) for discount in DISCOUNTS
    }
    return Voyages(sea, duration, goal, policies | {"surest": surest_voyage(sea, goal)})


def voyage_rows(of: str, voyages: Voyages, ocean: Ocean) -> Rows:
    """Compare the arrival probabilities of drifting and of policies with matrices of their own."""
    hours, drift, starts = voyages.duration / 3600, voyages.sea.drift, ocean.starts
    water = ocean.currents["water"].values

    def row(name: str, number: int, chain: Chain, probability: Any, time: Any) -> dict[str, Any]:
        start = starts[number]
        predicted = _predicted(np.asarray(probability), np.asarray(time), start, hours)
        within = float(first_passage(chain, start, voyages.goal, SAILING).sum())
        known = {"edge": of, "policy": name, "start": number + 1, **predicted}
        return known | {f"{SAILING}, steps": within, "again": None}

    probability = arrival_probabilities(drift, voyages.goal, throw=False).value
    time = conditional_hitting_times(drift, voyages.goal, throw=False).value
    rows = [row("only drifts", k, drift, probability, time) for k in range(len(starts))]
    for name, voyage in voyages.policies.items():
        for number, start in enumerate(starts):
            one = row(name, number, voyage.chain, voyage.probability, voyage.conditional_time)
            rows.append(one | {"again": arrival(voyages.sea, voyage, water, start, SAILING)})
    return rows


def _predicted(
    probability: np.ndarray, time: np.ndarray, start: int, hours: float
) -> dict[str, Any]:
    arriving = np.isfinite(time)
    return {
        "least": float(probability.min()),
        "mean": float(probability.mean()),
        "median, h": float(np.median(time[arriving]) * hours),
        "arrives": float(probability[start]),
        "after, h": float(time[start] * hours) if arriving[start] else math.nan,
    }
