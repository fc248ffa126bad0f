import dataclasses
import math
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from ... import automata
from ...study.parameters import Degrees, Limit, Metres, Needed, Only, check
from ..output import write_text
from ..terminal import note, progress
from .options import check_heading, direction_at


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotSketch:
    """Write an Arduino program that runs a filter or a policy on a robot without another computer.

    A comment at the top of the program describes the wiring."""

    example: ClassVar[str] = "runs/lab/filter.jxf --heading 0 --out localize.ino"
    one_of: ClassVar[tuple[str, ...]] = ("file", "bounce")

    file: tyro.conf.Positional[Path | None] = None
    """Task to run: the filter.jxf or policy.jxf of `jaxcell localize --out`."""
    bounce: Annotated[Degrees | None, Only(file=False)] = None
    """Bouncing angle in degrees, for a robot without a filter."""
    step: Annotated[Metres | None, Needed(bounce=True)] = None
    """Length of a step in metres."""
    heading: Annotated[Degrees | None, Only(file=True)] = None
    """Heading of the robot at the start in degrees. The filter needs it only if its steps differ
    between directions, for instance because they are longer along a diagonal."""
    minimal: Annotated[bool, Only(file=True)] = False
    """Merge states from which every sequence of observations gives the same outputs."""
    smallest: Annotated[bool, Only(file=True, minimal=False)] = False
    """Run the smallest machine with the same outputs for all observations that can occur. Most
    observations that are impossible on the map go undetected."""
    confirm: Annotated[int | None, Limit(ge=0, le=1_000_000), Only(file=True, smallest=False)] = (
        None
    )
    """Number of further observations that must agree with the map before the robot is localized, by
    default 30. The sketch of a policy cannot confirm its answer."""
    flash: Annotated[int | None, Only(file=True)] = None
    """Flash memory of the board in bytes; by default 32256, as on an Uno."""
    out: Path | None = None
    """File to write, which ends in .ino; by default the program is printed."""

    def run(self) -> int:
        from ...robot.sketch import bounce_sketch

        check(self)
        if self.out is not None and self.out.suffix != ".ino":
            raise ValueError(f"--out {self.out}: expected a name that ends in .ino")
        if self.file is not None:
            text = self._filter(self.file)
        else:
            assert self.bounce is not None
            assert self.step is not None
            text = bounce_sketch(math.radians(self.bounce), self.step)
        if self.out is None:
            print(text, end="", flush=True)
        else:
            write_text(self.out, text)
            note(f"{self.out}: {len(text.splitlines()):,} lines; the wiring is at its top")
        return 0

    def _filter(self, path: Path) -> str:
        from ...automata.filter import CONFIRM
        from ...robot.sketch import FLASH, filter_sketch, policy_sketch
        from ...robot.tasks.files import FilterTask, PolicyTask, load_task

        task = load_task(path)
        if not isinstance(task, FilterTask | PolicyTask):
            raise ValueError(
                f"{path}: expected a filter or a policy, as `jaxcell localize --out` writes it"
            )
        if self.minimal and isinstance(task, PolicyTask):
            raise ValueError("--minimal: a policy has no equal states to merge")
        if self.confirm is not None and isinstance(task, PolicyTask):
            raise ValueError("--confirm: the sketch of a policy cannot confirm its answer")
        if self.minimal and isinstance(task, FilterTask):
            task = dataclasses.replace(task, filter=automata.minimize(task.filter))
        direction = None
        if self.heading is not None:
            direction = direction_at(self.heading, task.directions)
        else:
            check_heading(task)
        flash = FLASH if self.flash is None else self.flash
        machine = None
        if self.smallest:
            source = task.policy if isinstance(task, PolicyTask) else task.filter
            if isinstance(source, automata.Filter) and source.open_world:
                raise ValueError(
                    f"{path}: every observation can occur in an open world, so that its least "
                    "filter is that of --minimal"
                )
            with progress("the smallest machine") as say:
                found = automata.fewest_bytes(source, say=say)
            machine = found.machine
            note(f"{found.states} states, {found.claim}")
        if isinstance(task, PolicyTask):
            return policy_sketch(task, direction=direction, flash=flash, machine=machine)
        return filter_sketch(
            task,
            direction=direction,
            flash=flash,
            machine=machine,
            confirm=CONFIRM if self.confirm is None else self.confirm,
        )
