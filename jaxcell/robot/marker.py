"""Find the marker of a dummy intruder in the frames of a camera: a dark cross on a light sheet.

In Alam 2018, section 4.5.7, robots on patrol look for a cross, whose shape and detection are not
described. Here the marker is a black cross on a white square. If the arms are 2 units wide, their
ends are 3 units from the centre, and the sides of the sheet are 5 units from it:

```text
+-----------+
|    ###    |
|  #######  |    in any rotation: + and x are the same marker
|    ###    |
+-----------+
```

`draw_cross` draws the marker, which can be printed at any size. At a distance of 2.7 m, the cross
of a 20 cm sheet is 24 pixels wide in a camera whose 640 pixels span 62 degrees. Every dark cross
with these proportions on a light background is found, for example a bold plus sign. A cross that
touches something dark is usually missed.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from ..base.optional_modules import import_module
from .frames import Frame


# The variance of x over the cross, which equals that of y.
_VARIANCE = 29 / 15

# The width in pixels of the window of the local mean.
_WINDOW = 31
# A frame is halved as long as its shorter side stays above this number of pixels.
_SMALLEST = 96
# Outlines with fewer pixels are skipped.
_SHORTEST = 48
# The bounds of two affine invariants: the area divided by the root of the determinant of the second
# moments (10.3 for the cross), and the area divided by the area of the convex hull (0.71).
_COMPACT = (8.5, 11.5)
_SOLID = (0.58, 0.85)
# The least correlation with the marker; that of a star with four points is up to 0.962.
_LEAST_SCORE = 0.968
# The pixels per unit of a patch of a frame, and the sides in pixels of the patch, which shows the
# sheet, and of the marker in it, without the border of the sheet.
_PIXELS, _PATCH, _INNER = 4, 40, 36
# The most steps of an alignment, the change of the correlation that ends it, and the width in
# pixels of the filter that smooths both pictures.
_STEPS, _CHANGE, _SMOOTHED = 30, 1e-4, 5

_SECOND_DIFFERENCES = np.array([(1, -2, 1), (-2, 4, -2), (1, -2, 1)], np.float32)


@dataclass(frozen=True)
class Marker:
    """A marker that was found in a frame."""

    centre: tuple[float, float]
    "The position of the centre in pixels, right and down from the middle of the top left pixel."
    arm: float
    """The distance in pixels from the centre to the end of an arm. If the marker is seen at an
    angle, this is the distance in a frontal view with the same area."""
    rotation: float
    "The angle from the x axis to the next arm, clockwise in the frame, from 0 to pi / 2 radians."
    score: float
    "The correlation with a perfect marker, at most 1."


def find_cross(frame: Frame) -> Marker | None:
    """Find the marker with the highest score in a frame.

    The frame is searched at its full resolution, at half of it, and so on, for shapes that are
    darker than their surroundings. An affine map fits the moments of each shape to the moments of
    the cross, and then a homography maximizes the correlation with the marker. The shape is a
    marker if this correlation is high, and a camera could see a sheet in this perspective.

    **Arguments:** a frame; 640 by 480 pixels are enough, and the time is proportional to the number
    of pixels. **Returns:** the marker, or `None`.

    **Raises:** `ValueError` if the array is not a frame; `ModuleNotFoundError` without OpenCV.

    A sheet on a grey wall:

        >>> import numpy as np
        >>> from jaxcell import robot
        >>> frame = np.full((240, 320), 128, np.uint8)
        >>> frame[40:140, 60:160] = robot.draw_cross(100)
        >>> marker = robot.find_cross(frame)
        >>> [round(x, -1) for x in marker.centre], round(marker.arm, -1)
        ([110.0, 90.0], 30.0)
    """
    cv2 = import_module("cv2")
    level = _grey(frame)
    best: Marker | None = None
    for doublings in itertools.count():
        for homography, score in _crosses(level):
            if score >= (best.score if best else _LEAST_SCORE):
                best = _marker(homography, 2**doublings, score)
        if min(level.shape) < 2 * _SMALLEST:
            break
        # The middles of the pixels of the next level are those of every second pixel of this level.
        level = cv2.pyrDown(level)
    return best


def draw_cross(side: int) -> UInt8[np.ndarray, "side side"]:
    """Draw the marker with its sheet.

    **Arguments:** the side in pixels; the drawing is exact for multiples of 10. **Returns:** 0 for
    the cross, and 255 around it.

    The smallest exact sheet:

        >>> from jaxcell import robot
        >>> robot.draw_cross(10)[5].tolist()
        [255, 255, 0, 0, 0, 0, 0, 0, 255, 255]
    """
    across = np.abs((np.arange(side) + 0.5) / side * 10 - 5)
    wide, long = across < 1, across < 3
    dark = (wide[:, None] & long) | (long[:, None] & wide)
    return np.where(dark, 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class CrossLook:
    """A callable that finds the marker: the argument `look` of [`jaxcell.robot.run_patrol`][]."""

    source: Callable[[], Frame]
    "A function that returns a frame of the view ahead, such as `camera()` or `pictures(folder)`."

    def __call__(self, cell: int) -> str | None:
        """Take a frame, and describe the marker in it, if there is one. `cell` is ignored."""
        marker = find_cross(self.source())
        if marker is None:
            return None
        x, y = marker.centre
        return (
            f"cross at {x:.0f}, {y:.0f} px, arms of {marker.arm:.0f} px, score {marker.score:.2f}"
        )


def _crosses(
    level: UInt8[np.ndarray, "height width"],
) -> Iterator[tuple[Float[np.ndarray, "3 3"], float]]:
    """Yield the homography from a grey frame to the cross, and its score, for possible markers."""
    cv2 = import_module("cv2")
    height, width = level.shape
    # The median of second differences estimates the noise (Immerkaer 1996). The smoothing leaves
    # 3/8 of it, and a pixel that is darker by three standard deviations is not noise.
    rough = cv2.filter2D(level, cv2.CV_16S, _SECOND_DIFFERENCES)[::4, ::4]
    noise = float(np.median(np.abs(rough))) / (6 * 0.6745)
    smooth = cv2.GaussianBlur(level, (3, 3), 0)
    mean, below = cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV
    margin = max(3.0, 3 * 0.375 * noise)
    dark = cv2.adaptiveThreshold(smooth, 255, mean, below, _WINDOW, margin)
    outlines, family = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    for k, outline in enumerate(outlines):
        # An outline with a parent is a hole.
        if len(outline) < _SHORTEST or family[0, k, 3] >= 0:
            continue
        left, top, across, down = cv2.boundingRect(outline)
        whole = left > 1 and top > 1 and left + across < width - 1 and top + down < height - 1
        affine = _normalizing(outline) if whole else None
        aligned = None if affine is None else _aligned(level, affine)
        if aligned is not None:
            yield aligned


def _normalizing(outline: Int[np.ndarray, "points 1 2"]) -> Float[np.ndarray, "3 3"] | None:
    """Compute the affine map that gives a shape the moments of the cross.

    Returns `None` if the affine invariants of the shape differ from those of a cross.
    """
    cv2 = import_module("cv2")
    moments = cv2.moments(outline)
    area = moments["m00"]
    mixed = moments["mu11"]
    second = np.array([(moments["mu20"], mixed), (mixed, moments["mu02"])])
    spread = math.sqrt(max(np.linalg.det(second), 0.0))
    # The area is squared because the second moments are not divided by it.
    if not _COMPACT[0] * spread < area**2 < _COMPACT[1] * spread:
        return None
    hull = cv2.contourArea(cv2.convexHull(outline))
    if not _SOLID[0] * hull < area < _SOLID[1] * hull:
        return None
    affine = np.eye(3)
    affine[:2, :2] = np.linalg.inv(np.linalg.cholesky(second / area / _VARIANCE))
    centre = np.array([moments["m10"], moments["m01"]]) / area
    affine[:2, 2] = -affine[:2, :2] @ centre
    # The rest is a rotation; the fourth moment of the outline determines it up to quarter turns.
    x, y = affine[:2, :2] @ outline[:, 0].T + affine[:2, 2:]
    angle = np.angle(np.sum((x + 1j * y) ** 4)) / 4
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([(cos, sin, 0), (-sin, cos, 0), (0, 0, 1)]) @ affine


def _aligned(
    level: UInt8[np.ndarray, "height width"], affine: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "3 3"], float] | None:
    """Align a shape with the marker by the enhanced correlation coefficient (Evangelidis 2008).

    `affine` is the result of [`_normalizing`][]. **Returns:** the homography from the frame to the
    cross, and the correlation; `None` if no camera could see a sheet so.
    """
    cv2 = import_module("cv2")
    onto, size = _onto_pixels(_PATCH), (_PATCH, _PATCH)
    seen = cv2.warpPerspective(level, onto @ affine, size, borderMode=cv2.BORDER_REPLICATE)
    # Light that grows across the sheet is removed.
    y, x = np.indices(size).reshape(2, -1)
    light = np.column_stack([np.ones(x.size), x, y])
    patch = seen.ravel() - light @ np.linalg.lstsq(light, seen.ravel(), rcond=None)[0]
    begin = (onto @ np.linalg.inv(_onto_pixels(_INNER))).astype(np.float32)
    ends = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _CHANGE
    patch = patch.reshape(size).astype(np.float32)
    try:
        score, found = cv2.findTransformECC(
            _perfect(), patch, begin, cv2.MOTION_HOMOGRAPHY, ends, None, _SMOOTHED
        )
    except cv2.error:
        # No homography makes this shape more like the marker.
        return None
    if np.linalg.det(found) <= 0:
        return None
    turned = np.linalg.inv(_onto_pixels(_INNER)) @ np.linalg.inv(found) @ onto
    turned /= turned[2, 2]
    # The foreshortening is limited by the distance of the sheet if the view is at most 90 degrees.
    unit = 1 / math.sqrt(np.linalg.det(affine))
    if math.hypot(*turned[2, :2]) > 0.02 + 1.7 * unit / level.shape[1]:
        return None
    return turned @ affine, min(float(score), 1.0)


@functools.cache
def _perfect() -> Float32[np.ndarray, "36 36"]:
    cv2 = import_module("cv2")
    marker = draw_cross(320)[16:-16, 16:-16].astype(np.float32)
    return np.asarray(cv2.resize(marker, (_INNER, _INNER), interpolation=cv2.INTER_AREA))


def _onto_pixels(size: int) -> Float[np.ndarray, "3 3"]:
    """Return the map from units around the centre of the cross to a patch of `size` pixels."""
    middle = (size - 1) / 2
    return np.array([(_PIXELS, 0, middle), (0, _PIXELS, middle), (0, 0, 1)], float)


def _marker(homography: Float[np.ndarray, "3 3"], scale: int, score: float) -> Marker:
    back = np.linalg.inv(homography)
    back /= back[2, 2]
    centre = back[:2, 2]
    # The polar decomposition of the derivative at the centre contains the rotation.
    slope = back[:2, :2] - np.outer(centre, back[2, :2])
    turned = math.atan2(slope[1, 0] - slope[0, 1], slope[0, 0] + slope[1, 1])
    arm = 3 * scale * math.sqrt(np.linalg.det(slope))
    x, y = (scale * centre).tolist()
    return Marker((x, y), arm, turned % (math.pi / 2), score)


def _grey(frame: np.ndarray) -> UInt8[np.ndarray, "height width"]:
    cv2 = import_module("cv2")
    shape = frame.shape
    channels = shape[2:] in ((), (3,)) and len(shape) > 1
    if frame.dtype != np.uint8 or not channels or min(shape[:2]) < _WINDOW:
        raise ValueError(
            f"frame: expected bytes of height x width or height x width x 3, both at least "
            f"{_WINDOW}, got {frame.dtype} of {' x '.join(map(str, shape))}"
        )
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
