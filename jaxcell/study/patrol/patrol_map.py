import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

from ... import optimize, patrol, space, verify as verification
from ...base.limits import MAX_CELLS
from ...base.secondary import Secondary
from ..batches import Numbers, stacked
from ..map_study import CellStudy
from ..parameters import AtLeastOne, Headings, Limit, Metres, Needed, Only
from ..study import Say, Wanted, about, every, numbers, scalars, silent


if TYPE_CHECKING:
    import numpy as np


_Reach: TypeAlias = Annotated[Metres, Limit(gt=0)]
_Floor: TypeAlias = Annotated[float, Limit(ge=0, lt=1)]
_CAPTURE = Only(strategy="capture")
# Numbers that attacks do not change.
_OF_MAP = ("edges", "mean_cells_seen", "least_cells_seen", "most_cells_seen")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolMap(CellStudy):
    """Patrol a map with robots of limited sight, and compute its vulnerability to attacks."""

    name: ClassVar[str] = "patrol_map"
    command: ClassVar[str] = "patrol map"
    example: ClassVar[str] = "@depot --robots 2 --range 6"
    task: ClassVar[str] = "patrol_map"
    varied: ClassVar[tuple[str, ...]] = ("attack_times",)
    headings: ClassVar[Headings] = {
        "What do robots see and report?": ("sight", "base_range", "lost"),
        "How is a walk chosen?": ("randomness", "frontier", "initial_walks"),
        "How is an attack simulated?": ("distribution", "runs"),
    }

    robots: AtLeastOne | Literal["auto"] = 2
    """Number of robots; "auto" chooses the smallest number, up to 20, that reaches --capture."""
    capture: Annotated[Annotated[float, Limit(gt=0, lt=1)] | None, Needed(robots="auto")] = None
    """Probability of capture that the robots must reach, for the first of the attack times."""
    range: _Reach = 6.0
    """Range of sight of a robot in metres: it sees what is nearer, unless walls block the view."""
    sight: Literal["centre", "cell", "source"] = "centre"
    """Condition for a robot in one cell to see another cell: the other cell's centre (centre) or
    all of it (cell) is visible from the centre of the robot's cell; or all of the robot's cell is
    visible from the other cell's centre (source, as for attacks in Alam 2018)."""
    strategy: Literal["commute", "capture"] = "commute"
    """Aim of the walks: the shortest mean commute time between cells (commute), or the highest
    probability of capture at the weakest cell (capture). The search for the latter finds a local
    maximum, for the first of the attack times and the given --distribution."""
    share: Annotated[_Floor | Literal["auto"], Only(strategy="commute")] = "auto"
    """Minimum share of steps on the shortest closed tour through the cells that see the whole map.
    "auto" tries 0, 0.2, 0.5 and 0.8, and takes the share with the highest probability of capture;
    on more than 2,000 cells it takes 0."""
    distribution: Literal["stationary", "uniform", "worst"] = "stationary"
    """Distribution of each robot when an attack begins, over its cells that do not see the target:
    as in the long run (stationary), uniform, or best for the adversary (worst)."""
    randomness: Annotated[_Floor, _CAPTURE] = 0.0
    """Minimum share of steps in which a robot chooses a neighbour uniformly at random."""
    frontier: Annotated[tuple[_Floor, ...], _CAPTURE] = ()
    """Values of --randomness for which capture and entropy are compared."""
    initial_walks: Annotated[AtLeastOne, _CAPTURE] = 2
    """Number of initial walks of the search: a tour that sees the whole map, then random walks."""
    base: Annotated[str | None, Only(strategy="commute", capture=False)] = None
    """Base station where robots report, and around which each robot has a region: "x,y" in metres,
    or "auto" for a central place with a wide view. By default each robot patrols the whole map."""
    base_range: Annotated[_Reach | None, Only(base=True)] = None
    """Range of sight of the base station in metres; by default the range of a robot."""
    lost: Annotated[int | None, Only(base=True)] = None
    """Index, from 0, of a robot that stops reporting. The other robots divide the whole map."""
    target: str | None = None
    """Cell to attack, "x,y" in metres; by default the most vulnerable cell at the first of the
    attack times."""
    attack_times: tuple[Annotated[int, Limit(ge=1)], ...] = (20, 30, 40, 50, 100)
    """Durations of an attack in steps."""
    runs: Annotated[int, Limit(ge=2, le=10_000_000)] = 5000
    """Number of simulated attacks."""
    seed: int = 0
    """Seed of the simulation, and of the recorded patrol."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.attack_times:
            raise ValueError("attack_times: expected at least one")
        if self.robots == "auto" or self.lost is None:
            return
        if not 0 <= self.lost < self.robots:
            raise ValueError(
                f"lost: there is no robot {self.lost}; robots are 0 to {self.robots - 1}"
            )
        if self.robots == 1:
            raise ValueError("lost: robot 0 is the only one; none would be left to patrol")

    def needed(self, extent: "space.Extent") -> float | int:
        return space.estimates.patrol(extent)

    def run(self, say: Say = silent) -> "patrol.PatrolledMap":
        import jax

        from ...patrol.map.policies import smallest_covers
        from .teams import find_team

        cells = self.cells()
        say(f"looking around from {cells.positions:,} cells")
        graph = self._graph(cells)
        visible = self._visible(cells, self.range)
        target = None if self.target is None else _position(cells, self.target, "target")
        regions = self._regions(cells, graph)

        attack, beside = patrol.Attack(self.attack_times, self.distribution), Secondary()
        team, size_capture = find_team(self, graph, visible, regions, attack, say)
        site = graph, visible, team.policies
        frontier = self._frontier(graph, visible, len(team.policies), attack, beside, say)
        say("attacking every cell")
        capture = patrol.Capture.of(*site, attack, regions)
        round = beside.compute(
            "the evenly spaced round",
            lambda: patrol.team.round_on_map(
                graph, visible, len(team.policies), self.attack_times[0], capture.contested
            ),
        )
        after = self._reassignment(*site, regions, team.chosen_share, beside)
        loss, recovery = None, None
        if after is not None:
            left = [team.policies[robot] for robot in sorted(after.robot.tolist())]
            loss, recovery = (
                dataclasses.replace(
                    patrol.Capture.of(graph, visible, by, attack), contested=capture.contested
                )
                for by in (left, after.policies)
            )
        target = self._target(target, capture, regions)
        say(f"simulating {self.runs:,} attacks, and fitting their law")
        key = jax.random.key(self.seed)
        attacked = patrol.vulnerability(key, *site, target, attack, runs=self.runs)
        say("comparing covers")
        return patrol.PatrolledMap(
            cells=cells,
            reach=self.range,
            sight=self.sight,
            graph=graph,
            visible=visible,
            policies=team.policies,
            attack=attacked,
            captures=capture,
            regions=regions,
            reassignment=after,
            loss=loss,
            recovery=recovery,
            search=team.search,
            frontier=frontier,
            round=round,
            share=team.share,
            share_capture=team.share_capture,
            chosen_share=team.chosen_share,
            size_capture=size_capture,
            wanted=self.capture,
            smallest_covers=smallest_covers(visible, team.policies),
            seed=self.seed,
            left_out=beside.left_out,
        )

    def numbers(self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = every) -> Numbers:
        if not columns:
            return super().numbers(columns, wanted)
        import numpy as np

        from .teams import teams_at_times

        times, which = np.unique(columns["attack_times"], return_inverse=True)
        members = [dataclasses.replace(self, attack_times=(time,)) for time in times.tolist()]
        if self.strategy == "capture" or self.capture is not None:
            return stacked([scalars(one.run(), (), wanted) for one in members], which)
        # No number depends on simulated attacks.
        result = dataclasses.replace(members[0], runs=2).run()
        site = result.graph, result.visible, result.regions
        shared, found = scalars(result, (), wanted), []
        for team, capture in teams_at_times(self, *site, times.tolist()):
            attack = dataclasses.replace(result.attack, attack_time=capture.attack.times)
            one = dataclasses.replace(
                result,
                policies=team.policies,
                chosen_share=team.chosen_share,
                captures=capture,
                attack=attack,
            )
            found.append(scalars(one, (), lambda name: name in shared and name not in _OF_MAP))
        return shared | stacked(found, which)

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

        from ...robot.tasks.patrol_task import save_patrols

        chains = [policy.chain for policy in result.policies]
        save_patrols(
            out / "patrol.json",
            result.cells,
            [(np.asarray(chain.image), np.asarray(chain.probability)) for chain in chains],
            # The cell where the robot reports, or the cell that it visits most.
            [
                int(np.argmax(policy.share_of_time(result.graph)))
                if policy.contact is None
                else policy.contact
                for policy in result.policies
            ],
            self.range,
            map=self.spec(result)["map"],
            name=result.cells.workspace.name,
        )
        if result.round is not None:
            self._write_round(result, out)

    def _write_round(self, result: Any, out: Path) -> None:
        """Write the round: the cell of each robot over time, and the walks of robots on it."""
        import numpy as np

        from ...base.paths import replacing
        from ...robot.tasks.patrol_task import save_patrols

        walk, robots = result.round.walk, len(result.policies)
        turned = [np.roll(walk, -(robot * walk.size // robots)) for robot in range(robots)]
        save_patrols(
            out / "round.json",
            result.cells,
            [patrol.team.walk_around(one, result.cells.positions) for one in turned],
            [int(one[0]) for one in turned],
            self.range,
            map=self.spec(result)["map"],
            name=result.cells.workspace.name,
        )
        with replacing(out / "schedule.csv") as temporary, temporary.open("w") as file:
            print("robot,step,x_m,y_m", file=file)
            for step in range(walk.size):
                for robot, one in enumerate(turned, 1):
                    x, y = result.xy[one[step]]
                    print(f"{robot},{step},{x:g},{y:g}", file=file)

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_patrolled_map(result)

    def _graph(self, cells: "space.CellSpace") -> "optimize.Graph":
        """Build the graph of the cells, and raise if the graph is not connected."""
        import numpy as np

        from ...base.connected import vertices_apart

        if cells.positions > MAX_CELLS:
            raise ValueError(
                f"{self._place}: cells of {cells.cell:g} m are {cells.positions:,}; policies are "
                f"computed for at most {MAX_CELLS:,}; expected larger cells"
            )
        if self.robots != "auto" and self.robots > cells.positions:
            raise ValueError(
                f"robots: {self.robots} robots are more than the {cells.positions} cells of "
                f"{self._place}"
            )
        graph = patrol.cell_graph(cells)
        if (parts := vertices_apart(graph.vertices, graph.edges)) is not None:
            x, y, _ = cells.centre(np.array([parts[1], parts[0][0]]))
            raise ValueError(
                f"{self._place}: its cells are in separate pieces; no way leads from "
                f"({x[0]:g}, {y[0]:g}) to ({x[1]:g}, {y[1]:g})"
            )
        return graph

    def _visible(self, cells: "space.CellSpace", reach: float) -> "np.ndarray":
        from ...space.sight import AT_CENTRE

        part = AT_CENTRE if self.sight == "centre" else 1.0
        visible = space.visible_cells(cells, reach, part=part)
        return visible.T if self.sight == "source" else visible

    def _regions(
        self, cells: "space.CellSpace", graph: "optimize.Graph"
    ) -> "patrol.map.Regions | None":
        if self.base is None:
            return None
        seen = self._visible(cells, self.range if self.base_range is None else self.base_range)
        base = None if self.base == "auto" else _position(cells, self.base, "base")
        with about("base"):
            base = patrol.map.base_station(graph, seen) if base is None else base
            return patrol.map.angular_regions(graph, base, seen[base], int(self.robots))

    def _frontier(
        self,
        graph: "optimize.Graph",
        visible: "np.ndarray",
        robots: int,
        attack: "patrol.Attack",
        beside: Secondary,
        say: Say,
    ) -> "patrol.map.Frontier | None":
        if not self.frontier:
            return None
        say(f"searching at {len(self.frontier)} floors of randomness")
        return beside.compute(
            "the trade-off of capture and randomness",
            lambda: patrol.map.capture_frontier(
                graph, visible, robots, attack, self.frontier, seed=self.seed, say=say
            ),
        )

    def _reassignment(
        self,
        graph: "optimize.Graph",
        visible: "np.ndarray",
        policies: "tuple[patrol.map.Policy, ...]",
        regions: "patrol.map.Regions | None",
        share: float | None,
        beside: Secondary,
    ) -> "patrol.map.Reassignment | None":
        lost = self.lost
        if lost is None or regions is None or share is None:
            return None
        return beside.compute(
            "the division of the map without the lost robot",
            lambda: patrol.map.reassign(graph, visible, regions, policies, lost, share=share),
        )

    def _target(
        self, wanted: int | None, capture: "patrol.Capture", regions: "patrol.map.Regions | None"
    ) -> int:
        """Return `wanted` or the weakest cell; raise if capture is certain or impossible."""
        if wanted is None:
            if capture.contested.size == 0:
                raise ValueError(
                    f"range: with {self.range:g} m no robot sees a cell that is not always "
                    "watched; expected a longer range"
                )
            return int(capture.weakest[0])
        if wanted in capture.contested:
            return wanted
        if regions is not None and regions.view[wanted]:
            why = "the base station always sees it, so that no attack succeeds"
        else:
            why = "no robot ever sees it, so that any attack succeeds"
        raise ValueError(f"target {self.target!r}: {why}")


def _position(cells: "space.CellSpace", text: str, parameter: str) -> int:
    x, y = numbers(parameter, text, "mm", '"x,y" in metres')
    with about(f"{parameter} {text!r}"):
        return int(cells.index(x, y)) % cells.positions
