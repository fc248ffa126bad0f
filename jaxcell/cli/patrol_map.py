import dataclasses
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ..files import name_in_results
from .options import MapOptions, OutputOptions, starting
from .patrol_map_summary import describe, show
from .terminal import note, status, stdout_on_stderr


if TYPE_CHECKING:
    from ..optimize import Graph
    from ..patrol import Policy, Reassignment, Regions
    from ..record import MapPatrol
    from ..space import CellSpace


# The edges by edges matrix of the weights' Hessian would not fit, nor be done today.
_MOST_CELLS = 1500
_MOST_RUNS = 10_000_000
# The shares that are mixed against the adversary, besides the one that is asked for.
_SHARES = (0.0, 0.2, 0.5, 0.8, 0.95)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolMap(OutputOptions):
    """Patrol a map with robots that see only so far, and tell how vulnerable it is then."""

    map: tyro.conf.Positional[Path]
    """Map file: our .json, a ROS map_server .yaml, or an ASCII grid .txt."""
    robots: int = 2
    """How many robots patrol."""
    reach: Annotated[float, tyro.conf.arg(name="range")] = 6.0
    """How far a robot sees, in metres; walls are in the way."""
    cell: float | None = None
    """Side of a cell in metres; by default what the map suggests."""
    share: float = 0.8
    """Least share of steps on the shortest closed tour through the cells from which all is seen."""
    base: str | None = None
    """Base station to report to, around which each robot has a region: "x,y" in metres, or "auto"
    for a central place that sees much. Without it each robot patrols the whole map."""
    base_range: float | None = None
    """How far the base station sees, in metres; by default --range."""
    lost: int | None = None
    """A robot that stops reporting to the base station; the others divide the map anew."""
    target: str | None = None
    """The cell that is attacked, "x,y" in metres; by default the one that is most vulnerable to the
    first of --attack-times."""
    attack_times: tuple[int, ...] = (20, 30, 40, 50, 100, 500)
    """The steps that an attack takes."""
    runs: int = 5000
    """How often to simulate an attack."""
    seed: int = 0
    """Seed of the simulation, and of the patrol that is recorded."""

    def run(self) -> int:
        from .. import estimates

        self._check()
        cells = MapOptions(map=self.map, cell=self.cell).cells(estimates.cutting, "the cells")
        with starting():
            from .. import patrol  # noqa: F401
        began = time.perf_counter()
        try:
            with stdout_on_stderr():
                found = self._patrol(cells)
                with status("comparing covers"):
                    described = describe(found)
        except RuntimeError as error:
            note(f"jaxcell patrol map: {error}")
            return 1
        seconds = time.perf_counter() - began
        spec = self._spec(cells)
        summary = {**spec, **described, "seconds": round(seconds, 3)}
        if self.out is not None:
            self._write(self.out, found, spec)
        return self.finish(
            summary,
            lambda: show(summary),
            lambda verify: verify.compare_patrol(
                cells,
                self.reach,
                found.graph,
                found.visible,
                found.policies,
                found.attack,
                found.capture,
            ),
        )

    def _patrol(self, cells: "CellSpace") -> "MapPatrol":
        """All that is asked of the map."""
        import jax

        from .. import patrol, record
        from ..space import visible_cells

        with status(f"looking around from {cells.positions:,} cells"):
            graph = self._graph(cells)
            visible = visible_cells(cells, self.reach)
            target = None if self.target is None else _place(cells, self.target, "--target")
            regions = self._regions(cells, graph)
        with status(f"making policies for {self.robots} robots"):
            policies = self._policies(graph, visible, regions, self.share)
            reassignment = self._reassignment(graph, visible, regions, policies)
        with status("attacking every cell"):
            times = list(self.attack_times)
            capture = patrol.capture_probabilities(graph, visible, policies, times)
            open_ = patrol.contested(visible, policies, regions)
            if target is None:
                target = self._weakest(open_, capture[0])
            elif target not in open_:
                raise ValueError(_not_contested(target, self.target, regions))
        with status(f"simulating {self.runs:,} attacks, and fitting their law"):
            attack = patrol.vulnerability(
                jax.random.key(self.seed), graph, visible, policies, target, times, runs=self.runs
            )

        def with_share(share: float) -> tuple["Policy", ...]:
            same = share == self.share
            return policies if same else self._policies(graph, visible, regions, share)

        with status("mixing policies against the adversary"):
            shares = sorted({*_SHARES, self.share})
            game = patrol.share_game(graph, visible, with_share, shares, times[0], open_)
        return record.MapPatrol(
            cells=cells,
            reach=self.reach,
            graph=graph,
            visible=visible,
            policies=policies,
            attack=attack,
            capture=capture,
            regions=regions,
            reassignment=reassignment,
            game=game,
        )

    def _check(self) -> None:
        """Raises `ValueError` for options that no map could make good."""
        for option, far in (("--range", self.reach), ("--base-range", self.base_range)):
            if far is not None and not (far > 0 and math.isfinite(far)):
                raise ValueError(f"{option}: expected more than 0 m, and finite, got {far}")
        if self.robots < 1:
            raise ValueError(f"--robots: expected at least 1, got {self.robots}")
        if not 0 <= self.share < 1:
            raise ValueError(f"--share: expected 0 or more and less than 1, got {self.share}")
        if not self.attack_times:
            raise ValueError("--attack-times: expected at least one")
        for one in self.attack_times:
            if one < 1:
                raise ValueError(f"--attack-times: expected at least 1 step, got {one}")
        if not 2 <= self.runs <= _MOST_RUNS:
            raise ValueError(f"--runs: expected 2 or more, up to {_MOST_RUNS:,}, got {self.runs}")
        for option in ("base_range", "lost"):
            if self.base is None and getattr(self, option) is not None:
                raise ValueError(f"--{option.replace('_', '-')} has no meaning without --base")
        if self.lost is not None and not 0 <= self.lost < self.robots:
            raise ValueError(
                f"--lost: there is no robot {self.lost}; robots are 0 to {self.robots - 1}"
            )
        if self.lost is not None and self.robots == 1:
            raise ValueError("--lost: robot 0 is the only one; none would be left to patrol")

    def _graph(self, cells: "CellSpace") -> "Graph":
        """The graph of the cells, which is connected."""
        import numpy as np
        from scipy.sparse.csgraph import connected_components

        from ..patrol import cell_graph

        if cells.positions > _MOST_CELLS:
            raise ValueError(
                f"{self.map}: cells of {cells.cell:g} m are {cells.positions:,}; policies are "
                f"computed for at most {_MOST_CELLS:,}; expected a larger --cell"
            )
        if self.robots > cells.positions:
            raise ValueError(
                f"--robots: {self.robots} robots are more than the {cells.positions} cells of "
                f"{self.map}"
            )
        graph = cell_graph(cells)
        pieces, piece = connected_components(graph.matrix(np.ones(len(graph.edges))))
        if pieces > 1:
            other = int(np.flatnonzero(piece != piece[0])[0])
            raise ValueError(
                f"{self.map}: its cells are in {pieces} separate pieces; no way leads from "
                f"{_name(cells, 0)} to {_name(cells, other)}"
            )
        return graph

    def _regions(self, cells: "CellSpace", graph: "Graph") -> "Regions | None":
        """The regions around the base station, if there is one."""
        from ..patrol import angular_regions, base_station
        from ..space import visible_cells

        if self.base is None:
            return None
        seen = visible_cells(cells, self.reach if self.base_range is None else self.base_range)
        try:
            if self.base == "auto":
                base = base_station(graph, seen)
            else:
                base = _place(cells, self.base, "--base")
            return angular_regions(graph, base, seen[base], self.robots)
        except ValueError as error:
            said = str(error)
            raise ValueError(said if said.startswith("--base") else f"--base: {said}") from None

    def _policies(
        self, graph: "Graph", visible: Any, regions: "Regions | None", share: float
    ) -> tuple["Policy", ...]:
        from ..patrol import centralized_policies, distributed_policies

        if regions is None:
            return distributed_policies(graph, visible, self.robots, share)
        return centralized_policies(graph, visible, regions, share)

    def _reassignment(
        self,
        graph: "Graph",
        visible: Any,
        regions: "Regions | None",
        policies: tuple["Policy", ...],
    ) -> "Reassignment | None":
        from ..patrol import reassign

        if self.lost is None or regions is None:
            return None
        return reassign(graph, visible, regions, policies, self.lost, share=self.share)

    def _weakest(self, open_: Any, caught: Any) -> int:
        """The cell that is most vulnerable."""
        if open_.size == 0:
            raise ValueError(
                f"--range: with {self.reach:g} m no robot ever sees the whole of a cell that is "
                "not watched anyway; expected more"
            )
        return int(open_[caught[open_].argmin()])

    def _spec(self, cells: "CellSpace") -> dict[str, Any]:
        """What determines the result."""
        assert cells.workspace is not None
        spec: dict[str, Any] = {
            "map": name_in_results(self.map),
            "name": cells.workspace.name,
            "cell_m": cells.cell,
            "positions": cells.positions,
            "robots": self.robots,
            "range_m": self.reach,
            "share": self.share,
        }
        if self.base is not None:
            far = self.reach if self.base_range is None else self.base_range
            spec |= {"base": self.base, "base_range_m": far}
        if self.lost is not None:
            spec["lost"] = self.lost
        times = {"attack_times": list(self.attack_times)}
        return {**spec, **times, "runs": self.runs, "seed": self.seed}

    def _write(self, out: Path, found: "MapPatrol", spec: dict[str, Any]) -> None:
        import numpy as np

        from .. import record
        from ..robot.patrol_task import save_patrols

        with status(f"writing {out}"):
            out.mkdir(parents=True, exist_ok=True)
            dataset = record.patrol_map_dataset(found, spec=spec)
            record.save_dataset(dataset, out / "patrol_map.nc")
            record.log_patrol_map(out / "patrol_map.rrd", found, seed=self.seed, spec=spec)
            save_patrols(
                out / "patrol.json",
                found.cells,
                [
                    (np.asarray(policy.chain.image), np.asarray(policy.chain.probability))
                    for policy in found.policies
                ],
                # Where it reports, or sees most.
                [
                    int(policy.cover[0] if policy.contact is None else policy.contact)
                    for policy in found.policies
                ],
                self.reach,
                map=spec["map"],
                name=spec["name"],
            )


def _place(cells: "CellSpace", text: str, option: str) -> int:
    """The position that an option names, as "x,y" in metres."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f'{option} {text!r}: expected "x,y" in metres') from None
    try:
        return int(cells.index(x, y)) % cells.positions
    except ValueError as error:
        raise ValueError(f"{option} {text!r}: {error}") from None


def _name(cells: "CellSpace", position: int) -> str:
    x, y, _ = cells.centre(position)
    return f"({float(x):g}, {float(y):g})"


def _not_contested(target: int, text: str | None, regions: "Regions | None") -> str:
    if regions is not None and regions.view[target]:
        return f"--target {text!r}: the base station always sees it, so that no attack succeeds"
    return f"--target {text!r}: no robot ever sees it, so that any attack succeeds"
