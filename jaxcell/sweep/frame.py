"""The frame of a result: its arrays without their chunks, their coordinates and attributes.

A file of an array holds a box of members: one chunk of the sweep, or where these are many several,
and is replaced whole. It ends with a CRC-32C of what is in it (the codec of Zarr
of that name, after compression), and boxes of nothing but the fill value have files too. So a bit
that was flipped is seen when it is read, and a file that is gone when it is looked for.
"""

import hashlib
import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from ..base.files import replacing
from .boxes import stored_lengths
from .design import LIST_DIMENSION, RANDOM_DIMENSION
from .spec import Spec
from .states import DONE, FAILED, TO_DO
from .workers.work import Computed, Variable


_STATUS: dict[str, Any] = {
    "long_name": "state of a member",
    "flag_values": [TO_DO, DONE, FAILED],
    "flag_meanings": "to_do done failed",
}
_CODECS = (ZstdCodec(), Crc32cCodec())
_ALL_FILES: Any = {"write_empty_chunks": True}
_SIGNATURE = "attributes_sha256"


def make_frame(folder: Path, spec: Spec, first: Computed, attributes: Mapping[str, Any]) -> None:
    """Make a result with nothing in it.

    **Arguments:**

    - `folder`: where; there is nothing yet.
    - `spec`: the specification of the sweep.
    - `first`: what the task gave for one of the chunks.
    - `attributes`: of the result, beside those that give the specification.
    """
    own = signed({**described(spec), **attributes})
    group = zarr.create_group(folder, zarr_format=3, attributes=own)
    dimensions = spec.dimensions
    sizes, lengths = tuple(dimensions.values()), stored_lengths(spec, first.variables)
    for name in (LIST_DIMENSION, RANDOM_DIMENSION):
        if name in dimensions:
            number = np.arange(dimensions[name])
            _coordinate(group, name, name, number, {"long_name": f"number of the {name}"})
    for parameter in spec.parameters:
        _coordinate(group, parameter.name, parameter.dimension, parameter.values, {})
    for name, variable in sorted(first.coordinates.items()):
        _coordinate(group, name, name, variable.values, variable.attributes)
    for name, variable in sorted(first.variables.items()):
        inner = variable.values.shape[1:]
        group.create_array(
            name,
            shape=sizes + inner,
            # A Zarr chunk has at least one place, where an array may have none.
            chunks=lengths + tuple(max(size, 1) for size in inner),
            dtype=variable.values.dtype,
            fill_value=fill(variable.values.dtype),
            compressors=_CODECS,
            attributes=dict(variable.attributes),
            dimension_names=[*dimensions, *variable.dimensions],
        )
    group.create_array(
        "status",
        shape=sizes,
        chunks=lengths,
        dtype=np.int8,
        fill_value=TO_DO,
        compressors=_CODECS,
        attributes=_STATUS,
        dimension_names=[*dimensions],
    )
    with warnings.catch_warnings():
        # xarray reads consolidated metadata and writes it too, whatever the standard says yet.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(folder)


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


def open_arrays(folder: Path) -> dict[str, zarr.Array]:
    """The arrays of a result, to read."""
    return dict(zarr.open_group(folder, mode="r", zarr_format=3).arrays())


def frame_of(
    spec: Spec, arrays: Mapping[str, zarr.Array], named: Mapping[str, tuple[str, ...]]
) -> Computed:
    """What a task would have given for no member, by the names of its variables."""
    own = {*spec.dimensions, "status", *(one.name for one in spec.parameters), *named}
    inner = len(spec.dimensions)
    variables = {
        name: Variable(
            dimensions,
            np.empty((0, *arrays[name].shape[inner:]), arrays[name].dtype),
            dict(arrays[name].attrs),
        )
        for name, dimensions in named.items()
    }
    coordinates = {}
    for name in sorted(set(arrays) - own):
        values = np.asarray(arrays[name][...])
        if values.dtype.kind == "T":
            values = values.astype(np.str_)
        coordinates[name] = Variable((name,), values, dict(arrays[name].attrs))
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


def _coordinate(
    group: zarr.Group,
    name: str,
    dimension: str,
    values: np.ndarray,
    attributes: Mapping[str, Any],
) -> None:
    if values.dtype.kind == "U":
        values = values.astype(np.dtypes.StringDType())
    group.create_array(
        name,
        data=values,
        dimension_names=[dimension],
        attributes=dict(attributes),
        chunks=values.shape,
        compressors=_CODECS,
        config=_ALL_FILES,
    )


def read_attributes(folder: Path) -> dict[str, Any]:
    """The attributes of a result.

    **Raises:** `ValueError` if they are not those that were written.
    """
    attributes = dict(json.loads((folder / "zarr.json").read_bytes())["attributes"])
    # Those of old versions of jaxcell have neither.
    if {_SIGNATURE, "digests"} & set(attributes) and attributes != signed(attributes):
        raise ValueError(f"the attributes do not have the checksum {_SIGNATURE}")
    return attributes


def write_attributes(folder: Path, attributes: Mapping[str, Any]) -> None:
    """Put others in the place of the attributes of a result."""
    path = folder / "zarr.json"
    document = {**json.loads(path.read_bytes()), "attributes": signed(attributes)}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2), encoding="utf-8")


def signed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes with their checksum."""
    plain = {name: value for name, value in attributes.items() if name != _SIGNATURE}
    text = json.dumps(plain, sort_keys=True).encode()
    return {**plain, _SIGNATURE: hashlib.sha256(text).hexdigest()}
