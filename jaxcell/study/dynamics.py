import dataclasses
import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import tyro

from .. import dynamics, space
from ..base import memory
from ..base.doubts import warn
from ..base.formatting import did_you_mean
from ..base.quantities import quantities
from .batches import Numbers, stacked
from .loading import load_object
from .parameters import WholeNumber
from .study import Say, Study, Wanted, about, every, scalars, silent


# The help of commands does without JAX, which systems need.
if TYPE_CHECKING:
    import numpy as np

    SystemLike: TypeAlias = str | dynamics.System
else:
    SystemLike = str | Any

# Bytes per cell during the computation, per cell of a result, and of a chunk being mapped.
_BYTES_PER_CELL = 24
_KEPT_PER_CELL = 18
_CHUNK_BYTES = 150e6
# Largest number of stored cells for which a dataset and a recording are made.
_MAX_AT_ONCE = 1 << 25
# Largest number of attractors whose shares may be among the results of a sweep.
_SHARES = 8
# The numbers that follow from the images of the cells alone.
_OF_IMAGES = {"groups", "periodic_cells", "longest_step", "self_images"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class SystemStudy(Study):
    """Base class of studies of a dynamical system in a box that is divided into cells."""

    system: tyro.conf.Positional[Annotated[SystemLike, tyro.conf.arg(constructor=str)]] = (
        dataclasses.field(kw_only=False)
    )
    """FILE.py:NAME of a jaxcell.dynamics.System, or one of duffing, pendulum, henon, magnetic,
    lorenz84, thomas and well."""
    params: tuple[str, ...] = ()
    """Values that replace default parameters of the system, such as T=0.5."""
    cells: tuple[int, ...] = ()
    """Number of cells along each axis, or one number for all; by default those of the system."""

    @functools.cached_property
    def chosen(self) -> "dynamics.System":
        """The system, whose numbers of cells the parameter `cells` replaces if it is given."""
        system = load_system(self.system)
        if not self.cells:
            return system

        box = system.box
        cells = self.cells * box.dimensions if len(self.cells) == 1 else self.cells
        return dataclasses.replace(system, box=space.Box(box.lower, box.upper, cells, box.axes))

    def headline(self, spec: dict[str, Any]) -> str:
        name = self.system if isinstance(self.system, str) else "of the program"
        return self.chosen.about or f"The system {name}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dynamics(SystemStudy):
    """Find the attractors of a dynamical system and their basins, on the cells of a box."""

    name: ClassVar[str] = "dynamics"
    command: ClassVar[str] = "dynamics"
    example: ClassVar[str] = "pendulum --params T=0.1:0.9:17"
    task: ClassVar[str] = "dynamics"
    varied: ClassVar[tuple[str, ...]] = ("params",)

    params: tuple[str, ...] = ()
    """Values that replace default parameters of the system, such as T=0.5. With T=0.1:0.9:17, the
    attractors are followed along 17 values."""
    follow: WholeNumber = 0
    """Number of steps for which a point may stay outside the box before it counts as lost."""
    by: Literal["cells", "orbits"] = "cells"
    """Method that assigns a cell to an attractor: the map of the cells (cells), or the orbit of the
    cell's centre (orbits), which is slower but does not need small cells."""
    edges: bool = False
    """Find the edge states, the saddles on the boundaries of basins."""
    folder: str = ""
    """Folder for the arrays over cells, which then need not fit in memory. Repeat the command to
    continue an interrupted run."""
    seed: WholeNumber = 0
    """Seed of the random starting points of the search for attractors."""

    def memory(self, written: bool = False) -> float | int:
        if self.folder:
            return 0
        values = read_params(self.params, dict(self.chosen.params)).values()
        members = max((len(value) for value in values if isinstance(value, list)), default=1)
        cells = self.chosen.box.size
        needed = _CHUNK_BYTES + cells * (_BYTES_PER_CELL + _KEPT_PER_CELL * (members - 1))
        memory.check(needed, "dynamics", "give fewer --cells")
        return needed

    def run(self, say: Say = silent) -> "dynamics.Basins | dynamics.Continuation":
        self.memory()
        system = self.chosen
        params = read_params(self.params, dict(system.params))
        options: dict[str, Any] = {
            "follow": self.follow,
            "seed": self.seed,
            "labels": system.labels,
            "say": say,
        }
        if any(isinstance(value, list) for value in params.values()):
            for name in ("edges", "folder"):
                if getattr(self, name):
                    raise ValueError(f"{name}: expected one value of each parameter in --params")
            return dynamics.continuation(system.map, system.box, params, by=self.by, **options)
        if self.folder:
            if self.by == "orbits":
                raise ValueError("folder: expected basins by cells, not by orbits")
            where = system.map, system.box, params
            warn(f"{dynamics.foretold(*where, follow=self.follow)}.")
            basins = dynamics.stored_basins(*where, folder=self.folder, **options)
        else:
            basins = dynamics.basins(system.map, system.box, params, by=self.by, **options)
        if not self.edges:
            return basins
        edges = dynamics.edge_states(system.map, basins, say=say)
        return dataclasses.replace(basins, edges=edges)

    def numbers(self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = every) -> Numbers:
        """Compute the numbers of a result, and the shares of basins: `fraction_0` is the largest.

        Orbits are followed to attractors only for numbers that need them.
        """
        import numpy as np

        from ..dynamics.batches import in_threads
        from ..dynamics.continued import parts

        self.memory()
        names = [name.removeprefix("params_") for name in columns]
        rows = [*zip(*(column.tolist() for column in columns.values()), strict=True)] or [()]
        known = read_params(self.params, dict(self.chosen.params))
        if self.folder or self.edges or any(isinstance(one, list) for one in known.values()):
            own = [[f"{k}={v}" for k, v in zip(names, row, strict=True)] for row in rows]
            studies = [dataclasses.replace(self, params=(*self.params, *one)) for one in own]
            found = [scalars(study.run(), (), wanted) for study in studies]
        else:
            members = [known | dict(zip(names, row, strict=True)) for row in rows]
            batches = parts(members, self.chosen.box)
            each = in_threads(lambda batch: self._numbers(batch, wanted), batches)
            found = [one for batch in each for one in batch]
        return stacked(found, np.arange(len(found)))

    def _numbers(self, members: list[dict[str, float]], wanted: Wanted) -> list[Numbers]:
        """Compute the numbers for each set of parameters."""
        import numpy as np

        from ..dynamics.basin import basins_of_each

        system, described = self.chosen, quantities(dynamics.Basins)
        asked = [name for name, about in described.items() if not about.dims and wanted(name)]
        shares = [k for k in range(_SHARES) if wanted is not every and wanted(f"fraction_{k}")]
        if self.by == "cells" and not shares and _OF_IMAGES.issuperset(asked):
            each = _numbers_of_images(system, members, self.follow)
            return [{name: (described[name], one[name]) for name in asked} for one in each]

        options: dict[str, Any] = {"follow": self.follow, "by": self.by, "seed": self.seed}
        about = dataclasses.replace(described["fraction"], dims=())
        found = []
        for one in basins_of_each(
            system.map, system.box, members, labels=system.labels, timed=False, **options
        ):
            fraction = np.append(one.fraction, np.zeros(_SHARES))
            found.append(
                scalars(one, (), wanted) | {f"fraction_{k}": (about, fraction[k]) for k in shares}
            )
        return found

    def at_once(self, result: "dynamics.Basins | dynamics.Continuation") -> bool:
        return not self.folder or self.chosen.box.size <= _MAX_AT_ONCE


def _numbers_of_images(
    system: "dynamics.System", members: list[dict[str, float]], follow: int
) -> "list[dict[str, np.ndarray]]":
    """Compute numbers of [`Basins`][jaxcell.dynamics.Basins] that do not depend on attractors."""
    import numpy as np

    from ..dynamics.imaging import check_map, images_of_each
    from ..mapping.peel import groups_on_host

    box, found = system.box, []
    check_map(system.map, box, members[0])
    for image in images_of_each(system.map, box, members, follow=follow):
        groups = groups_on_host(np.append(image, np.array([box.outside, box.nowhere], np.int32)))
        # The sinks are the last two groups.
        period, own = groups.group_period[:-2], groups.group < groups.count - 2
        numbers = {
            "groups": period.size,
            "periodic_cells": period.sum(),
            "longest_step": int(groups.step[own].max(initial=0)),
            "self_images": np.mean(image == np.arange(box.size)),
        }
        found.append({name: np.asarray(value) for name, value in numbers.items()})
    return found


def load_system(reference: SystemLike) -> "dynamics.System":
    """Return a system, or load it from `FILE.py:NAME`, or by its name in jaxcell."""
    if not isinstance(reference, str):
        if isinstance(reference, dynamics.System):
            return reference
        raise ValueError("system: expected a name or dynamics.System(function, box, params)")
    if ":" not in reference:
        # This import takes seconds.
        from ..dynamics import systems

        every = vars(systems).items()
        ours = {name: one for name, one in every if isinstance(one, dynamics.System)}
        if reference not in ours:
            raise ValueError(
                f"system: expected FILE.py:NAME or one of {', '.join(ours)}, got {reference!r}"
                f"{did_you_mean(reference, ours)}"
            )
        return ours[reference]
    with about("system"):
        system = load_object(reference)
        if not isinstance(system, dynamics.System):
            raise ValueError(f"{reference}: expected a jaxcell.dynamics.System, got {system!r}")
    return system


def read_params(given: tuple[str, ...], known: "dict[str, Any]") -> "dict[str, Any]":
    """Return the parameters `known`, updated by texts `NAME=NUMBER` or `NAME=FIRST:LAST:COUNT`."""
    params = dict(known)
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or name not in known:
            raise ValueError(
                f"params: expected NAME=NUMBER with a name among {', '.join(known)}, got {text!r}"
                f"{did_you_mean(name, known)}"
            )
        try:
            params[name] = _number_or_list(value)
        except ValueError:
            raise ValueError(
                f"params: {name}: expected a number or FIRST:LAST:COUNT, got {value!r}"
            ) from None
    return params


def _number_or_list(text: str) -> float | list[float]:
    if ":" not in text:
        return float(text)
    first, last, count = text.split(":")
    if int(count) < 1:
        raise ValueError(text)
    import numpy as np

    return [float(one) for one in np.linspace(float(first), float(last), int(count))]
