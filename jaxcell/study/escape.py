import dataclasses
import functools
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from .. import dynamics
from ..base import memory
from ..base.formatting import did_you_mean
from ..base.quantities import quantities, quantity
from .batches import Numbers
from .dynamics import SystemStudy, read_params
from .study import Say, Wanted, every, scalars, silent


if TYPE_CHECKING:
    import numpy as np


# Bytes per cell of the matrix of a flow and its factors.
_BYTES_PER_CELL = 20_000
_CONDITION = re.compile(r"\s*(.+?)\s*([<>])\s*(\S+)\s*")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Escape(SystemStudy):
    """Compute how long a noisy dynamical system stays in a region, and where it leaves."""

    name: ClassVar[str] = "escape"
    command: ClassVar[str] = "escape"
    example: ClassVar[str] = "well --noise 0.4 --start=-1 --into 'x>0' --gradient"
    task: ClassVar[str] = "escape"
    varied: ClassVar[tuple[str, ...]] = ("params",)

    noise: tuple[float, ...]
    """Standard deviation of the noise, one number for all axes or one per axis: per square root of
    time for a flow, and per mapping for other maps."""
    start: tuple[float, ...] = ()
    """Coordinates of the start; by default the start is distributed as among systems that have
    stayed for long."""
    into: tuple[str, ...] = ()
    """Regions where the system ends, each with conditions on the axes, such as 'x>0' or
    'x0>0,x1<2'. The sides of the box that are sinks end it too."""
    leave: str = ""
    "Region that the system leaves, such as 'x<0.5'."
    gradient: bool = False
    "Add the derivative of the mean time by each parameter and by the noise."

    def memory(self, written: bool = False) -> float | int:
        needed = self.chosen.box.size * _BYTES_PER_CELL
        memory.check(needed, "escape", "give fewer --cells")
        self._problem()
        return needed

    def run(self, say: Say = silent) -> "dynamics.Escape":
        self.memory()
        say("solving")
        return dynamics.escape(self.chosen, gradient=self.gradient, **self._problem())

    def _problem(self) -> dict[str, Any]:
        """Return the arguments of `escape`; raise `ValueError` if one of them is wrong."""
        system = self.chosen
        params = read_params(self.params, dict(system.params))
        for name, value in params.items():
            if isinstance(value, list):
                raise ValueError(f"params: {name}: expected one value, got {len(value)}")
        names = system.labels or tuple(f"x{axis}" for axis in range(system.box.dimensions))
        return {
            "params": params,
            "noise": self.noise if len(self.noise) > 1 else self.noise[0],
            "start": self.start or None,
            "into": {text: region(text, names, "into") for text in self.into} or None,
            "out_of": region(self.leave, names, "leave") if self.leave else None,
        }

    def numbers(self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = every) -> Numbers:
        """Compute the numbers of a result, derivatives `d_mean_time_d_NAME`, and shares.

        `share_0` is the share of time in the first region of `into` in the long run, if the system
        goes on there. If only shares, the mean time with its error, and its derivative by the only
        parameter that varies, are wanted, a map has them from [`jaxcell.dynamics.exit_times`][].
        """
        import numpy as np

        names = [name.removeprefix("params_") for name in columns]
        params = self.chosen.params
        causes = *params, "noise_factor" if "noise" in params else "noise"
        slopes = {f"d_mean_time_d_{cause}": cause for cause in causes}
        regions = len(self.into) + bool(self.leave) if wanted is not every else 0
        shares = {f"share_{k}": k for k in range(regions) if wanted(f"share_{k}")}
        described = {
            **quantities(dynamics.Escape),
            **{
                name: quantity("", "share of time in the region, in the long run")
                for name in shares
            },
            **{
                name: quantity("", f"derivative of the mean time, by {cause}")
                for name, cause in slopes.items()
            },
        }
        asked = {*filter(wanted, described)}

        def alone(study: Escape) -> dict[str, Any]:
            if asked == {*shares}:
                return {}
            result = study.run()
            numbers = {name: value for name, (_, value) in scalars(result, (), wanted).items()}
            if result.cause is not None and result.derivative is not None:
                own = zip(result.cause, result.derivative, strict=True)
                numbers |= {f"d_mean_time_d_{cause}": slope for cause, slope in own}
            return {name: one for name, one in numbers.items() if name in asked}

        if shares and not (columns and self.start):
            raise ValueError(
                "results: shares in the long run need a start, and a parameter params_NAME in the "
                "sweep"
            )
        if not columns:
            return {k: (described[k], np.asarray(one)) for k, one in alone(self).items()}
        from ..dynamics.noise.exit_times import warn_of_slopes

        family = self._family(names, asked - {*shares})
        rows = []
        for values in zip(*(column.tolist() for column in columns.values()), strict=True):
            own = (f"{name}={value}" for name, value in zip(names, values, strict=True))
            study = dataclasses.replace(self, params=(*self.params, *own))
            at = family and family.at(values[0])
            if at:
                at[f"d_mean_time_d_{names[0]}"] = at["derivative"]
                row = {name: at[name] for name in asked - {*shares}}
            else:
                row = alone(study)
            if shares:
                # The chains along the first parameter, for the values of the others.
                long_run = study._along(names[0], back=True).shares(values[0], len(names) > 1)
                row |= {name: long_run[k] for name, k in shares.items()}
            rows.append(row)
        found = {k: (described[k], np.array([row[k] for row in rows])) for k in rows[0]}
        for name in found.keys() & slopes:
            warn_of_slopes(found[name][1], name)
        return found

    def _family(self, names: list[str], asked: set[str]) -> Any:
        """Return the chains along a parameter if the numbers that are asked come from them."""
        fast = {"mean_time", "mean_time_error"} | (
            {f"d_mean_time_d_{names[0]}"} if self.gradient else set()
        )
        given = self.start and all(one > 0 for one in self.noise) and isinstance(self.system, str)
        if len(names) > 1 or not asked or not asked <= fast or not given:
            return None
        return None if isinstance(self.chosen.map, dynamics.Flow) else self._along(names[0])

    def _along(self, name: str, back: bool = False) -> Any:
        others = (text for text in self.params if text.partition("=")[0].strip() != name)
        return _family_of(dataclasses.replace(self, params=(*others,)), name, back)


@functools.lru_cache(maxsize=4)
def _family_of(study: Escape, name: str, back: bool) -> Any:
    """Return the chains along a parameter, which calls of a sweep share."""
    from ..dynamics.noise.family import Family

    about = study._problem()
    system = dataclasses.replace(study.chosen, params=about.pop("params"))
    return Family.of(system, name, **about, back=back)


def region(text: str, names: Sequence[str], option: str) -> Callable[[Any], Any]:
    """Return the function of points for a text of conditions, such as `x>0,y<2`.

    The name of an axis may be without its unit in parentheses. A single axis is also called `x`.
    """
    short = {name.partition(" (")[0]: axis for axis, name in enumerate(names)}
    only = {"x": 0} if len(names) == 1 else {}
    axes = {**only, **short, **{name: axis for axis, name in enumerate(names)}}
    conditions = []
    for part in text.split(","):
        match = _CONDITION.fullmatch(part)
        try:
            if match is None:
                raise ValueError(text)
            limit = float(match[3])
        except ValueError:
            raise ValueError(
                f"{option}: expected conditions NAME>NUMBER or NAME<NUMBER, got {text!r}"
            ) from None
        if match[1] not in axes:
            near = did_you_mean(match[1], axes)
            raise ValueError(
                f"{option}: expected an axis among {', '.join(axes)}, got {match[1]!r}{near}"
            )
        compare = operator.gt if match[2] == ">" else operator.lt
        conditions.append((axes[match[1]], compare, limit))

    def inside(points: Any) -> Any:
        mask = True
        for axis, compare, limit in conditions:
            mask = mask & compare(points[:, axis], limit)
        return mask

    return inside
