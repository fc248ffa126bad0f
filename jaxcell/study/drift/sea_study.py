import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import tyro

from ... import verify as verification
from ..parameters import Unit
from ..study import Study


if TYPE_CHECKING:
    import xarray

    Files: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
    Source: TypeAlias = Files | xarray.Dataset
else:
    Files = Source = tuple[Path, ...]

_Degrees: TypeAlias = Annotated[float, Unit("", "deg")]
Bounds: TypeAlias = tuple[_Degrees, _Degrees, _Degrees, _Degrees]
"""West, south, east and north limits of a region."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SeaStudy(Study):
    """Base class of studies that read currents, or trajectories of drifters, from files."""

    file: tyro.conf.Positional[Source] = dataclasses.field(kw_only=False)
    """Files of currents or of trajectories."""

    def __post_init__(self) -> None:
        file: Any = self.file
        for one in file if isinstance(file, list | tuple) else (file,):
            if not (isinstance(one, str | os.PathLike) or hasattr(one, "data_vars")):
                got = type(one).__name__
                raise ValueError(f"file: expected files or an xarray.Dataset, got {got}")
        super().__post_init__()

    def spec(self, result: Any) -> dict[str, Any]:
        spec = super().spec(result)
        file = spec["file"]
        return {**spec, "file": file if isinstance(file, str) else " ".join(file)}

    def headline(self, spec: dict[str, Any]) -> str:
        return str(spec["file"])

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_drift(result)
