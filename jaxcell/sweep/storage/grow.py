"""A sweep that grows: a store of more members that keeps those that are done.

The larger store is built beside the smaller one, as a run of the larger specification from the
start would have made it, in the folder `grown`, which gets its name when all is on the disk. From
then on any run that opens the store puts it in place, however often runs are killed meanwhile.
"""

import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..spec import Chunk, Spec
from .codecs import fill_of
from .frame import frame_of, make_frame, zarr_arrays
from .states import DONE, TO_DO


if TYPE_CHECKING:
    import zarr

    from .store import SweepStore


def grow(
    old: "SweepStore",
    spec: Spec,
    places: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any],
) -> None:
    """Make a store one of a larger specification; chunks that are damaged are to do there.

    **Arguments:**

    - `old`: the store; nobody else writes there.
    - `spec`: the larger specification.
    - `places`: where its members are in the store, by `Spec.places_in`.
    - `attributes`: of the larger result, beside those that give its specification.
    """
    temporary = old.folder / f".sweep-{secrets.token_hex(4)}"
    temporary.mkdir()
    if old.metadata:
        old.forget(old.damaged())
        frame = frame_of(old)
        make_frame(temporary / "sweep.zarr", spec, frame, attributes)
        new = type(old)(temporary, spec, old.made)
        arrays = zarr_arrays(old.zarr)
        for box in new.boxes:
            _copy(old, arrays, new, box, [*places.values()])
    (temporary / "spec.toml").write_bytes(spec.text)
    # All of it, before the name that says that it is whole.
    os.sync()
    os.replace(temporary, old.folder / "grown")
    finish_growth(old.folder)


def finish_growth(folder: Path) -> None:
    """Put a larger store in place, if one was made."""
    grown = folder / "grown"
    if not grown.is_dir():
        return
    if (grown / "sweep.zarr").exists():
        if (folder / "sweep.zarr").exists():
            os.replace(folder / "sweep.zarr", grown / "smaller.zarr")
        os.replace(grown / "sweep.zarr", folder / "sweep.zarr")
    if (grown / "spec.toml").exists():
        # Failures are filed by the numbers of chunks, which are others now.
        shutil.rmtree(folder / "failures", ignore_errors=True)
        os.replace(grown / "spec.toml", folder / "spec.toml")
    shutil.rmtree(grown)


def tidy(folder: Path) -> None:
    """End the growth that a run was killed in, and remove what it left half written."""
    finish_growth(folder)
    for path in folder.glob(".sweep-????????"):
        shutil.rmtree(path)
    for path in [
        *(folder / "sweep.zarr").rglob("*.partial"),
        *(folder / "sweep.zarr").rglob(".*-????????*"),
        *folder.glob(".*-????????.*"),
        *(folder / "failures").glob(".*-????????.*"),
    ]:
        path.unlink()


def _copy(
    old: "SweepStore",
    arrays: Mapping[str, "zarr.Array"],
    new: "SweepStore",
    box: Chunk,
    places: list[np.ndarray],
) -> None:
    """Copy the members in a file of the larger store that are done in the smaller one."""
    sources = [place[part] for place, part in zip(places, box.region, strict=True)]
    inside = tuple(np.flatnonzero(source >= 0) for source in sources)
    if not all(one.size for one in inside):
        return
    there = tuple(source[one] for source, one in zip(sources, inside, strict=True))
    done = np.zeros(box.shape, bool)
    done[np.ix_(*inside)] = old.members()[np.ix_(*there)] == DONE
    if not done.any():
        return
    for name in old.variables:
        values = new.empty(name, box)
        values[np.ix_(*inside)] = arrays[name].oindex[there]
        values[~done] = fill_of(new.metadata[name])
        new.put(name, box, values)
    new.put("status", box, np.where(done, DONE, TO_DO).astype(np.int8))
