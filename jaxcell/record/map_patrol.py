import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ..optimize import Graph
from ..patrol.map.attack import Vulnerability
from ..patrol.map.game import ShareGame, contested
from ..patrol.map.policies import Policy
from ..patrol.map.reassignment import Reassignment
from ..patrol.map.regions import Regions
from ..space import CellSpace
from .canvas.palette import Color


BASE_VIEW: Color = (190, 226, 234)
"The colour of what only a base station watches."


@dataclasses.dataclass(frozen=True, eq=False)
class MapPatrol:
    """How robots patrol a map, and how vulnerable it is then: what is kept and shown together.

    One robot in a corridor of four cells, each of which sees its neighbours:

        >>> import jax
        >>> from jaxcell import patrol, record, space
        >>> room = space.Workspace([(0, 0), (4, 0), (4, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 1)
        >>> graph, visible = patrol.cell_graph(cells), space.visible_cells(cells, 1.6)
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> problem = graph, visible, policies
        >>> attack = patrol.vulnerability(jax.random.key(0), *problem, 0, [2], runs=5)
        >>> capture = patrol.capture_probabilities(*problem, [2])
        >>> found = record.MapPatrol(cells, 1.6, *problem, attack, capture)
        >>> found.robots, found.contested.tolist(), found.capture.round(3).tolist()
        (1, [0, 1, 2, 3], [[0.889, 1.0, 1.0, 0.889]])
    """

    cells: CellSpace
    reach: float
    "The range of sight of a robot, in metres."
    graph: Graph
    "The cells and the ways between them, [`jaxcell.patrol.cell_graph`][]."
    visible: Bool[np.ndarray, "cells cells"]
    "Which cells are seen from each, [`jaxcell.space.visible_cells`][]."
    policies: tuple[Policy, ...]
    "How each robot walks."
    attack: Vulnerability
    "An attack on one cell."
    capture: Float[np.ndarray, "times attacked"]
    "The probability of capture for each attack time of `attack` and each cell attacked."
    regions: Regions | None = None
    "Who patrols where, if there is a base station."
    reassignment: Reassignment | None = None
    "What the robots do when one has stopped reporting."
    game: ShareGame | None = None
    "The mixture of policies that is best against an adversary."

    def __post_init__(self) -> None:
        """**Raises:** `ValueError` for parts that are not of the same cells and attack times."""
        positions = self.cells.positions
        sizes = {
            "graph": self.graph.vertices,
            "visible": len(self.visible),
            "attack": self.attack.view.size,
            "capture": self.capture.shape[1],
            **{f"policies[{i}]": one.chain.cells for i, one in enumerate(self.policies)},
        }
        if self.regions is not None:
            sizes["regions"] = self.regions.region.size
        if self.game is not None:
            sizes["game"] = self.game.capture.shape[1]
        for name, size in sizes.items():
            if size != positions:
                raise ValueError(f"{name}: expected that of {positions} cells, got {size}")
        if self.cells.workspace is None:
            raise ValueError("cells: expected those of a map, got those of a grid")
        if len(self.capture) != self.attack.attack_times.size:
            raise ValueError(
                f"capture: expected {self.attack.attack_times.size} rows, one an attack time, got "
                f"{len(self.capture)}"
            )
        if self.reassignment is not None and self.regions is None:
            raise ValueError("reassignment: expected regions too")

    @property
    def robots(self) -> int:
        """How many robots there are."""
        return len(self.policies)

    @property
    def contested(self) -> Int[np.ndarray, "targets"]:
        """The cells that an adversary may choose from, [`jaxcell.patrol.contested`][]."""
        return contested(self.visible, self.policies, self.regions)

    @property
    def xy(self) -> Float[np.ndarray, "cells 2"]:
        """The centre of each cell, in metres."""
        x, y, _ = self.cells.centre(np.arange(self.cells.positions))
        return np.stack([x, y], axis=1)
