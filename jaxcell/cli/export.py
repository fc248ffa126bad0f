import dataclasses
from pathlib import Path
from typing import ClassVar

import tyro

from .terminal import note


@dataclasses.dataclass(frozen=True, kw_only=True)
class Export:
    """Write a saved filter for another program: .dot, .jff (JFLAP), .json, or .h (C)."""

    example: ClassVar[str] = "runs/lab/filter.jxf filter.h"

    filter: tyro.conf.Positional[Path]
    """Filter or policy (only as .h) of `jaxcell localize --out`."""
    file: tyro.conf.Positional[Path]
    """File to write; its suffix chooses the format."""
    minimal: bool = False
    """Merge states that no observation distinguishes by colour."""

    def run(self) -> int:
        from .. import automata
        from ..automata.formats.storage import read_kind
        from .output import check_out, write_text

        formats = {
            ".dot": automata.to_dot,
            ".jff": automata.to_jflap,
            ".json": automata.to_json,
            ".h": automata.to_c_header,
        }
        if self.file.suffix not in formats:
            raise ValueError(f"{self.file}: expected a suffix among {', '.join(formats)}")
        check_out(self.file, folder=False, option="")
        if read_kind(self.filter) == "policy":
            self._policy()
            return 0
        filter = automata.Filter.load(self.filter)
        if self.minimal:
            filter = automata.minimize(filter)
        write_text(self.file, formats[self.file.suffix](filter))
        note(f"{self.file}: {len(filter.transition)} states")
        return 0

    def _policy(self) -> None:
        from .. import automata
        from .output import write_text

        if self.file.suffix != ".h" or self.minimal:
            raise ValueError(f"{self.file}: a policy is written only as .h, and without --minimal")
        policy = automata.Policy.load(self.filter)
        write_text(self.file, automata.policy_to_c_header(policy))
        note(f"{self.file}: {policy.turn.size} states")
