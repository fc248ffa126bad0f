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
from jaxtyping import Float, Int, UInt8

from ..base.optional_modules import import_module
from ..base.shown import Shown
from .frames import Frame


# The edges of the cross in units of half the width of an arm, facing right, down, left and up in
# turn; the first four are the ends of the arms. An edge lies at `_AT` along the axis that it faces
# (`_FACING`, 0 for x and 1 for y), and extends from `_FROM` to `_TO` along the other axis.
_FACING = np.array([0, 1, 0, 1] * 3)
_AT = np.array([3.0, 3, -3, -3] + [1.0, 1, -1, -1] * 2)
_FROM = np.array([-1.0] * 4 + [1.0] * 4 + [-3.0] * 4)
_TO = np.array([1.0] * 4 + [3.0] * 4 + [-1.0] * 4)
# The variance of x over the cross, which equals that of y.
_VARIANCE = 29 / 15

# The width in pixels of the window of the local mean.
_WINDOW = 31
# A frame is halved as long as its shorter side stays above this number of pixels.
_SMALLEST = 96
# Outlines with fewer pixels are skipped, and at most this number of their points is fitted.
_SHORTEST, _MAX_POINTS = 48, 400
# The bounds of two affine invariants: the area divided by the root of the determinant of the second
# moments (10.3 for the cross), and the area divided by the area of the convex hull (0.71).
_COMPACT = (8.5, 11.5)
_SOLID = (0.58, 0.85)
# The largest distance from the edges of the points that each round of the fit uses, in units.
_ROUNDS = (0.9, 0.7, 0.5, 0.4)
# The least share of the outline that must be near an edge after the fit.
_LEAST_FITTING = 0.9
# A point is near an edge within either distance, in units and in pixels.
_NEAR, _NEAR_PIXELS = 0.25, 0.75
# The least correlation with the marker, over a square patch that shows the inner 9 by 9 units.
_LEAST_SCORE = 0.8
# The side of the patch in pixels.
_PATCH = 32

_SECOND_DIFFERENCES = np.array([(1, -2, 1), (-2, 4, -2), (1, -2, 1)], np.float32)


@dataclass(frozen=True)
class Marker(Shown):
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
    the cross, and then a homography fits its outline. If the fit is close, and a camera could see a
    sheet in this perspective, the homography rectifies the frame for a correlation with the marker.

    **Arguments:** a frame; 640 by 480 pixels are enough, and the time is proportional to the number
    of pixels. **Returns:** the marker, or `None`.

    **Raises:** `ValueError` if the array is not a frame; `ModuleNotFoundError` without OpenCV.

    A sheet on a grey wall:

        >>> import numpy as np
        >>> from jaxcell import robot
        >>> frame = np.full((240, 320), 128, np.uint8)
        >>> frame[40:140, 60:160] = robot.draw_cross(100)
        >>> marker = robot.find_cross(frame)
        >>> [round(x) for x in marker.centre], round(marker.arm)
        ([110, 90], 31)
    """
    cv2 = import_module("cv2")
    level = _grey(frame)
    best: Marker | None = None
    for doublings in itertools.count():
        for homography in _crosses(level):
            score = _correlation(level, homography)
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


def _crosses(level: UInt8[np.ndarray, "height width"]) -> Iterator[Float[np.ndarray, "3 3"]]:
    """Yield the homography from a grey frame to the cross, for each shape that may be a marker."""
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
        if affine is None:
            continue
        points = outline[:: 1 + len(outline) // _MAX_POINTS, 0].astype(np.float64)
        unit = 1 / math.sqrt(np.linalg.det(affine))
        homography = _fit(_through(affine, points), unit, width)
        if homography is not None:
            yield homography @ affine


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
    x, y = _through(affine, outline[:, 0].astype(np.float64)).T
    angle = np.angle(np.sum((x + 1j * y) ** 4)) / 4
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([(cos, sin, 0), (-sin, cos, 0), (0, 0, 1)]) @ affine


def _fit(
    points: Float[np.ndarray, "points 2"], unit: float, width: int
) -> Float[np.ndarray, "3 3"] | None:
    """Fit the homography from an outline to the outline of the cross; `None` if it does not fit.

    Each iteration assigns the points to their nearest edges. The points are normalized, so that the
    homography is near the identity. A normalized distance of 1 is `unit` pixels in the frame, which
    is `width` pixels wide.
    """
    homography, inset = np.eye(3), 0.0
    for reach in (*_ROUNDS, 0.0):
        seen = _through(homography, points)
        across = seen[:, _FACING] - (_AT - inset * np.sign(_AT))
        along = seen[:, 1 - _FACING]
        beyond = np.maximum(np.maximum(_FROM - along, along - _TO), 0)
        distances = np.hypot(across, beyond)
        edge, distance = distances.argmin(axis=1), distances.min(axis=1)
        used = distance < reach
        if reach:
            # Most outlines are refused here.
            if used.mean() < _LEAST_FITTING:
                return None
            homography, inset = _onto_edges(points[used], edge[used])
            if (points @ homography[2, :2] < 0.2 - 1).any():
                return None
    fitting = distance < max(_NEAR, _NEAR_PIXELS / unit)
    per_edge = np.bincount(edge[fitting], minlength=len(_AT)) / (len(points) / len(_AT))
    # One edge of the twelve may be hidden.
    if fitting.mean() < _LEAST_FITTING or (per_edge > 0.4).sum() < len(_AT) - 1:
        return None
    # The threshold moves an outline by less than a pixel; a larger inset means other proportions.
    if not -0.6 < inset / (1 / unit + 0.05) < 0.8:
        return None
    # The foreshortening is limited by the distance of the sheet if the view is at most 90 degrees.
    slope = math.hypot(homography[2, 0], homography[2, 1])
    return homography if slope < 0.02 + 1.7 * unit / width else None


def _onto_edges(
    points: Float[np.ndarray, "points 2"], edge: Int[np.ndarray, "points"]
) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Fit the homography that maps each point to the line of its edge, by linear least squares.

    `edge` numbers the edge of each point. The second result is the normalized distance by which all
    edges are shifted inward, because outlines lie inside their shapes and depend on the threshold.
    """
    at, sideways = _AT[edge], _FACING[edge] == 0
    extended = np.column_stack([points, np.ones(len(points))])
    rows = np.zeros((len(points), 9))
    rows[sideways, 0:3] = extended[sideways]
    rows[~sideways, 3:6] = extended[~sideways]
    rows[:, 6:8] = -at[:, None] * points
    rows[:, 8] = np.sign(at)
    solution = np.linalg.lstsq(rows, at, rcond=None)[0]
    return np.append(solution[:8], 1.0).reshape(3, 3), float(solution[8])


def _through(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points 2"]:
    ends = points @ homography[:2, :2].T + homography[:2, 2]
    return ends / (points @ homography[2, :2] + homography[2, 2])[:, None]


@functools.cache
def _perfect() -> tuple[Float[np.ndarray, "pixels"], Float[np.ndarray, "pixels 3"]]:
    """Return the pixels of a perfect marker, and an orthonormal basis of patches linear in x, y."""
    fine = draw_cross(320)[16:-16, 16:-16].astype(np.float64)
    marker = fine.reshape(_PATCH, 9, _PATCH, 9).mean(axis=(1, 3)).ravel()
    y, x = np.indices((_PATCH, _PATCH)).reshape(2, -1)
    light = np.linalg.qr(np.column_stack([np.ones(len(x)), x, y]))[0]
    marker -= light @ (light.T @ marker)
    return marker / np.linalg.norm(marker), light


def _correlation(
    level: UInt8[np.ndarray, "height width"], homography: Float[np.ndarray, "3 3"]
) -> float:
    cv2 = import_module("cv2")
    size, middle = _PATCH / 9, (_PATCH - 1) / 2
    to_patch = np.array([(size, 0, middle), (0, size, middle), (0, 0, 1)]) @ homography
    border = cv2.BORDER_REPLICATE
    patch = cv2.warpPerspective(level, to_patch, (_PATCH, _PATCH), borderMode=border)
    marker, light = _perfect()
    seen = patch.ravel().astype(np.float64)
    seen -= light @ (light.T @ seen)
    length = np.linalg.norm(seen)
    return float(marker @ seen / length) if length > 0 else 0.0


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
