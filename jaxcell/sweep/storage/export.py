"""Write the result of a sweep as a Zarr store, which xarray can open."""

import dataclasses
import json
import math
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.paths import replacing
from ...base.results import file_digests
from ..design import LIST_DIMENSION, RANDOM_DIMENSION
from ..spec import Spec, packed
from ..workers.work import Variable
from .records import fill_value
from .store import DONE, FAILED, TO_DO, SweepStore


if TYPE_CHECKING:
    import zarr

FILE_BYTES = 2**20
"""Approximate maximum size of a file in bytes; a file holds at least one chunk of the sweep."""
_STATUS = Variable(
    (),
    np.zeros(0, np.int8),
    {
        "long_name": "state of a member",
        "flag_values": [TO_DO, DONE, FAILED],
        "flag_meanings": "to_do done failed",
    },
)


def update_result(store: SweepStore) -> None:
    """Write the result of a sweep to its folder, unless it is up to date."""
    if store.frame is not None and (store.contents.exported is None or store.lost_files()):
        export(store)


def export(store: SweepStore) -> None:
    """Write the result of a sweep to its folder, and replace an older result."""
    with replacing(store.zarr) as temporary:
        write_result(store, temporary)
        files = file_digests(temporary)
    store.mark_exported(files)


def write_result(store: SweepStore, target: Any, file_bytes: int = FILE_BYTES) -> None:
    """Write the result of a sweep to a Zarr store `target`, one file at a time to save memory."""
    import zarr

    spec, frame = store.spec, store.frame
    assert frame is not None
    dimensions, sizes = [*spec.dimensions], tuple(spec.dimensions.values())
    variables = {"status": _STATUS, **frame.variables}
    boxes = dataclasses.replace(spec, lengths=file_lengths(spec, frame.variables, file_bytes))
    attributes = {**described(spec), **store.made}
    group = zarr.create_group(target, zarr_format=3, attributes=attributes)
    for name, one in coordinates(spec, frame.coordinates).items():
        array = _create(group, name, one.values.shape, one.values.shape, one, None)
        array[...] = one.values.astype(object) if one.values.dtype.kind == "U" else one.values
    arrays = {}
    for name, one in variables.items():
        inner = one.values.shape[1:]
        lengths = (*boxes.lengths.values(), *inner)
        whole = dataclasses.replace(one, dimensions=(*dimensions, *one.dimensions))
        fill = TO_DO if name == "status" else fill_value(one.values.dtype)
        arrays[name] = _create(group, name, (*sizes, *inner), lengths, whole, fill)
    for number in range(boxes.chunk_count):
        region = boxes.chunk(number).region
        states, values = store.select([np.arange(part.start, part.stop) for part in region])
        for name, array in arrays.items():
            array[region] = states if name == "status" else values[name]
    with warnings.catch_warnings():
        # Zarr 3 warns that its standard has no consolidated metadata yet; xarray reads them.
        warnings.simplefilter("ignore", UserWarning)
        zarr.consolidate_metadata(group.store)


def file_lengths(
    spec: Spec, variables: Mapping[str, Variable], file_bytes: int = FILE_BYTES
) -> dict[str, int]:
    """Choose the number of members in a file along each dimension, in multiples of a chunk."""
    arrays = [one.values for one in variables.values()]
    member_bytes = max([1, *(one.itemsize * math.prod(one.shape[1:]) for one in arrays)])
    chunk_bytes = member_bytes * math.prod(spec.lengths.values())
    grid = dict(zip(spec.dimensions, spec.chunk_grid, strict=True))
    counts = packed(grid, max(file_bytes // chunk_bytes, 1))
    return {name: spec.lengths[name] * counts[name] for name in spec.dimensions}


def coordinates(spec: Spec, own: Mapping[str, Variable]) -> dict[str, Variable]:
    """Build the coordinates of a result: the parameters, and `own`, the coordinates of the task."""
    along = {one.name: Variable((one.dimension,), one.values, {}) for one in spec.parameters}
    for name in (LIST_DIMENSION, RANDOM_DIMENSION):
        if name in spec.dimensions:
            about = {"long_name": f"number of the {name}"}
            along[name] = Variable((name,), np.arange(spec.dimensions[name]), about)
    return {**along, **own}


def described(spec: Spec) -> dict[str, Any]:
    """Build the attributes of a result that describe the specification."""
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
        # By this attribute xarray knows that these variables are coordinates.
        attributes["coordinates"] = " ".join(others)
    return attributes


def _create(
    group: "zarr.Group",
    name: str,
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    one: Variable,
    fill: Any,
) -> "zarr.Array[Any]":
    from zarr.codecs import Crc32cCodec, ZstdCodec

    dtype = one.values.dtype
    return group.create_array(
        name,
        shape=shape,
        # The length of a Zarr chunk must be positive, also along an empty dimension.
        chunks=tuple(max(size, 1) for size in chunks),
        dtype=np.dtypes.StringDType() if dtype.kind == "U" else dtype,
        fill_value=fill,
        compressors=(ZstdCodec(), Crc32cCodec()),
        attributes=dict(one.attributes),
        dimension_names=one.dimensions,
        config={"write_empty_chunks": True},
    )
