"""A map with its patrol, for the files of `visibility.py` to share."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse

from jaxcell.mapping import Chain
from jaxcell.optimize import Graph, minimum_commute, minimum_cover
from jaxcell.patrol import (
    Attack,
    capture_probabilities,
    cell_graph,
    distributed_policies,
    random_walk,
    toward,
)
from jaxcell.patrol.map import Policy, Regions, angular_regions, base_station, centralized_policies
from jaxcell.patrol.walks import edge_shares
from jaxcell.space import CellSpace, Workspace, visible_cells

from ..shared.data import MAPS


REACH = 6.0
SHARE = 0.8


@dataclasses.dataclass(frozen=True, eq=False)
class Site:
    """A map, and the robots that patrol it."""

    name: str
    cells: CellSpace
    graph: Graph
    visible: np.ndarray
    regions: Regions | None
    "The region of each robot, or `None` without a base station."
    policies: tuple[Policy, ...]

    @classmethod
    def distributed(cls, name: str, robots: int) -> "Site":
        cells, graph, visible = _load(name)
        return cls(
            name, cells, graph, visible, None, distributed_policies(graph, visible, robots, SHARE)
        )

    @classmethod
    def centralized(cls, name: str, robots: int) -> "Site":
        cells, graph, visible = _load(name)
        # The base station sees as far as a robot.
        base = base_station(graph, visible)
        regions = angular_regions(graph, base, visible[base], robots)
        policies = centralized_policies(graph, visible, regions, SHARE)
        return cls(name, cells, graph, visible, regions, policies)

    @property
    def targets(self) -> np.ndarray:
        """The cells that an adversary may choose: those that a base station does not watch."""
        if self.regions is None:
            return np.ones(self.graph.vertices, bool)
        return ~self.regions.view

    def caught(self, times: Sequence[int], policies: Sequence[Policy] | None = None) -> np.ndarray:
        """The probability of capture, one row a time, 1 where the base station watches."""
        by = self.policies if policies is None else policies
        # The source tests whether the target sees the cells of robots, which begin anywhere.
        attack = Attack(times, "uniform")
        probability = capture_probabilities(self.graph, self.visible.T, by, attack)
        probability[:, ~self.targets] = 1
        return probability

    def typical(self, caught: np.ndarray) -> int:
        """The target with the median probability."""
        targets = np.flatnonzero(self.targets)
        order = targets[np.argsort(caught[targets], kind="stable")]
        return int(order[order.size // 2])

    def at(self, cell: int) -> str:
        x, y = self.graph.xy[cell]
        return f"({x:g}, {y:g})"


def _load(name: str) -> tuple[CellSpace, Graph, np.ndarray]:
    cells = CellSpace.of(Workspace.load(MAPS / f"{name}.json"), 1.0, 8)
    return cells, cell_graph(cells), visible_cells(cells, REACH)


def among(graph: Graph, cells: np.ndarray) -> tuple[Graph, np.ndarray]:
    """The graph of some cells, and the number in it of each."""
    number = np.full(graph.vertices, -1)
    number[cells] = np.arange(cells.size)
    ends = number[graph.edges]
    return Graph(ends[(ends >= 0).all(axis=1)], cells.size, graph.xy[cells]), number


def stops(policy: Policy) -> np.ndarray:
    """The cells that a policy has an emphasis on."""
    return policy.cover if policy.contact is None else np.union1d(policy.cover, policy.contact)


def in_all_regions(site: Site) -> tuple[Policy, ...]:
    """Another reading of the source: each robot walks in all regions, with an emphasis on its own.

    Table 4.5 has as many vertices for each centralized policy as there are in all regions.
    """
    cells = np.flatnonzero(site.regions.region >= 0).astype(np.int32)
    part, number = among(site.graph, cells)
    idle = np.ones(site.graph.vertices)
    idle[cells] = 0
    read = []
    for policy in site.policies:
        walk = minimum_commute(part, number[stops(policy)].tolist(), SHARE)
        weights = Graph(cells[part.edges], site.graph.vertices).matrix(walk.weights)
        matrix = scipy.sparse.csr_array(weights + scipy.sparse.diags_array(idle))
        matrix = scipy.sparse.diags_array(1 / matrix.sum(axis=1)) @ matrix
        read.append(dataclasses.replace(policy, cells=cells, chain=Chain.from_scipy(matrix)))
    return tuple(read)


def with_weights(site: Site, weights: np.ndarray) -> tuple[Policy, ...]:
    """The robots of a site, all with other weights."""
    chain = random_walk(site.graph, weights)
    return tuple(dataclasses.replace(p, weights=weights, chain=chain) for p in site.policies)


def policy_sets(site: Site) -> dict[str, tuple[Policy, ...]]:
    """List the strategies of the two robots (section 4.4.2) on this graph.

    Of the 188 walks toward a vertex, the walks toward the fewest vertices that see everything are
    taken.
    """
    robots = len(site.policies)
    sets = {"MAECT": with_weights(site, minimum_commute(site.graph).weights)}
    for share in (0.2, 0.5, 0.8, 0.95):
        sets[f"h = {share}"] = distributed_policies(site.graph, site.visible, robots, share)
    for cell in minimum_cover(site.visible).chosen.tolist():
        chain = toward(site.graph, cell)
        sets[f"toward {site.at(cell)}"] = tuple(
            dataclasses.replace(p, weights=edge_shares(site.graph, chain), chain=chain)
            for p in site.policies
        )
    return sets
