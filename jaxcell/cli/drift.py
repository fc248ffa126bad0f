import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from ..files import name_in_results
from .drift_summary import describe, show
from .options import OutputOptions, say_memory, starting
from .terminal import note, status


if TYPE_CHECKING:
    import xarray as xr

    from ..drift import Flow, LongTermBehaviour, Water
    from ..record import SeaDrift


# The curve of so many cells, and the groups for other steps, take seconds.
_MOST_FOR_CURVE = 20_000
_MOST_FOR_COUNTS = 100_000
_FACTORS = (0.5, 1.0, 2.0, 4.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drift(OutputOptions):
    """Find where an ocean current carries drifters, where to drop them, and their way to a goal."""

    file: tyro.conf.Positional[Path]
    """NetCDF file of currents: ROMS, fixed depths, the surface, or HF radar."""
    time: str | None = None
    """One record, by its number from 0 or its moment (2016-02-02T12:00); by default the mean of all
    records."""
    depths: tuple[float, ...] = ()
    """Depths of the layers in metres; by default those of the file, or the surface."""
    bounds: tuple[float, float, float, float] | None = None
    """West, south, east and north of the part to read, in degrees."""
    variables: tuple[str, str] | None = None
    """Names of the velocities towards the East and North, where the file leaves it open."""
    duration: float | None = None
    """Seconds that a step takes; by default the time in which drifters of the slowest layer drift
    by one cell on average."""
    rho: float = 0.8
    """Probability that a step goes where the current says; see --spread for the rest."""
    spread: Literal["turned", "all", "sampled"] = "turned"
    """Where a step may go instead: along the current turned by 45 degrees to either side; to all
    cells around its end; or, for a known current, wherever points of the cell go."""
    edge: Literal["uniform", "exit"] = "uniform"
    """Whether drifters at a coast or the edge of the map go on to any cell beside them, as in the
    dissertation, or drift like others and may leave the map."""
    start: str | None = None
    """Where a drifter is dropped, "lon,lat" in degrees."""
    goal: str | None = None
    """Where it is to be, "lon,lat,depth" in degrees and metres; it may go up and down."""
    reach: Annotated[float | None, tyro.conf.arg(name="range")] = None
    """How far a drifter that looks at the sea bed sees, in metres."""
    discount: float = 0.99
    """What a step later is worth, for the way to the goal."""
    seed: int = 0
    """Seed of the drifters that are recorded."""

    def run(self) -> int:
        self._check()
        with starting():
            from ..drift import open_currents
        began = time.perf_counter()
        try:
            with status(f"reading {self.file}"):
                currents = open_currents(
                    self.file,
                    time=self._record(),
                    depths=self.depths or None,
                    bounds=self.bounds,
                    variables=self.variables,
                )
            drift, counts = self._study(currents)
        except RuntimeError as error:
            note(f"jaxcell drift: {error}")
            return 1
        spec = self._spec(drift)
        with status("telling where drifters end up"):
            described = describe(drift, counts, self.spread)
        seconds = time.perf_counter() - began
        summary = {**spec, **described, "seconds": round(seconds, 3)}
        if self.out is not None:
            self._write(self.out, drift, spec)
        differs = self.finish(
            summary,
            lambda: show(summary),
            lambda verify: verify.compare_drift(
                currents,
                drift.waters,
                drift.behaviours,
                drift.ends,
                drift.deployment,
                rho=self.rho,
                spread=self.spread,
                edge=self.edge,
            ),
        )
        if drift.surest is None or drift.start is None or drift.surest.probability[drift.start] > 0:
            return differs
        note("No policy brings a drifter from the start to the goal.")
        return 1

    def _check(self) -> None:
        """Raises `ValueError` for options that no current could make good."""
        if not 0 <= self.rho <= 1:
            raise ValueError(f"--rho: expected a probability from 0 to 1, got {self.rho}")
        if self.duration is not None and not 0 < self.duration < float("inf"):
            raise ValueError(f"--duration: expected more than 0 seconds, got {self.duration}")
        if not 0 < self.discount < 1:
            raise ValueError(
                f"--discount: expected more than 0 and less than 1, got {self.discount}"
            )
        if self.reach is not None and not self.reach > 0:
            raise ValueError(f"--range: expected more than 0 m, got {self.reach}")

    def _record(self) -> int | str | None:
        if self.time is None:
            return None
        try:
            return int(self.time)
        except ValueError:
            return self.time

    def _study(self, currents: "xr.Dataset") -> tuple["SeaDrift", dict[str, Any] | None]:
        """All that is asked for; and the numbers of groups for other steps."""
        from .. import drift, estimates, memory
        from ..record import SeaDrift

        layers = range(currents.sizes["layer"])
        waters = [drift.Water.of(currents, layer) for layer in layers]
        needed = estimates.drift([water.cells for water in waters])
        doing = f"drift in {sum(water.cells for water in waters):,} cells of water"
        memory.check(needed, doing, "choose less with --bounds, or fewer --depths")
        say_memory(needed, doing)
        flows = [drift.Flow.of(currents, layer).mean() for layer in layers]
        start = None if self.start is None else self._start(waters[0])
        goal = None if self.goal is None else self._goal(waters)
        duration = self.duration
        if duration is None:
            duration = max(map(drift.crossing_time, waters, flows))
        behaviours, diagnoses = [], []
        for water, flow in zip(waters, flows, strict=True):
            with status(f"mapping {water.cells:,} cells at {water.depth:g} m"):
                behaviour = self._behaviour(water, flow, duration)
                behaviours.append(behaviour)
                diagnoses.append(drift.diagnose(water, flow, behaviour.groups, duration))
        with status("choosing where to drop drifters"):
            surface = behaviours[0]
            small = waters[0].cells <= _MOST_FOR_CURVE
            deployment = drift.deployment_cells(surface)
            minimum = drift.minimum_deployment(surface.chain)
            curve = drift.coverage_curve(surface.chain) if small else None
            views = None
            if self.reach is not None:
                see = drift.visible_deployment
                views = _named("--range", see, waters[0], self.reach, surface.groups)
        voyage = surest = None
        if goal is not None:
            sea = drift.Sea.of(waters, [one.chain for one in behaviours])
            with status(f"finding the way to the goal from {sea.cells:,} cells"):
                voyage = drift.discounted_voyage(sea, goal, self.discount)
                surest = drift.surest_voyage(sea, goal)
        counts = None
        if waters[0].cells <= _MOST_FOR_COUNTS:
            with status("counting groups for other steps"):
                counts = self._counts(waters[0], flows[0], duration)
        found = SeaDrift(
            currents,
            tuple(behaviours),
            tuple(diagnoses),
            deployment,
            minimum,
            curve=curve,
            views=views,
            reach=self.reach,
            start=start,
            voyage=voyage,
            surest=surest,
        )
        return found, counts

    def _behaviour(self, water: "Water", flow: "Flow", duration: float) -> "LongTermBehaviour":
        from ..drift import drift_map, long_term_behaviour

        chain = drift_map(water, flow, duration, rho=self.rho, spread=self.spread, edge=self.edge)
        # Where drifters stay almost for ever, times are only roughly right; all else is of use.
        return long_term_behaviour(chain, duration, throw=False)

    def _counts(self, water: "Water", flow: "Flow", duration: float) -> dict[str, Any]:
        """The numbers of persistent groups for other steps, and for a current that is known."""
        from ..drift import group_counts

        durations = [factor * duration for factor in _FACTORS]
        rhos = [1.0] if self.spread == "sampled" or self.rho == 1 else [1.0, self.rho]
        found = group_counts(water, flow, durations, rhos, spread=self.spread, edge=self.edge)
        return {"durations_s": durations, "rhos": rhos, "groups": found.tolist()}

    def _start(self, water: "Water") -> int:
        lon, lat = _numbers(self.start, 2, "--start", '"lon,lat" in degrees')
        return int(_named(f"--start {self.start}", water.cell, lon, lat))

    def _goal(self, waters: list["Water"]) -> int:
        """The number of the goal among the cells of all layers."""
        wanted = '"lon,lat,depth" in degrees and metres'
        lon, lat, depth = _numbers(self.goal, 3, "--goal", wanted)
        depths = [water.depth for water in waters]
        near = [layer for layer, one in enumerate(depths) if abs(one - depth) < 0.005]
        if not near:
            listed = ", ".join(f"{one:g}" for one in depths)
            raise ValueError(
                f"--goal {self.goal}: expected one of the depths {listed} m, got {depth:g}"
            )
        cell = _named(f"--goal {self.goal}", waters[near[0]].cell, lon, lat)
        return int(cell) + sum(water.cells for water in waters[: near[0]])

    def _spec(self, drift: "SeaDrift") -> dict[str, Any]:
        """What determines the result."""
        spec: dict[str, Any] = {
            "file": name_in_results(self.file),
            **({} if self.time is None else {"time": self.time}),
            "depths_m": drift.depths,
            **({} if self.bounds is None else {"bounds": list(self.bounds)}),
            **({} if self.variables is None else {"variables": list(self.variables)}),
            "duration_s": drift.duration,
            "rho": self.rho,
            "spread": self.spread,
            "edge": self.edge,
        }
        if self.start is not None:
            spec["start"] = self.start
        if self.goal is not None:
            spec |= {"goal": self.goal, "discount": self.discount}
        if self.reach is not None:
            spec["range_m"] = self.reach
        return {**spec, "seed": self.seed}

    def _write(self, out: Path, drift: "SeaDrift", spec: dict[str, Any]) -> None:
        from .. import record

        with status(f"writing {out}"):
            out.mkdir(parents=True, exist_ok=True)
            record.save_dataset(record.drift_dataset(drift, spec=spec), out / "drift.nc")
            record.save_deployment_csv(drift, out / "deployment.csv")
            record.save_deployment_geojson(drift, out / "deployment.geojson")
            record.log_drift(out / "drift.rrd", drift, seed=self.seed, spec=spec)


def _numbers(text: str | None, count: int, option: str, expected: str) -> list[float]:
    assert text is not None
    try:
        found = [float(part) for part in text.split(",")]
        if len(found) != count:
            raise ValueError
    except ValueError:
        raise ValueError(f"{option} {text!r}: expected {expected}") from None
    return found


def _named(option: str, function: Any, *arguments: Any) -> Any:
    """Calls a function, whose complaints are about an option."""
    try:
        return function(*arguments)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None
