import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from ..study import Study


if TYPE_CHECKING:
    from ...verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class SeaStudy(Study):
    """A study of drifters whose data are in files."""

    file: tyro.conf.Positional[tuple[Path, ...]]
    """Files of currents or of trajectories."""

    def spec(self, result: Any) -> dict[str, Any]:
        asked = super().spec(result)
        return {**asked, "file": " ".join(asked["file"])}

    def headline(self, spec: dict[str, Any]) -> str:
        return str(spec["file"])

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ...verify import compare_drift

        return compare_drift(result)
