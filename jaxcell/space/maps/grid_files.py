"""Read and write grid maps: ASCII grids, and the maps of ROS map_server.

A grid becomes a map whose boundary is the rectangle around the grid, whose obstacles are the
blocked squares, and whose suggested `cell` is the side of a square.
"""

import json
import math
import reprlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml
from jaxtyping import Bool, Integer
from PIL import UnidentifiedImageError

from ...base.documents import checked_number, refused
from ...base.doubts import Doubt
from ...base.limits import Unknown
from ..occupancy import blocked_rings, rasterise
from .images import read_image


_BLOCKED, _FREE = "#X@", ". "
_HEADER = ("name", "cell", "origin", "robot_radius", "directions")
# Greys of 8 bits that savers of maps write for unknown: map_saver, and Cartographer and its kin.
_UNKNOWN_GREYS = (205, 127, 128)
# Shares of red, green and blue in the luminance of a pixel (Rec. 709), by which nav2 reads colours.
_LUMINANCE = np.array([0.212656, 0.715158, 0.072186])


class _Loader(yaml.BaseLoader):
    """A YAML loader that refuses aliases, because a few lines of them can exhaust the memory."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError(f"*{self.peek_event().anchor}: expected no aliases")
        return super().compose_node(parent, index)


def parse_ascii(text: str) -> dict[str, Any]:
    """Read an ASCII grid.

    ```text
    ; name a corridor
    ; cell 0.25
    #######
    #..#..#
    #.....#
    #######
    ```

    The first row is at the top. `#`, `X` and `@` are blocked squares, `.` and spaces are free
    squares, and all rows have the same length. Above the rows, lines that begin with `;` give
    `cell` (m; 1 by default), `origin` (x and y of the lower left corner, m), `robot_radius` (m),
    `directions` and `name`; lines that begin with `;;` are remarks.

    Returns keyword arguments of `Workspace`.
    """
    lines = text.replace("\r\n", "\n").split("\n")
    header: dict[str, str] = {}
    first = 0
    while first < len(lines) and (lines[first] == "" or lines[first].startswith(";")):
        _read_header_line(lines[first], first + 1, header)
        first += 1
    rows = lines[first:]
    while rows and rows[-1] == "":
        rows.pop()
    if not rows:
        raise ValueError("the grid has no rows")

    for number, row in enumerate(rows, first + 1):
        for column, character in enumerate(row, 1):
            if character not in _BLOCKED + _FREE:
                raise ValueError(
                    f"line {number}, column {column}: expected one of '{_BLOCKED}' (blocked) "
                    f"or '{_FREE}' (free), got {character!r}"
                )
        if len(row) != len(rows[0]):
            raise ValueError(
                f"line {number}: the row has {len(row)} squares, "
                f"but the first row, line {first + 1}, has {len(rows[0])}"
            )
    blocked = np.array([[character in _BLOCKED for character in row] for row in rows[::-1]])
    fields: dict[str, Any] = {}
    if "name" in header:
        fields["name"] = header["name"]
    if "robot_radius" in header:
        fields["robot_radius"] = _number("robot_radius", header["robot_radius"])
    if "directions" in header:
        try:
            fields["directions"] = int(header["directions"])
        except ValueError:
            raise refused("directions", "a whole number", header["directions"]) from None
    origin = [_number("origin", text) for text in header.get("origin", "0 0").split()]
    if len(origin) != 2:
        raise refused("origin", "two numbers x y", header["origin"])
    cell = _side("cell", header.get("cell", "1"))
    return {**fields, **grid_fields(blocked, (origin[0], origin[1]), cell)}


def format_ascii(
    fields: Mapping[str, Any], environment: shapely.Polygon | shapely.MultiPolygon
) -> str:
    """Write a map, given by its fields and its environment, as the text of an ASCII grid."""
    blocked, origin = _grid_of(fields, environment)
    x, y = origin
    header = [f"; cell {fields['cell']!r}", f"; robot_radius {fields['robot_radius']!r}"]
    if fields["name"]:
        header.insert(0, f"; name {fields['name']}")
    if fields["directions"] is not None:
        header.append(f"; directions {fields['directions']}")
    if origin != (0.0, 0.0):
        header.append(f"; origin {x!r} {y!r}")
    rows = ["".join(row) for row in np.where(blocked[::-1], "#", ".")]
    return "\n".join([*header, *rows]) + "\n"


def parse_map_server(text: str, folder: Path, unknown: Unknown = "wall") -> dict[str, Any]:
    """Read the YAML file of a ROS map_server map, and its image.

    `image`, `resolution` (m per pixel), `origin` (x, y and yaw of the lower left corner; the yaw
    must be 0), `negate`, `occupied_thresh` and `free_thresh` are required. `mode` may only be
    trinary; other keys are ignored. Occupied pixels are obstacles, and so are unknown pixels unless
    `unknown` is `"free"`.

    Pixels are unknown between the thresholds. They are also unknown if they have the grey that the
    saver of the map wrote for unknown, although `free_thresh` takes it as free; a `Doubt` says how
    many. A file with `mode` is read as nav2 reads it: the luminance of a colour counts, and pixels
    that are not opaque are unknown. A file without `mode` is read as in ROS 1: the channels of a
    pixel, including alpha, are averaged.

    The path of the image is relative to `folder`. Images above Pillow's size limit (about 9 *
    10^7 pixels) are refused before decoding. Returns keyword arguments of `Workspace`.
    """
    try:
        # All scalars as text, because in YAML 1.1 `5e-2` is no number and `no` is a Boolean.
        document = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(f"not valid YAML, or cut short: {' '.join(str(error).split())}") from None
    if not isinstance(document, dict):
        raise ValueError("expected a map_server description: image, resolution, origin, ...")
    required = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
    for field in required:
        if field not in document:
            raise ValueError(f"{field}: it is missing; a map_server file has {', '.join(required)}")
    if (mode := document.get("mode", "trinary")) != "trinary":
        raise ValueError(f"mode: only trinary maps are read, got {reprlib.repr(mode)}")
    negate = {"0": False, "false": False, "1": True, "true": True}.get(
        str(document["negate"]).lower()
    )
    if negate is None:
        raise refused("negate", "0 or 1", document["negate"])

    origin = document["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise refused("origin", "[x, y, yaw]", origin)
    x, y, yaw = (_number("origin", text) for text in origin)
    if yaw != 0:
        raise ValueError(f"origin: only maps that are not rotated are read, got a yaw of {yaw:g}")
    resolution = _side("resolution", document["resolution"])
    occupied = _number("occupied_thresh", document["occupied_thresh"])
    free = _number("free_thresh", document["free_thresh"])
    thresholds = free, occupied
    if not 0 <= free <= occupied <= 1:
        raise ValueError(
            "free_thresh, occupied_thresh: expected 0 <= free_thresh <= occupied_thresh <= 1, "
            f"got {free:g} and {occupied:g}"
        )

    if not isinstance(document["image"], str) or not document["image"]:
        raise refused("image", "the name of a file", document["image"])
    path = folder / document["image"]
    try:
        free_pixels = _free_pixels(path, "mode" in document, negate, thresholds, unknown)
    except ValueError as error:
        raise ValueError(f"image: {document['image']}: {error}") from error
    return grid_fields(~free_pixels[::-1], (x, y), resolution)


def format_map_server(
    fields: Mapping[str, Any], environment: shapely.Polygon | shapely.MultiPolygon, image: str
) -> tuple[str, bytes]:
    """Write a map as YAML text and a PGM image for map_server; `image` is the name of its file."""
    blocked, (x, y) = _grid_of(fields, environment)
    text = (
        f"image: {json.dumps(image)}\n"
        f"resolution: {fields['cell']!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )
    rows, columns = blocked.shape
    pixels = np.where(blocked[::-1], 0, 254).astype(np.uint8)
    return text, f"P5\n{columns} {rows}\n255\n".encode() + pixels.tobytes()


def _read_header_line(line: str, number: int, header: dict[str, str]) -> None:
    if line == "" or line.startswith(";;") or not line[1:].strip():
        return
    key, _, value = line[1:].strip().partition(" ")
    if key not in _HEADER:
        raise ValueError(
            f"line {number}: {reprlib.repr(key)}: unknown; expected {', '.join(_HEADER)}, "
            "or ';;' before a remark"
        )
    if key in header:
        raise ValueError(f"line {number}: {key!r} is given twice")
    header[key] = value.strip()


def _number(field: str, text: Any) -> float:
    return checked_number(field, text, most=math.inf, text=True)


def _side(field: str, text: Any) -> float:
    value = _number(field, text)
    if not value > 0:
        raise ValueError(f"{field}: expected more than 0 m, got {value:g}")
    return value


def grid_fields(
    blocked: Bool[np.ndarray, "rows columns"], origin: tuple[float, float], cell: float
) -> dict[str, Any]:
    """Return the map fields of a grid; row 0 is the lowest, `origin` the lower left corner."""
    if blocked.all():
        raise ValueError("the grid has no free square")
    rows, columns = blocked.shape
    rectangle = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)])
    corners, starts = blocked_rings(blocked)
    return {
        "boundary": np.array(origin) + cell * rectangle,
        "obstacles": np.split(np.array(origin) + cell * corners, starts) if blocked.any() else [],
        "cell": cell,
    }


def _grid_of(
    fields: Mapping[str, Any], environment: shapely.Polygon | shapely.MultiPolygon
) -> tuple[Bool[np.ndarray, "rows columns"], tuple[float, float]]:
    """Return the blocked squares of a map (row 0 is the lowest), and its lower left corner."""
    if fields["cell"] is None:
        raise ValueError("cell: a grid needs the side of its squares, and this map suggests none")
    x, y = fields["boundary"].min(axis=0).tolist()
    far_x, far_y = fields["boundary"].max(axis=0).tolist()
    blocked = rasterise(environment, (x, y, far_x, far_y), fields["cell"])
    if blocked.all():
        raise ValueError(f"cell: no square of side {fields['cell']:g} m has its centre free")
    return blocked, (x, y)


def _free_pixels(
    path: Path, nav2: bool, negate: bool, thresholds: tuple[float, float], unknown: Unknown
) -> Bool[np.ndarray, "rows columns"]:
    """Return a mask of the free pixels, with row 0 at the top; see [`parse_map_server`][]."""
    pixels, full = _pixels(path)
    colours = pixels[..., :3]
    clear = (pixels[..., 3:] < full).any(axis=2)
    if not nav2:
        shade, parts = pixels.sum(axis=2, dtype=np.int32), pixels.shape[2]
    elif colours.shape[2] == 3:
        shade, parts = np.rint(colours @ _LUMINANCE).astype(np.int32), 1
    else:
        shade, parts = colours[..., 0], 1
    # The table has an entry per possible shade, by the arithmetic of map_server.
    mean = np.arange(full * parts + 1) / parts
    occupancy = mean / full if negate else (full - mean) / full
    free, occupied = thresholds
    if unknown == "free":
        return (occupancy <= occupied)[shade] | (clear & nav2)
    mask = (occupancy < free)[shade]
    if nav2:
        mask &= ~clear
    elif count := int((mask & clear).sum()):
        doubt = (
            f"{path}: {count:,} pixels that are not opaque are free, as in ROS 1; nav2 takes them "
            "as unknown: add mode: trinary to the .yaml file for that"
        )
        warnings.warn(doubt, Doubt, stacklevel=2)
    plain = (colours == colours[..., :1]).all(axis=2) & ~clear
    grey = np.where(plain, colours[..., 0] // (full // 255), 0)
    counts = np.bincount(grey[mask], minlength=256)
    for each in _UNKNOWN_GREYS:
        # A map of many greys, in which this grey means a probability, has its neighbours as well.
        beside = [near for near in (each - 1, each + 1) if near not in _UNKNOWN_GREYS]
        if counts[each] > counts[beside].sum():
            mask &= grey != each
            doubt = (
                f"{path}: {counts[each]:,} pixels of grey {each} are walls: free_thresh {free:g} "
                "takes them as free, but savers of maps write this grey for unknown; to make all "
                'unknown pixels free, use `unknown="free"`'
            )
            warnings.warn(doubt, Doubt, stacklevel=2)
    return mask


def _pixels(path: Path) -> tuple[Integer[np.ndarray, "rows columns channels"], int]:
    """Read the channels of the pixels of an image, and the value of a white pixel."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from None
    try:
        image = read_image(content, ("PPM", "PNG"))
    except UnidentifiedImageError:
        raise ValueError("expected a PGM or PNG image") from None

    mode = {"1": "L", "P": "RGB", "LA": "RGBA"}.get(image.mode, image.mode)
    if mode in ("L", "RGB") and "transparency" in image.info:
        mode = "RGBA"
    if mode not in ("L", "RGB", "RGBA", "I", "I;16"):
        raise ValueError(f"expected grey or colour of 8 bits, or grey of 16; got mode {mode!r}")
    pixels = np.asarray(image.convert(mode))
    full = 255 if pixels.dtype == np.uint8 else 65535
    return pixels.reshape(image.height, image.width, -1), full
