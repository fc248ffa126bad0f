"""Make the pictures of the gallery: run its commands, and take screenshots of the recordings.

    python data/pictures/make_pictures.py [NAME ...]

The Rerun viewer needs no screen for this, but a Vulkan driver.
"""

import argparse
import contextlib
import dataclasses
import io
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from PIL import Image
from rerun.experimental import ViewerClient


HERE = Path(__file__).parent
ROOT = HERE.parents[1]
# Seconds until a view has settled and the notes of the viewer have disappeared.
SETTLE = 5.0
LOADING = 60.0
# The height of the viewer's bar, and the width of a picture, in pixels.
BAR, WIDTH = 37, 1400
MOST_BYTES = 150_000
# The number of most frequent colours among the 255 colours of a picture.
FREQUENT = 128


@dataclasses.dataclass(frozen=True)
class Picture:
    """Commands that write below `runs`, and a view of one of their recordings."""

    commands: tuple[str, ...]
    recording: str
    timeline: str
    at: float
    tab: str | None = None


LOCALIZE = "localize @lab_a --bounce 135 --out runs/lab"
ERRORS = "--heading unknown --errors run=2% distance=5cm turn=1deg --measured"
PICTURES = {
    "navigation_anywhere": Picture(
        (
            "navigate anywhere @complex --bounce 45 100 135 --goal 1,1 "
            f"{ERRORS} --robots 40 --out runs",
        ),
        "navigation.rrd",
        "bump",
        4,
    ),
    "localization_anywhere": Picture(
        (f"localize anywhere @complex --bounce 135 {ERRORS} --robots 40 --out runs",),
        "localization.rrd",
        "bump",
        4,
    ),
    "localization": Picture((LOCALIZE,), "lab/localization.rrd", "step", 5),
    "groups": Picture(
        ("groups @room_200x125 --bounce 90 --out runs",),
        "groups.rrd",
        "direction",
        30,
    ),
    "dynamics": Picture(
        ("dynamics pendulum --out runs/pendulum",), "pendulum/dynamics.rrd", "slice", 0
    ),
    "navigation": Picture(
        (
            "navigate @complex --directions 8 --bounce 45 90 135 "
            "--start 0.5,1.5,0 --goal 12.5,9.5,0 --out runs",
        ),
        "navigation.rrd",
        "step",
        33,
    ),
    "coverage": Picture(
        ("cover @complex --bounce 30 75 315 --errors turn=5deg --reliability 0.8 --out runs",),
        "coverage.rrd",
        "direction",
        30,
    ),
    "team": Picture(
        ("team @complex --directions 8 --robots 4 --bounce 135 --out runs",),
        "team.rrd",
        "step",
        40,
    ),
    "patrol": Picture(("patrol graph @random --robots 2 --out runs",), "patrol.rrd", "step", 60),
    "patrol_map": Picture(
        ("patrol map @depot --robots 2 --range 6 --out runs",),
        "patrol_map.rrd",
        "step",
        50,
    ),
    "drift": Picture(
        ("drift @gyres --start=-117.93,33.5 --goal=-118.1,33.45,5 --out runs",),
        "drift.rrd",
        "hour",
        7,
        "Groups",
    ),
    "drifters": Picture(
        ("drifters @drifters --nearly-closed 3 --after 60 --out runs",),
        "drifters.rrd",
        "day",
        30,
        "Nearly closed sets",
    ),
    "robot": Picture(
        (
            LOCALIZE,
            "robot run runs/lab/filter.jxf --simulate @lab_a --heading 0 --out runs/emulated",
        ),
        "emulated/run.rrd",
        "observation",
        6,
    ),
    "slip": Picture(
        ("localize slip @complex --bounce 45 135 --errors slip=2% --start 100 --out runs/slip",),
        "slip/localization.rrd",
        "step",
        20,
    ),
    "sweep": Picture(
        (
            "sweep @rooms --out runs/rooms",
            "sweep view runs/rooms --out runs/sweep.rrd",
        ),
        "sweep.rrd",
        "bounce",
        120,
    ),
}


def main() -> None:
    """Make the pictures with these names, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PICTURES))
    names = parser.parse_args().names or list(PICTURES)
    unknown = set(names) - set(PICTURES)
    if unknown:
        parser.error(f"there is no picture {', '.join(sorted(unknown))}")
    with viewer() as client:
        for name in names:
            print(f"{name}: making the recording", flush=True)
            with tempfile.TemporaryDirectory() as folder:
                Path(folder, "runs").mkdir()
                for command in PICTURES[name].commands:
                    jaxcell(command, folder)
                recording = Path(folder, "runs", PICTURES[name].recording)
                save(shoot(client, recording, PICTURES[name]), HERE / f"{name}.png")


def jaxcell(command: str, folder: str) -> None:
    """Run a command of jaxcell in a folder."""
    program = "from jaxcell.cli import main; raise SystemExit(main())"
    words = [sys.executable, "-c", program, *command.split()]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"jaxcell {command}\n{done.stdout}{done.stderr}")


@contextlib.contextmanager
def viewer() -> Iterator[ViewerClient]:
    """Start a viewer without a window."""
    # The viewer beside this Python comes first.
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    os.environ.setdefault("RUST_LOG", "error")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        client = ViewerClient.spawn(
            headless=True, port=port, hide_welcome_screen=True, memory_limit="1GB"
        )
        client.get_state()
    except Exception as error:
        sys.exit(
            f"the Rerun viewer does not start: {error}\nIt needs a Vulkan driver; without a GPU, "
            "Debian and Ubuntu have one in software: apt install mesa-vulkan-drivers libvulkan1"
        )
    with client:
        yield client


def shoot(client: ViewerClient, recording: Path, picture: Picture) -> Image.Image:
    """Take a screenshot of a recording at the time and in the tab of the picture."""
    client.open(str(recording))
    until = time.monotonic() + LOADING
    while client.get_state().loading and time.monotonic() < until:
        time.sleep(0.2)
    state = client.get_state()
    (shown,) = (one for one in state.recordings if one.store_id == state.active_recording)
    (line,) = (one for one in shown.timelines if one.name == picture.timeline)
    if line.time_type == "sequence":
        client.set_time(picture.timeline, sequence=int(picture.at), play_state="paused")
    else:
        client.set_time(picture.timeline, duration=picture.at, play_state="paused")
    if picture.tab is not None:
        blueprint = client.get_blueprint().blueprint
        show_tab(blueprint, picture.tab)
        client.set_blueprint(blueprint, store_id=state.active_recording)
    time.sleep(SETTLE)
    broken = [one for one in client.get_state().views if one.reports]
    if broken:
        sys.exit(f"{recording.name}: {broken[0].name}: {broken[0].reports}")
    image = Image.open(io.BytesIO(client.take_screenshot())).convert("RGB")
    client.close("all")
    return image.crop((0, BAR, *image.size))


def show_tab(blueprint: dict[str, Any], name: str) -> None:
    """Select the tab with a name."""
    for parts in list(blueprint.values()):
        container = parts.get("ContainerBlueprint", {})
        if container.get("container_kind") != "Tabs":
            continue
        for child in container["contents"]:
            titles = [part.get("display_name") for part in blueprint[f"/{child}"].values()]
            if name in titles:
                container["active_tab"] = child
                return
    raise ValueError(f"there is no tab {name}")


def save(image: Image.Image, path: Path) -> None:
    """Write a picture with few colours, small enough for a repository."""
    height = round(image.height * WIDTH / image.width)
    image = image.resize((WIDTH, height), Image.Resampling.LANCZOS)
    # The most frequent colours stay exact; the rest of the palette approximates all others.
    seen = sorted(image.getcolors(image.width * image.height), reverse=True)
    few = [channel for _, color in seen[:FREQUENT] for channel in color]
    rest = image.quantize(255 - FREQUENT, method=Image.Quantize.MAXCOVERAGE).getpalette()
    palette = Image.new("P", (1, 1))
    palette.putpalette([*few, *rest[: 3 * (255 - FREQUENT)]])
    image = image.quantize(palette=palette, dither=Image.Dither.NONE)
    image.save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path.relative_to(ROOT)}: {size / 1000:.0f} kB", flush=True)
    if size > MOST_BYTES:
        sys.exit(f"{path}: {size} bytes; expected {MOST_BYTES} at most")


if __name__ == "__main__":
    main()
