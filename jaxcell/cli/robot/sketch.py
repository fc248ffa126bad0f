import dataclasses
import math
from pathlib import Path

import tyro

from ...study.study import Degrees, Metres
from ..options import check_heading, direction_at, write_text
from ..terminal import note


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotSketch:
    """Write an Arduino program that runs a filter, or a bouncing policy, on a robot without a host.

    The comment at its top says how to wire it."""

    file: tyro.conf.Positional[Path | None] = None
    """The filter.jxf or policy.jxf of `jaxcell localize --out`."""
    bounce: Degrees | None = None
    """Instead of a file: the angle in degrees to turn by at each bump."""
    step: Metres | None = None
    """With --bounce: length of a step in metres."""
    heading: Degrees | None = None
    """Heading of the robot at the start in degrees. The filter does not use it, but steps along a
    diagonal are longer: where steps differ between directions, the robot needs it."""
    minimal: bool = False
    """Merge states of the filter that no observation distinguishes by colour."""
    flash: int | None = None
    """Bytes of flash of the board; by default the 32256 of an Uno."""
    out: Path | None = None
    """File to write, which ends in .ino; by default it is printed."""

    def run(self) -> int:
        from ...robot.sketch import bounce_sketch

        if self.out is not None and self.out.suffix != ".ino":
            raise ValueError(f"--out {self.out}: expected a name that ends in .ino")
        if (self.file is None) == (self.bounce is None):
            raise ValueError("expected one of FILE and --bounce")
        if self.file is not None:
            text = self._filter(self.file)
        else:
            for name in ("heading", "minimal", "flash"):
                # Not `in`: 0.0 is a heading, and equals False.
                if getattr(self, name) is not None and getattr(self, name) is not False:
                    raise ValueError(f"--{name}: it is for a filter, not for --bounce")
            if self.step is None or self.bounce is None:
                raise ValueError("--bounce: expected --step in metres with it")
            text = bounce_sketch(math.radians(self.bounce), self.step)
        if self.out is None:
            print(text, end="", flush=True)
        else:
            write_text(self.out, text)
            note(f"{self.out}: {len(text.splitlines()):,} lines; the wiring is at its top")
        return 0

    def _filter(self, path: Path) -> str:
        from ...automata import minimize
        from ...robot.sketch import FLASH, filter_sketch, policy_sketch
        from ...robot.tasks.files import FilterTask, PolicyTask, load_task

        if self.step is not None:
            raise ValueError("--step: it is for --bounce; a filter has its own")
        task = load_task(path)
        if not isinstance(task, FilterTask | PolicyTask):
            raise ValueError(
                f"{path}: expected a filter or a policy, as `jaxcell localize --out` writes it"
            )
        if self.minimal and isinstance(task, PolicyTask):
            raise ValueError("--minimal: it is for a filter; equal states of a policy are one")
        if self.minimal and isinstance(task, FilterTask):
            task = dataclasses.replace(task, filter=minimize(task.filter))
        direction = None
        if self.heading is not None:
            direction = direction_at(self.heading, task.directions)
        else:
            check_heading(task)
        flash = FLASH if self.flash is None else self.flash
        if isinstance(task, PolicyTask):
            return policy_sketch(task, direction=direction, flash=flash)
        return filter_sketch(task, direction=direction, flash=flash)
