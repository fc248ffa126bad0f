import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from .. import automata
from ..base.results import check_result
from ..study.parameters import Limit, Only, Seconds, check
from .output import check_out, write_text
from .terminal import note, progress


@dataclasses.dataclass(frozen=True, kw_only=True)
class Export:
    """Write a saved filter for another program: .dot, .jff (JFLAP), .json, or .h (C)."""

    example: ClassVar[str] = "runs/lab/filter.jxf filter.h"

    filter: tyro.conf.Positional[Path]
    """Filter or policy from `jaxcell localize --out`; a policy can only be written as .h."""
    file: tyro.conf.Positional[Path]
    """File to write; the suffix determines the format."""
    minimal: bool = False
    """Merge states from which every sequence of observations gives the same outputs."""
    smallest: Annotated[bool, Only(minimal=False)] = False
    """Write the smallest machine with the same outputs for all observations that can occur, as
    .dot, .json or .h. In .h, each input is a run between bumps if this makes the tables smaller."""
    output: Annotated[
        Literal["color", "count", "cells", "localized", "action"] | None, Only(smallest=True)
    ] = None
    """Output of the machine. For a filter: color (default), the number of its knowledge cycle (a
    cycle of states without exit); cells, the cells in this cycle; count, the number of possible
    cells; or localized, whether it is in such a cycle. For a policy: cells (default), the next turn
    or, at the end, the cells; or action, the next turn or that the end is reached."""
    seconds: Annotated[Seconds, Limit(ge=0), Only(smallest=True)] = 60.0
    """Time limit for the proof that no smaller machine exists."""

    def run(self) -> int:
        from ..automata.formats.storage import read_kind

        check(self)
        formats: dict[str, Callable[[automata.Filter], str]] = {
            ".dot": automata.to_dot,
            ".jff": automata.to_jflap,
            ".json": automata.to_json,
            ".h": automata.to_c_header,
        }
        if self.file.suffix not in formats:
            raise ValueError(f"{self.file}: expected a suffix among {', '.join(formats)}")
        check_out(self.file, folder=False, option="")
        check_result(self.filter)
        policy = read_kind(self.filter) == "policy"
        source = (automata.Policy if policy else automata.Filter).load(self.filter)
        if self.smallest:
            return self._smallest(source)
        if isinstance(source, automata.Policy):
            if self.file.suffix != ".h" or self.minimal:
                raise ValueError(
                    f"{self.file}: a policy is written only as .h, and without --minimal"
                )
            text, states = automata.policy_to_c_header(source), source.turn.size
        else:
            filter = automata.minimize(source) if self.minimal else source
            text, states = formats[self.file.suffix](filter), len(filter.transition)
        write_text(self.file, text)
        note(f"{self.file}: {states} states")
        return 0

    def _smallest(self, source: "automata.Filter | automata.Policy") -> int:
        if self.file.suffix == ".jff":
            raise ValueError(f"{self.file}: expected .dot, .json or .h with --smallest")
        with progress("the smallest machine") as say:
            if self.file.suffix == ".h":
                found = automata.fewest_bytes(source, self.output, seconds=self.seconds, say=say)
                text = automata.machine_to_c_header(found.machine)
            else:
                machine = automata.MooreMachine.of(source, self.output)
                found = automata.smallest(machine, seconds=self.seconds, say=say)
                write = automata.to_dot if self.file.suffix == ".dot" else automata.to_json
                text = write(found.machine)
        write_text(self.file, text)
        reads = "runs" if found.machine.runs else "observations"
        note(
            f"{self.file}: {found.states} states, {found.claim}; {found.moore} if only equivalent "
            f"states are merged; reads {reads}, tables of {automata.machine_bytes(found.machine)} "
            "bytes"
        )
        return 0
