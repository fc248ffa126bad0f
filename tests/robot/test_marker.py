"""The marker in drawn frames; `experiments/chapter_4/marker.py` measures rates of thousands."""

import inspect
import math
import subprocess
import sys

import cv2
import marker_frames
import numpy as np
import pytest
from marker_frames import Conditions
from scipy.stats import binom

from jaxcell.robot.frames import camera, pictures
from jaxcell.robot.marker import CrossLook, draw_cross, find_cross


# Tests run in parallel, and threads of OpenCV would compete for the cores.
cv2.setNumThreads(1)

# A rate is refuted if the observed count has a smaller probability.
SURELY = 1e-3


def detection(conditions: Conditions, frames: int, seed: int):
    """Find markers in frames. Returns the found ones, and their distances from the truth in px."""
    rng = np.random.default_rng(seed)
    found, off = [], []
    for _ in range(frames):
        seen = marker_frames.with_marker(rng, conditions)
        marker = find_cross(seen.frame)
        if marker is None:
            continue
        distance = math.dist(marker.centre, seen.centre)
        if distance < 0.1 * np.ptp(seen.corners, axis=0).max():
            found.append((marker, seen))
            off.append(distance)
    return found, np.array(off)


def test_markers_are_found_under_ordinary_conditions():
    found, off = detection(Conditions(), 40, seed=1)
    assert binom.cdf(len(found), 40, 0.98) > SURELY, len(found)
    assert np.quantile(off, 0.95) < 1.0
    for marker, seen in found:
        lengths = np.linalg.norm(seen.corners - seen.centre, axis=1)
        # The corners of an arm are sqrt(10) units from the centre, and its end is 3 units away.
        assert 0.5 * lengths.max() < marker.arm < 1.1 * lengths.max()
        assert marker.score <= 1 + 1e-9


@pytest.mark.parametrize(
    ("conditions", "rate"),
    [
        (Conditions(span=(22, 26), noise=(0, 10)), 0.95),
        (Conditions(noise=(20, 20)), 0.9),
        (Conditions(light=(0.1, 0.1), noise=(3, 3)), 0.95),
        (Conditions(glare=(0.9, 0.9)), 0.95),
        (Conditions(blur=(2, 2), span=(30, 200)), 0.93),
    ],
    ids=["small", "noisy", "dark", "glaring", "blurred"],
)
def test_markers_are_found_under_hard_conditions(conditions, rate):
    found, _ = detection(conditions, 10, seed=2)
    assert binom.cdf(len(found), 10, rate) > SURELY, len(found)


def test_false_rates_are_refuted_by_the_interval():
    """The ordinary rate is refuted for markers that are too small."""
    found, _ = detection(Conditions(span=(8, 10)), 10, seed=3)
    assert binom.cdf(len(found), 10, 0.98) < SURELY


def test_clutter_and_other_signs_give_few_false_alarms():
    rng = np.random.default_rng(4)
    signs = [None] * 3 + list(marker_frames.SIGNS)
    frames = [
        marker_frames.without_marker(rng, Conditions(), sign=sign)
        for sign in signs
        for _ in range(2)
    ]
    alarms = sum(find_cross(frame) is not None for frame in frames)
    assert binom.sf(alarms - 1, len(frames), 0.005) > SURELY, alarms


@pytest.mark.parametrize("sign", ["thin plus", "square", "T", "disc", "white on black", "outline"])
def test_other_signs_alone_are_never_the_marker(sign):
    rng = np.random.default_rng(5)
    for _ in range(3):
        frame = np.full((240, 320), 200, np.uint8)
        for shape, shade in marker_frames.SIGNS[sign](rng):
            corners = (160, 120) + shape @ marker_frames.rotation(rng.uniform(0, 7)) * 18
            cv2.fillPoly(frame, [corners.astype(np.int32)], 255 * shade)
        assert find_cross(frame) is None


def upright(side: int, *, turned: float = 0.0) -> np.ndarray:
    """Draw the marker in the middle of a grey frame, rotated clockwise by radians."""
    frame = np.full((240, 320), 128, np.uint8)
    turn = cv2.getRotationMatrix2D(((side - 1) / 2,) * 2, -math.degrees(turned), 1.0)
    turn[:, 2] += (160.25 - (side - 1) / 2, 120.5 - (side - 1) / 2)
    size = (320, 240)
    return cv2.warpAffine(draw_cross(side), turn, size, frame, borderMode=cv2.BORDER_TRANSPARENT)


@pytest.mark.parametrize("turned", [0.0, 0.3, math.pi / 4, 1.2, 1.2 + math.pi / 2])
def test_centre_arm_and_rotation_of_a_marker_are_measured(turned):
    marker = find_cross(upright(100, turned=turned))
    assert marker is not None
    assert marker.centre == pytest.approx((160.25, 120.5), abs=0.3)
    assert marker.arm == pytest.approx(30, abs=0.5)
    quarter = math.pi / 2
    assert (marker.rotation - turned + quarter / 2) % quarter == pytest.approx(
        quarter / 2, abs=0.02
    )
    assert 0 <= marker.rotation < quarter
    assert marker.score > 0.95


def test_colour_frames_and_views_are_frames_too():
    grey = upright(100)
    # Dark red and pale blue.
    colour = np.where(grey[..., None] < 100, (20, 10, 90), (250, 220, 200)).astype(np.uint8)
    expected = find_cross(grey)
    for frame in (colour, colour[:, ::-1], np.asfortranarray(grey), np.rot90(grey)):
        marker = find_cross(frame)
        assert marker is not None
        assert marker.arm == pytest.approx(expected.arm, abs=0.5)


def test_the_drawing_agrees_with_the_corners_of_the_frames():
    drawn = np.full((200, 200), 255, np.uint8)
    inclusive = np.round(20 * marker_frames.CROSS + 100 - 0.5 - 0.5 * np.sign(marker_frames.CROSS))
    expected = cv2.fillPoly(drawn, [inclusive.astype(np.int32)], 0)
    assert np.mean(draw_cross(200) != expected) < 0.01
    assert np.mean(draw_cross(200) == 0) == pytest.approx(20 / 100)


@pytest.mark.parametrize("level", [0, 128, 255])
def test_an_even_frame_has_no_marker(level):
    assert find_cross(np.full((240, 320), level, np.uint8)) is None


def test_a_cross_that_the_frame_cuts_off_is_not_found():
    assert find_cross(upright(100)[:140]) is None


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (np.zeros((240, 320, 4), np.uint8), "240 x 320 x 4"),
        (np.zeros((240, 320)), "float64"),
        (np.zeros((0, 320), np.uint8), "0 x 320"),
        (np.zeros(5, np.uint8), "got uint8 of 5"),
    ],
)
def test_arrays_that_are_no_frames_are_refused(frame, message):
    # The tests may check annotations at run time, which would refuse the frame before.
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(find_cross)(frame)


def test_looks_report_the_marker_in_the_frame():
    frames = iter([np.full((240, 320), 128, np.uint8), upright(100)])
    look = CrossLook(lambda: next(frames))
    assert look(7) is None
    assert look(8).startswith("cross at 160, 12")


def test_pictures_of_a_folder_come_in_turn(tmp_path):
    cv2.imwrite(str(tmp_path / "b.png"), upright(100))
    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((240, 320, 3), 128, np.uint8))
    (tmp_path / "notes.txt").write_text("not a picture")
    look = CrossLook(pictures(tmp_path))
    assert [look(cell) is not None for cell in range(4)] == [False, True, False, True]


def test_folders_without_pictures_are_refused(tmp_path):
    with pytest.raises(ValueError, match="found none"):
        pictures(tmp_path)
    (tmp_path / "broken.png").write_bytes(b"no")
    with pytest.raises(ValueError, match=r"broken\.png: expected a picture"):
        pictures(tmp_path)()


class FakeCapture:
    """A camera whose driver keeps four old frames without the marker."""

    opens = True

    def __init__(self, device):
        self.grabbed = 0

    def isOpened(self):  # noqa: N802
        return self.opens

    def grab(self):
        self.grabbed += 1
        return True

    def retrieve(self):
        if self.grabbed > 10:
            return False, None
        grey = upright(100) if self.grabbed > 4 else np.full((240, 320), 128, np.uint8)
        return True, np.stack([grey] * 3, axis=-1)


def test_cameras_give_the_newest_frame(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", FakeCapture)
    look = CrossLook(camera(0))
    assert look(0) is not None
    assert look(1) is not None
    with pytest.raises(OSError, match="camera 0 gives no frame"):
        look(2)
    monkeypatch.setattr(FakeCapture, "opens", False)
    with pytest.raises(OSError, match="camera 3 does not open"):
        camera(3)


def test_a_missing_opencv_names_the_extra_to_install():
    program = (
        "import sys; sys.modules['cv2'] = None\n"
        "import numpy as np\n"
        "from jaxcell.robot import marker\n"
        "assert marker.draw_cross(10).shape == (10, 10)\n"
        "try:\n    marker.find_cross(np.zeros((50, 50), np.uint8))\n"
        "except ModuleNotFoundError as error:\n    print(error)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert "pip install 'jaxcell[vision]'" in ran.stdout
    assert ran.stdout.count("\n") == 1
