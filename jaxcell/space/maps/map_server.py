"""Read and write the grid maps of ROS map_server: a YAML file that names an image."""

import json
import math
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import shapely
import yaml
from jaxtyping import Bool, Integer
from PIL import UnidentifiedImageError

from ...base.documents import refused
from ...base.doubts import Doubt, warn
from ...base.limits import Crop, Unknown
from .grid_files import grid_fields, grid_of, read_number, read_side
from .images import read_image


# Greys of 8 bits that savers of maps write for unknown: map_saver, and Cartographer and its kin.
_UNKNOWN_GREYS = (205, 127, 128)
# Shares of red, green and blue in the luminance of a pixel (Rec. 709), by which nav2 reads colours.
_LUMINANCE = np.array([0.212656, 0.715158, 0.072186])
# The occupancy of an obstacle in mode raw, in percent.
_MOST_OCCUPANCY = 100
# Pixels that are decoded at a time.
_STRIP = 2**22


class _Loader(yaml.BaseLoader):
    """A YAML loader that refuses aliases, because a few lines of them can exhaust the memory."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError(f"*{self.peek_event().anchor}: expected no aliases")
        return super().compose_node(parent, index)


def parse_map_server(
    text: str, folder: Path, unknown: Unknown = "wall", crop: Crop = None
) -> dict[str, Any]:
    """Read the YAML file of a ROS map_server map, and its image.

    `image`, `resolution` (m per pixel), `origin` (x, y and yaw of the lower left corner),
    `negate`, `occupied_thresh` and `free_thresh` are required. `mode` may be trinary, scale or raw;
    other keys are ignored. Occupied pixels are obstacles, and so are unknown pixels unless
    `unknown` is `"free"`. With `crop`, only a part is read; see [`grid_fields`][].

    Pixels are unknown between the thresholds. They are also unknown if they have the grey that the
    saver of the map wrote for unknown, although `free_thresh` takes it as free; a `Doubt` says how
    many. A file with `mode` is read as nav2 reads it: the luminance of a colour counts, and pixels
    that are not opaque are unknown. A file without `mode` is read as in ROS 1: the channels of a
    pixel, including alpha, are averaged. In mode scale, pixels between the thresholds are obstacles
    of a cost; in mode raw, the value of a pixel is its occupancy in percent, unknown above 100.

    The path of the image is relative to `folder`; an image beside the YAML file replaces one that
    is missing. Returns keyword arguments of `Workspace`.
    """
    image, resolution, (x, y, yaw), how = _settings(text, folder)
    try:
        free_pixels = _free_pixels(*how, unknown)
    except ValueError as error:
        raise ValueError(f"image: {image}: {error}") from error
    fields = grid_fields(~free_pixels[::-1], (x, y), resolution, yaw, crop)
    return {**fields, "piece": "main"}


def about_map_server(text: str, folder: Path) -> dict[str, Any]:
    """Describe how a map that [`parse_map_server`][] reads is read, and count unknown pixels."""
    with warnings.catch_warnings(action="ignore"):
        _, resolution, (_, _, yaw), how = _settings(text, folder)
        walls, free = _free_pixels(*how, "wall"), _free_pixels(*how, "free")
    path, mode, _, thresholds = how
    return {
        "image": str(path),
        "mode": mode or "trinary, as in ROS 1",
        "pixel_m": resolution,
        "yaw_rad": yaw,
        "free_and_occupied_thresh": list(thresholds),
        "unknown_pixels": int((free & ~walls).sum()),
    }


def _settings(
    text: str, folder: Path
) -> tuple[str, float, tuple[float, float, float], tuple[Path, str, bool, tuple[float, float]]]:
    """Check a YAML file; return the name of the image, the resolution, the origin, and how pixels
    are read: the path of the image, the mode, `negate`, and the thresholds of free and occupied.
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
    if (mode := document.get("mode", "trinary")) not in ("trinary", "scale", "raw"):
        raise refused("mode", "trinary, scale or raw", mode)
    known = {"0": False, "false": False, "1": True, "true": True}
    if (negate := known.get(str(document["negate"]).lower())) is None:
        raise refused("negate", "0 or 1", document["negate"])

    origin = document["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise refused("origin", "[x, y, yaw]", origin)
    x, y, yaw = (read_number("origin", text) for text in origin)
    if abs(yaw) > 2 * math.pi:
        said = f"the yaw of origin is {yaw:g} radians, more than a turn; if it means degrees"
        warn(f"{document['image']}: {said}, write {math.radians(yaw):.6g}", Doubt)
    resolution = read_side("resolution", document["resolution"])
    occupied = read_number("occupied_thresh", document["occupied_thresh"])
    free = read_number("free_thresh", document["free_thresh"])
    if not 0 <= free <= occupied <= 1:
        expected = f"0 <= free_thresh <= occupied_thresh <= 1, got {free:g} and {occupied:g}"
        raise ValueError(f"free_thresh, occupied_thresh: expected {expected}")

    if not isinstance(document["image"], str) or not document["image"]:
        raise refused("image", "the name of a file", document["image"])
    path = folder / document["image"]
    beside = folder / PureWindowsPath(document["image"]).name
    if not path.is_file() and beside.is_file():
        warn(f"{path}: there is no such file; {beside}, beside the .yaml file, is read")
        path = beside
    mode = mode if "mode" in document else ""
    return document["image"], resolution, (x, y, yaw), (path, mode, negate, (free, occupied))


def format_map_server(
    fields: Mapping[str, Any], environment: shapely.Polygon | shapely.MultiPolygon, image: str
) -> tuple[str, bytes]:
    """Write a map as YAML text and a PGM image for map_server; `image` is the name of its file."""
    blocked, (x, y) = grid_of(fields, environment)
    text = (
        f"image: {json.dumps(image)}\nresolution: {fields['cell']!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    rows, columns = blocked.shape
    pixels = np.where(blocked[::-1], 0, 254).astype(np.uint8)
    return text, f"P5\n{columns} {rows}\n255\n".encode() + pixels.tobytes()


def _free_pixels(
    path: Path, mode: str, negate: bool, thresholds: tuple[float, float], unknown: Unknown
) -> Bool[np.ndarray, "rows columns"]:
    """Return a mask of the free pixels, with row 0 at the top; see [`parse_map_server`][]."""
    free, occupied = thresholds
    masks, greys, counts = [], [], np.zeros(256, np.int64)
    clear_count = odd_count = 0
    for pixels, full in _strips(path):
        colours = pixels[..., :3]
        clear = (pixels[..., 3:] < full).any(axis=2)
        if not mode:
            shade, parts = pixels.sum(axis=2, dtype=np.int32), pixels.shape[2]
        elif colours.shape[2] == 3:
            shade, parts = np.rint(colours @ _LUMINANCE).astype(np.int32), 1
        else:
            shade, parts = colours[..., 0], 1
        # The table has an entry per possible shade, by the arithmetic of map_server.
        mean = np.arange(full * parts + 1) / parts
        if mode == "raw":
            value = np.rint(mean * 255 / full)
            occupancy = np.where(value <= _MOST_OCCUPANCY, value / _MOST_OCCUPANCY, np.nan)
            odd_count += int(((value > _MOST_OCCUPANCY) & (value < 255))[shade].sum())
        else:
            occupancy = mean / full if negate else (full - mean) / full
        if unknown == "free":
            passed = occupancy < free if mode == "scale" else ~(occupancy > occupied)
            masks.append(passed[shade] | (clear & bool(mode)))
            continue
        mask = (occupancy < free)[shade]
        if mode:
            mask &= ~clear
        clear_count += int((mask & clear).sum())
        plain = mask & ~clear & (colours == colours[..., :1]).all(axis=2)
        grey = np.where(plain, colours[..., 0] // (full // 255), 0).astype(np.uint8)
        counts += np.bincount(grey.ravel(), minlength=256)
        masks.append(mask)
        greys.append(grey)
    doubts = {
        "that are not opaque are free, as in ROS 1; nav2 takes them as unknown: add mode: trinary "
        "to the .yaml file for that": clear_count,
        "of 101 to 254 are unknown, because the mode is raw; if white means free, write mode: "
        "trinary in the .yaml file": odd_count,
    }
    for each in _UNKNOWN_GREYS if mode != "raw" else ():
        # A map of many greys, in which this grey means a probability, has its neighbours as well.
        beside = [near for near in (each - 1, each + 1) if near not in _UNKNOWN_GREYS]
        if counts[each] > counts[beside].sum():
            for mask, grey in zip(masks, greys, strict=True):
                mask &= grey != each
            why = (
                f"of grey {each} are walls: free_thresh {free:g} takes them as free, but savers of "
                "maps write this grey for unknown; to make all unknown pixels free, use "
                '`unknown="free"`'
            )
            doubts[why] = int(counts[each])
    for why, count in doubts.items():
        if count:
            warn(f"{path}: {count:,} pixels {why}", Doubt)
    return np.concatenate(masks)


def _strips(
    path: Path,
) -> Iterator[tuple[Integer[np.ndarray, "rows columns channels"], int]]:
    """Yield the channels of the pixels of an image in strips, and the value of a white pixel."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from None
    try:
        image = read_image(content, ("PPM", "PNG", "BMP"))
    except UnidentifiedImageError:
        raise ValueError("expected a PGM, PNG or BMP image") from None

    mode = {"1": "L", "P": "RGB", "LA": "RGBA"}.get(image.mode, image.mode)
    if mode in ("L", "RGB") and "transparency" in image.info:
        mode = "RGBA"
    if mode not in ("L", "RGB", "RGBA", "I", "I;16"):
        raise ValueError(f"expected grey or colour of 8 bits, or grey of 16; got mode {mode!r}")
    image = image if image.mode == mode else image.convert(mode)
    height = max(1, _STRIP // image.width)
    for top in range(0, image.height, height):
        bottom = min(top + height, image.height)
        pixels = np.asarray(image.crop((0, top, image.width, bottom)))
        full = 255 if pixels.dtype == np.uint8 else 65535
        yield pixels.reshape(bottom - top, image.width, -1), full
