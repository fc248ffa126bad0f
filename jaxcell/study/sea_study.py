import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import tyro

from .study import Limit, Study


if TYPE_CHECKING:
    from ..verify import Comparison


Count: TypeAlias = Annotated[int, Limit("1 or more", lambda n: n >= 1)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SeaStudy(Study):
    """A question about drifters, of which files say what they need."""

    file: tyro.conf.Positional[tuple[Path, ...]]
    """What is known of the sea."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.file:
            raise ValueError("file: expected one or more, got none")

    def spec(self, result: Any) -> dict[str, Any]:
        asked = super().spec(result)
        return {**asked, "file": " ".join(asked["file"])}

    def headline(self, spec: dict[str, Any]) -> str:
        return str(spec["file"])

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_drift

        return compare_drift(result)
