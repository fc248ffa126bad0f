import dataclasses
from typing import ClassVar

from ...study.parameters import check
from .options import RunOptions


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotRun(RunOptions):
    """Run a filter, a plan, or a member of a team or patrol, on a real or an emulated robot.

    The robot stops, and the run ends, at Ctrl-C."""

    example: ClassVar[str] = "runs/lab/filter.jxf --simulate @lab_a --heading 0 --out runs/emulated"
    one_of: ClassVar[tuple[str, ...]] = ("port", "ros", "simulate")

    def run(self) -> int:
        check(self)
        from .running import run_robot

        return run_robot(self)
