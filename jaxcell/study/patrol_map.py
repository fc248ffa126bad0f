import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

from ..base.limits import MAX_CELLS, MAX_VERTICES
from .map_study import CellStudy
from .study import AtLeastOne, Limit, Metres, Say, about, numbers, refuse, silent


if TYPE_CHECKING:
    import numpy as np

    from ..optimize import Graph
    from ..patrol import PatrolledMap
    from ..patrol.map import Policy, Regions
    from ..space import CellSpace
    from ..space.extent import Extent
    from ..verify import Comparison


# The emphases among which "auto" chooses.
_SHARES = (0.0, 0.2, 0.5, 0.8)
# So many robots are tried.
_MAX_ROBOTS = 20
_Chance: TypeAlias = Annotated[float, Limit("more than 0 and less than 1", lambda x: 0 < x < 1)]
_Steps: TypeAlias = Annotated[int, Limit("at least 1 step", lambda n: n >= 1)]
_Reach: TypeAlias = Annotated[Metres, Limit("more than 0 m, and finite", lambda x: x > 0)]
_Share: TypeAlias = Annotated[float, Limit("0 or more and less than 1", lambda x: 0 <= x < 1)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolMap(CellStudy):
    """Patrol a map with robots that see only so far, and compute how vulnerable it is then."""

    name: ClassVar[str] = "patrol_map"

    robots: AtLeastOne | Literal["auto"] = 2
    """How many robots patrol; "auto" takes the fewest, up to 20, that reach --capture."""
    capture: _Chance | None = None
    """The least probability of capture in the first of the attack times that is wanted, with as
    many robots as that takes."""
    range: _Reach = 6.0
    """How far a robot sees, in metres; walls are in the way."""
    strategy: Literal["commute", "capture"] = "commute"
    """What the walks are for: a short time there and back between cells (commute), or a great least
    probability of capture in the first of the attack times (capture), a local optimum."""
    share: _Share | Literal["auto"] = "auto"
    """Least share of steps on the shortest closed tour through the cells from which all is seen,
    for "commute"; "auto" takes the one of 0, 0.2, 0.5 and 0.8 that captures most, and 0 on more
    than 2,000 cells."""
    start: Literal["uniform", "stationary", "worst"] = "uniform"
    """Where robots are, out of view, as an attack begins: anywhere alike (uniform), as often as in
    the long run (stationary), or where an adversary who sees them likes it best (worst)."""
    randomness: _Share = 0.0
    """Least share of its steps in which a robot goes to any neighbour alike, for "capture"."""
    frontier: tuple[_Share, ...] = ()
    """Values of the randomness at which "capture" is compared with entropy."""
    starts: AtLeastOne = 3
    """How many starts "capture" tries."""
    base: str | None = None
    """Base station to report to, around which each robot has a region: "x,y" in metres, or "auto"
    for a central place that sees much. Without it each robot patrols the whole map."""
    base_range: _Reach | None = None
    """How far the base station sees, in metres; by default as far as a robot."""
    lost: int | None = None
    """A robot that stops reporting to the base station; the others divide the map anew."""
    target: str | None = None
    """The cell that is attacked, "x,y" in metres; by default the one that is most vulnerable to the
    first of the attack times."""
    attack_times: tuple[_Steps, ...] = (20, 30, 40, 50, 100, 500)
    """The steps that an attack takes."""
    runs: Annotated[int, Limit("2 or more, up to 10,000,000", lambda n: 2 <= n <= 1e7)] = 5000
    """How often to simulate an attack."""
    seed: int = 0
    """Seed of the simulation, and of the patrol that is recorded."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.robots == "auto") != (self.capture is not None):
            raise ValueError('robots: expected "auto" with a wanted capture, and only then')
        if self.robots == "auto":
            refuse(self, 'with robots "auto"', "base", "lost")
        if self.strategy == "capture":
            refuse(self, 'for "capture", whose robots do not report', "base")
            refuse(self, 'for "capture"', "share")
        else:
            refuse(self, f"for {self.strategy!r}", "randomness", "frontier", "starts")
        if not self.attack_times:
            raise ValueError("attack_times: expected at least one")
        if self.base is None:
            refuse(self, "without a base", "base_range", "lost")
        if self.robots == "auto" or self.lost is None:
            return
        if not 0 <= self.lost < self.robots:
            raise ValueError(
                f"lost: there is no robot {self.lost}; robots are 0 to {self.robots - 1}"
            )
        if self.robots == 1:
            raise ValueError("lost: robot 0 is the only one; none would be left to patrol")

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        return estimates.patrol(extent)

    def run(self, say: Say = silent) -> "PatrolledMap":
        import jax

        from .. import patrol
        from ..patrol.map.policies import smallest_covers
        from ..space import visible_cells

        cells = self.cells()
        say(f"looking around from {cells.positions:,} cells")
        graph = self._graph(cells)
        visible = visible_cells(cells, self.range)
        target = None if self.target is None else _position(cells, self.target, "target")
        regions = self._regions(cells, graph)

        found = self._patrolled(graph, visible, regions, say)
        policies = found["policies"]
        if self.frontier:
            say(f"searching at {len(self.frontier)} floors of randomness")
            problem = graph, visible, len(policies), self.attack_times[0], self.frontier
            found["frontier"] = patrol.map.capture_frontier(
                *problem, start=self.start, seed=self.seed
            )
        if self.lost is not None and regions is not None:
            found["reassignment"] = patrol.map.reassign(
                graph, visible, regions, policies, self.lost, share=found["chosen_share"]
            )
        say("attacking every cell")
        times = list(self.attack_times)
        capture = patrol.capture_probabilities(graph, visible, policies, times, self.start)
        contested = patrol.map.contested(visible, policies, regions)
        target = self._target(target, contested, capture[0], regions)
        say(f"simulating {self.runs:,} attacks, and fitting their law")
        attack = patrol.vulnerability(
            jax.random.key(self.seed),
            graph,
            visible,
            policies,
            target,
            times,
            start=self.start,
            runs=self.runs,
        )
        say("comparing covers")
        return patrol.PatrolledMap(
            cells=cells,
            reach=self.range,
            graph=graph,
            visible=visible,
            attack=attack,
            capture=capture,
            regions=regions,
            start=self.start,
            smallest_covers=smallest_covers(visible, policies),
            seed=self.seed,
            **found,
        )

    def _patrolled(
        self, graph: "Graph", visible: "np.ndarray", regions: "Regions | None", say: Say
    ) -> dict[str, Any]:
        """The policies of as many robots as are asked for, or as the wanted capture takes."""
        import numpy as np

        from .. import patrol

        most = min(_MAX_ROBOTS, graph.vertices) if self.robots == "auto" else self.robots
        made = {}
        if self.strategy != "capture":
            made = self._emphasised(graph, visible, most, regions, say)
        reached: list[float] = []
        for robots in range(most if self.capture is None else 1, most + 1):
            if made:
                some = {share: policies[:robots] for share, policies in made.items()}
                found, least = self._chosen(graph, visible, some, regions)
            else:
                say(f"searching for the patrol of {robots} robots that captures most")
                search = patrol.capture_policies(
                    graph,
                    visible,
                    robots,
                    self.attack_times[0],
                    randomness=self.randomness,
                    start=self.start,
                    starts=self.starts,
                    seed=self.seed,
                )
                found, least = {"policies": search.policies, "search": search}, search.value
            reached.append(least)
            if self.capture is not None:
                say(f"a team of {robots} captures {least:.3f} at least")
                if least >= self.capture:
                    break
        if self.capture is not None:
            found |= {"size_capture": np.array(reached), "wanted": self.capture}
        return found

    def _emphasised(
        self,
        graph: "Graph",
        visible: "np.ndarray",
        robots: int,
        regions: "Regions | None",
        say: Say,
    ) -> "dict[float, tuple[Policy, ...]]":
        """The policies of the share that is asked for, or of those among which one is chosen."""
        from .. import patrol

        tried = _SHARES if self.share == "auto" else tuple(sorted({0.0, self.share}))
        if graph.vertices > MAX_VERTICES:
            # One search takes a minute and more.
            tried = (0.0,) if self.share == "auto" else (self.share,)
        made = {}
        for share in tried:
            say(f"making policies for {robots} robots, with a share of {share:g}")
            if regions is None:
                made[share] = patrol.distributed_policies(graph, visible, robots, share)
            else:
                made[share] = patrol.map.centralized_policies(graph, visible, regions, share)
        return made

    def _chosen(
        self,
        graph: "Graph",
        visible: "np.ndarray",
        made: "dict[float, tuple[Policy, ...]]",
        regions: "Regions | None",
    ) -> tuple[dict[str, Any], float]:
        """The policies of the best share, or of that asked for, and what they capture at least."""
        import numpy as np

        from .. import patrol

        least = []
        for policies in made.values():
            (caught,) = patrol.capture_probabilities(
                graph, visible, policies, [self.attack_times[0]], self.start
            )
            least.append(caught[patrol.map.contested(visible, policies, regions)].min(initial=1.0))
        tried = list(made)
        # Shares that differ by rounding count as equal, and the first of them is taken.
        best = (
            int(np.argmax(np.round(least, 9))) if self.share == "auto" else tried.index(self.share)
        )
        found = {
            "policies": made[tried[best]],
            "chosen_share": tried[best],
            "shares": np.array(tried),
            "share_capture": np.array(least),
        }
        return found, float(least[best])

    def spec(self, result: Any) -> dict[str, Any]:
        spec = super().spec(result)
        if self.base is not None and self.base_range is None:
            spec["base_range_m"] = self.range
        if self.target is None:
            x, y = result.xy[result.attack.target]
            spec["target"] = f"{x:g},{y:g}"
        return spec

    def write(self, result: Any, out: Path) -> None:
        import numpy as np

        from ..base.paths import name_in_results
        from ..robot.tasks.patrol_task import save_patrols

        chains = [policy.chain for policy in result.policies]
        save_patrols(
            out / "patrol.json",
            result.cells,
            [(np.asarray(chain.image), np.asarray(chain.probability)) for chain in chains],
            # Where it reports, or sees most.
            [
                int(policy.cover[0] if policy.contact is None else policy.contact)
                for policy in result.policies
            ],
            self.range,
            map=name_in_results(self.map),
            name=result.cells.workspace.name,
        )

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_patrolled_map

        return compare_patrolled_map(result)

    def _graph(self, cells: "CellSpace") -> "Graph":
        """The graph of the cells, which is connected."""
        import numpy as np
        from scipy.sparse.csgraph import connected_components

        from ..patrol import cell_graph

        if cells.positions > MAX_CELLS:
            raise ValueError(
                f"{self.map}: cells of {cells.cell:g} m are {cells.positions:,}; policies are "
                f"computed for at most {MAX_CELLS:,}; expected larger cells"
            )
        if self.robots != "auto" and self.robots > cells.positions:
            raise ValueError(
                f"robots: {self.robots} robots are more than the {cells.positions} cells of "
                f"{self.map}"
            )
        graph = cell_graph(cells)
        pieces, piece = connected_components(graph.matrix(np.ones(len(graph.edges))))
        if pieces > 1:
            x, y, _ = cells.centre(np.array([0, np.flatnonzero(piece != piece[0])[0]]))
            raise ValueError(
                f"{self.map}: its cells are in {pieces} separate pieces; no way leads from "
                f"({x[0]:g}, {y[0]:g}) to ({x[1]:g}, {y[1]:g})"
            )
        return graph

    def _regions(self, cells: "CellSpace", graph: "Graph") -> "Regions | None":
        """The regions around the base station, if there is one."""
        from ..patrol.map import angular_regions, base_station
        from ..space import visible_cells

        if self.base is None:
            return None
        seen = visible_cells(cells, self.range if self.base_range is None else self.base_range)
        base = None if self.base == "auto" else _position(cells, self.base, "base")
        with about("base"):
            base = base_station(graph, seen) if base is None else base
            return angular_regions(graph, base, seen[base], int(self.robots))

    def _target(
        self,
        asked: int | None,
        contested: "np.ndarray",
        caught: "np.ndarray",
        regions: "Regions | None",
    ) -> int:
        """The cell that is attacked: one where luck decides, by default the weakest."""
        from ..patrol.map.attack import weakest

        if asked is None:
            if contested.size == 0:
                raise ValueError(
                    f"range: with {self.range:g} m no robot ever sees the whole of a cell that is "
                    "not watched anyway; expected more"
                )
            return int(weakest(caught[None], contested)[0])
        if asked in contested:
            return asked
        if regions is not None and regions.view[asked]:
            why = "the base station always sees it, so that no attack succeeds"
        else:
            why = "no robot ever sees it, so that any attack succeeds"
        raise ValueError(f"target {self.target!r}: {why}")


def _position(cells: "CellSpace", text: str, parameter: str) -> int:
    """The position that a parameter names, as "x,y" in metres."""
    x, y = numbers(parameter, text, 2, '"x,y" in metres')
    with about(f"{parameter} {text!r}"):
        return int(cells.index(x, y)) % cells.positions
