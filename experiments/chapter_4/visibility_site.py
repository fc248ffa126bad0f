"""Make the maps and the patrols of `visibility.py`."""

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
    """A map with the policies of its robots."""

    name: str
    cells: CellSpace
    graph: Graph
    visible: np.ndarray
    regions: Regions | None
    "The regions of the robots, or `None` without a base station."
    policies: tuple[Policy, ...]

    @classmethod
    def distributed(cls, name: str, robots: int) -> "Site":
        """Make a map with independent robots."""
        cells, graph, visible = _load(name)
        policies = distributed_policies(graph, visible, robots, SHARE)
        return cls(name, cells, graph, visible, None, policies)

    @classmethod
    def centralized(cls, name: str, robots: int) -> "Site":
        """Make a map with a base station, and one robot per region."""
        cells, graph, visible = _load(name)
        # The base station sees as far as a robot.
        base = base_station(graph, visible)
        regions = angular_regions(graph, base, visible[base], robots)
        policies = centralized_policies(graph, visible, regions, SHARE)
        return cls(name, cells, graph, visible, regions, policies)

    @property
    def targets(self) -> np.ndarray:
        """Mask of the cells that an adversary may attack: the base station does not see them."""
        if self.regions is None:
            return np.ones(self.graph.vertices, bool)
        return ~self.regions.view

    def caught(self, times: Sequence[int], policies: Sequence[Policy] | None = None) -> np.ndarray:
        """Compute the probability of capture `[times, cells]`; 1 at cells that the base sees."""
        by = self.policies if policies is None else policies
        # The source tests the visibility of robots from the target. Robots start anywhere.
        attack = Attack(times, "uniform")
        probability = capture_probabilities(self.graph, self.visible.T, by, attack)
        probability[:, ~self.targets] = 1
        return probability

    def typical(self, caught: np.ndarray) -> int:
        """Find the target with the median of the probabilities `[cells]`."""
        targets = np.flatnonzero(self.targets)
        order = targets[np.argsort(caught[targets], kind="stable")]
        return int(order[order.size // 2])

    def at(self, cell: int) -> str:
        """Write the centre of a cell as text."""
        x, y = self.graph.xy[cell]
        return f"({x:g}, {y:g})"


def _load(name: str) -> tuple[CellSpace, Graph, np.ndarray]:
    cells = CellSpace.of(Workspace.load(MAPS / f"{name}.json"), 1.0, 8)
    return cells, cell_graph(cells), visible_cells(cells, REACH)


def among(graph: Graph, cells: np.ndarray) -> tuple[Graph, np.ndarray]:
    """Make the graph of some cells, and return their numbers in it; -1 for other cells."""
    number = np.full(graph.vertices, -1)
    number[cells] = np.arange(cells.size)
    ends = number[graph.edges]
    return Graph(ends[(ends >= 0).all(axis=1)], cells.size, graph.xy[cells]), number


def stops(policy: Policy) -> np.ndarray:
    """List the cells on which a policy has an emphasis."""
    return policy.cover if policy.contact is None else np.union1d(policy.cover, policy.contact)


def in_all_regions(site: Site) -> tuple[Policy, ...]:
    """Make policies that walk in all regions, each with an emphasis on its own region.

    This is another interpretation of the source, because Table 4.5 has as many vertices for each
    centralized policy as there are in all regions.
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
    """Make policies with the same weights for all robots of a site."""
    chain = random_walk(site.graph, weights)
    return tuple(dataclasses.replace(p, weights=weights, chain=chain) for p in site.policies)


def policy_sets(site: Site) -> dict[str, tuple[Policy, ...]]:
    """Make the strategies of section 4.4.2 on this graph, by name.

    The walks toward a vertex are limited to the vertices of a minimum cover.
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
