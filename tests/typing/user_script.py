"""A program of a user, which type checkers read: `make lint`. It is not run."""

import math
from typing import Any, assert_type

import jax
import networkx as nx
import numpy as np
import shapely
from matplotlib.axes import Axes

from jaxcell import (
    automata,
    bounce,
    bundled,
    drift,
    dynamics,
    mapping,
    markov,
    optimize,
    patrol,
    record,
    robot,
    space,
    study,
    sweep,
    verify,
    walls,
)


room = space.Workspace(shapely.box(0, 0, 8, 4), obstacles=[shapely.box(2, 1, 3, 2)])
cells = space.CellSpace.of(room, cell=0.5, directions=8)
bounces = bounce.bounce_map(cells, math.radians(45))
groups = bounce.bounce_groups(cells, math.radians(45))
assert_type(groups, mapping.PeriodicGroups)
assert_type(groups.plot("step", on=cells, direction=3), Axes)
filter = bounce.localization_filter(bounces)
assert_type(bounce.localize(bounces, filter, start=49).candidates, np.ndarray)
plan = bounce.plan(cells, [math.pi / 2], start=(0.5, 0.5, math.pi / 2), goal=5)
assert_type(plan.bumps, int | Any)
automata.to_c_header(filter)
walls.Boundary.of(room)

P = np.array([[0.5, 0.5], [0.25, 0.75]])
for chain in (P, P.tolist(), mapping.Chain.from_scipy(P), nx.DiGraph([(0, 1), (1, 0)])):
    times = markov.hitting_times(chain, 1)
    assert_type(times.value, jax.Array)
    assert_type(times.certificate.residual, float)
print(markov.limiting_distribution(P).value.sum(), markov.kemeny_constant(P) + 1.0)

for graph in (nx.grid_2d_graph(3, 3), optimize.Graph([[0, 1], [1, 2], [2, 0]])):
    assert_type(patrol.random_walk(graph), mapping.Chain)
    optimize.minimum_commute(graph)

currents = drift.open_currents(bundled("gyres"), time=0, depths=0)
sea = drift.SeaDrift.of(currents)
assert_type(sea.plot(), Axes)
box = space.Box([-2, -2], [2, 2], cells=[200, 200])
basins = dynamics.basins(lambda x, p: 0.5 * x, box)
dynamics.basins(lambda x: 0.5 * x, box)
dynamics.flow(lambda x: -x, 0.1)
dynamics.continuation(lambda x, p: p * x, box, [0.25, 0.5])
study.Dynamics(dynamics.System(lambda x, p: 0.5 * x, box)).run()
assert_type(basins.plot(), Axes)

for place in (
    "@lab_a",
    bundled("lab_a"),
    room,
    cells,
    shapely.box(0, 0, 8, 4),
    np.ones((4, 8), bool),
):
    found = study.Groups(map=place, bounce=(45.0, 90.0)).run()
assert_type(found, bounce.BounceGroups)
assert_type(found.longest_period, np.ndarray)
assert_type(found.step, np.ndarray)
cover = study.Cover(map=room, bounce=(45.0, 90.0), errors={"turn": 45.0}, reliability=0.8).run()
assert_type(cover.total_variation, float)
study.Drift(file=currents).run()
study.PatrolGraph(file=nx.star_graph(3)).run()
study.PatrolGraph(nx.cycle_graph(5), strategy="toward", vertex=2).run()

data = record.dataset(cover)
record.save_recording(cover, "cover.rrd")
verify.compare_groups(found)
print(data.mixture, sweep.Spec.load("sweep.toml"), robot.read_log("run.jsonl"))
