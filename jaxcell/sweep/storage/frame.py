"""The frame of a result: its arrays without their chunks, their coordinates and attributes.

A file of an array holds a box of members: one chunk of the sweep, or where these are small several,
and is replaced whole. It ends with a CRC-32C of what is in it (the codec of Zarr
of that name, after compression), and boxes of nothing but the fill value have files too. So a bit
that was flipped is seen when it is read, and a file that is gone when it is looked for.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.paths import write_durably
from ..boxes import stored_lengths
from ..design import LIST_DIMENSION, RANDOM_DIMENSION
from ..spec import Spec
from ..workers.work import Computed, Variable
from .codecs import decoded, described_array, encoded, kind_of
from .states import DONE, FAILED, TO_DO, States, reading


if TYPE_CHECKING:
    import zarr

_STATUS: dict[str, Any] = {
    "long_name": "state of a member",
    "flag_values": [TO_DO, DONE, FAILED],
    "flag_meanings": "to_do done failed",
}
_SIGNATURE = "attributes_sha256"


def make_frame(folder: Path, spec: Spec, first: Computed, attributes: Mapping[str, Any]) -> None:
    """Make a result with nothing in it, and return when it is on the disk.

    **Arguments:**

    - `folder`: where; there is nothing yet.
    - `spec`: the specification of the sweep.
    - `first`: what the task gave for one of the chunks.
    - `attributes`: of the result, beside those that give the specification.
    """
    dimensions = [*spec.dimensions]
    sizes, lengths = tuple(spec.dimensions.values()), stored_lengths(spec, first.variables)
    along = {one.name: Variable((one.dimension,), one.values, {}) for one in spec.parameters}
    for name in {LIST_DIMENSION, RANDOM_DIMENSION} & {*dimensions}:
        about = {"long_name": f"number of the {name}"}
        along[name] = Variable((name,), np.arange(spec.dimensions[name]), about)
    along.update(first.coordinates)
    status = np.dtype(np.int8)
    arrays = {"status": described_array(status, sizes, lengths, TO_DO, dimensions, _STATUS)}
    for name, one in first.variables.items():
        dtype, inner = one.values.dtype, one.values.shape[1:]
        names = (*dimensions, *one.dimensions)
        arrays[name] = described_array(
            dtype, sizes + inner, lengths + inner, fill(dtype), names, one.attributes
        )
    files = {}
    for name, one in along.items():
        values, nothing = one.values, np.zeros((), one.values.dtype)
        arrays[name] = described_array(
            values.dtype, values.shape, values.shape, nothing, one.dimensions, one.attributes
        )
        files[f"{name}/c/0"] = encoded(values, arrays[name])
    # xarray reads consolidated metadata and writes it too, whatever the standard says yet.
    inline = {"kind": "inline", "must_understand": False, "metadata": dict(sorted(arrays.items()))}
    whole = {
        "attributes": signed({**described(spec), **attributes}),
        "zarr_format": 3,
        "consolidated_metadata": inline,
        "node_type": "group",
    }
    for name, metadata in {"": whole, **arrays}.items():
        files[os.path.join(name, "zarr.json")] = json.dumps(metadata, indent=2).encode()
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
    # A disk takes as long for one file as for several at once.
    with ThreadPoolExecutor() as team:
        list(team.map(lambda name: write_durably(folder / name, files[name]), files))


def described(spec: Spec) -> dict[str, Any]:
    """The attributes of a result that give its specification."""
    attributes: dict[str, Any] = {
        "title": f"Sweep of {spec.task}",
        "source": "jaxcell",
        "task": spec.task,
        "spec": json.dumps(spec.document, default=str),
        "seed": spec.seed,
        "comment": "Where status is not 1 (done), floats are NaN, integers -1 (or, without a "
        "sign, their greatest), and booleans False.",
    }
    others = [one.name for one in spec.parameters if one.name != one.dimension]
    if others:
        # So xarray knows that they are coordinates.
        attributes["coordinates"] = " ".join(others)
    return attributes


def frame_of(store: States) -> Computed:
    """What the task of a sweep would give for no member, by its result."""
    spec, inner = store.spec, len(store.spec.dimensions)
    own = {*spec.dimensions, "status", *(one.name for one in spec.parameters), *store.variables}
    variables, coordinates = {}, {}
    with reading(store.folder):
        for name, dimensions in store.variables.items():
            metadata = store.metadata[name]
            values = np.empty((0, *metadata["shape"][inner:]), kind_of(metadata))
            variables[name] = Variable(dimensions, values, metadata["attributes"])
        for name in sorted(set(store.metadata) - own):
            metadata = store.metadata[name]
            content = store.zarr.joinpath(name, "c", "0").read_bytes()
            values = decoded(content, metadata)[: metadata["shape"][0]]
            coordinates[name] = Variable((name,), values, metadata["attributes"])
    return Computed(variables, coordinates)


def check_fits(frame: Computed, computed: Computed) -> None:
    """Raise `ValueError` if a chunk has not the variables of the chunk that was done first."""
    given, first = ({**one.variables, **one.coordinates} for one in (computed, frame))
    if given.keys() != first.keys():
        raise ValueError(
            f"the task gave {', '.join(sorted(given))}; the chunk that was done first has "
            f"{', '.join(sorted(first))}"
        )
    for name, variable in given.items():
        here, there = (
            {
                "dimensions": [*one.dimensions],
                "shape": [*one.values.shape[name in computed.variables :]],
                "kind": "string" if one.values.dtype.kind == "U" else one.values.dtype,
                "attributes": dict(one.attributes),
            }
            for one in (variable, first[name])
        )
        what = next((key for key in there if here[key] != there[key]), None)
        if what is not None:
            raise ValueError(
                f"the task gave {name!r} with the {what} {here[what]}; in the chunk that was "
                f"done first it is {there[what]}"
            )
        if name in computed.coordinates and not np.array_equal(variable.values, first[name].values):
            raise ValueError(
                f"the task gave a coordinate {name!r} with values other than those of the "
                "chunk that was done first"
            )


def fill(dtype: np.dtype) -> Any:
    """What stands where nothing is known yet."""
    return {"f": np.nan, "c": complex(np.nan, np.nan), "i": -1, "b": False}.get(
        dtype.kind, np.iinfo(dtype).max if dtype.kind == "u" else 0
    )


def zarr_arrays(folder: Path) -> dict[str, "zarr.Array"]:
    """The arrays of a result, by Zarr."""
    import zarr

    return dict(zarr.open_group(folder, mode="r", zarr_format=3).arrays())


def read_attributes(folder: Path) -> dict[str, Any]:
    """The attributes of a result.

    **Raises:** `ValueError` if they are not those that were written.
    """
    attributes = dict(json.loads((folder / "zarr.json").read_bytes())["attributes"])
    if attributes != signed(attributes):
        raise ValueError(f"the attributes do not have the checksum {_SIGNATURE}")
    return attributes


def write_attributes(folder: Path, attributes: Mapping[str, Any]) -> None:
    """Put others in the place of the attributes of a result."""
    path = folder / "zarr.json"
    document = {**json.loads(path.read_bytes()), "attributes": signed(attributes)}
    write_durably(path, json.dumps(document, indent=2).encode())


def signed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes with their checksum."""
    plain = {name: value for name, value in attributes.items() if name != _SIGNATURE}
    text = json.dumps(plain, sort_keys=True).encode()
    return {**plain, _SIGNATURE: hashlib.sha256(text).hexdigest()}
