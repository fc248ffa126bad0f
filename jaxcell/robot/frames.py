"""Take frames from a camera, or from pictures in a folder, with OpenCV."""

import itertools
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..base.optional_modules import import_module


Frame = UInt8[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width"]
"""A grey picture, or a picture with the channels blue, green and red, the order of OpenCV."""


def camera(device: int = 0) -> Callable[[], Frame]:
    """Open a camera as a source of frames.

    **Arguments:** the number of the camera. **Returns:** a function that takes a new frame, and
    drops the older frames that wait in the driver of the camera.

    **Raises:** `OSError` if the camera does not open; the function raises it if no frame comes.

    Without a camera:

        >>> from jaxcell import robot
        >>> robot.camera(99)
        Traceback (most recent call last):
            ...
        OSError: camera 99 does not open
    """
    cv2 = import_module("cv2")
    capture = cv2.VideoCapture(device)
    if not capture.isOpened():
        raise OSError(f"camera {device} does not open")

    def look() -> Frame:
        # The driver keeps up to four frames, which were taken before the robot arrived.
        for _ in range(5):
            capture.grab()
        whole, frame = capture.retrieve()
        if not whole:
            raise OSError(f"camera {device} gives no frame")
        return np.asarray(frame)

    return look


def pictures(folder: str | os.PathLike[str]) -> Callable[[], Frame]:
    """Return a source of frames that reads the pictures in a folder, in the order of their names.

    **Arguments:** a folder with files that end in `.png`, `.jpg` or `.jpeg`. **Returns:** a
    function that reads the next picture; the first picture follows the last one.

    **Raises:** `ValueError` if the folder has no picture; the function raises it if it cannot read
    a picture.

    A folder with one picture:

        >>> import cv2
        >>> from jaxcell import examples, robot
        >>> folder = examples.folder()
        >>> _ = cv2.imwrite(str(folder / "cross.png"), robot.draw_cross(50))
        >>> robot.pictures(folder)().shape
        (50, 50, 3)
    """
    cv2 = import_module("cv2")
    paths = sorted(
        path for path in Path(folder).iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg")
    )
    if not paths:
        raise ValueError(f"{folder}: expected .png or .jpg files, found none")
    in_turn = itertools.cycle(paths)

    def look() -> Frame:
        path = next(in_turn)
        frame = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if frame is None:
            raise ValueError(f"{path}: expected a picture, but it cannot be read")
        return np.asarray(frame)

    return look
