import contextlib
import dataclasses
import os
import shlex
import signal
import socket
import subprocess
import time
import urllib.parse
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

import tyro

from ..base.optional_modules import has_module, missing_module
from ..base.paths import absent, visible
from ..base.process import (
    end_by_signals,
    guarded,
    has_display,
    is_ending,
    keep_running,
    leave_signals,
)
from ..base.results import Manifest, check_result
from .terminal import note, own_command


# Memory limit of the viewer; its default is three quarters of all memory.
_MEMORY = "2GB"
_HERE = "127.0.0.1"
PAGE_PORT, DATA_PORT = 9090, 9876
"""The default ports of Rerun for its web page, and for recordings."""
_MAX_WAIT = 60.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """Open the recordings of results in the Rerun viewer."""

    example: ClassVar[str] = "runs/lab"

    results: tyro.conf.Positional[Path]
    """Folder that a command wrote with --out, or a recording (.rrd)."""
    web: bool = False
    """Show the recordings in a browser on this machine, until Ctrl-C."""
    bind: str = _HERE
    """Address where the viewer listens; 0.0.0.0 lets other computers see and send recordings."""

    def run(self) -> int:
        if not has_module("rerun"):
            raise missing_module("rerun")
        recordings = [str(path) for path in recordings_in(self.results)]
        if self.web:
            with _served(recordings, self.bind) as (server, _):
                return server.wait()
        if not has_display():
            web = own_command("view", "--web", self.results)
            copied = shlex.join(recordings)
            note(
                f"No display was found. In a browser on this machine: {web}\n"
                f"On another machine with the same version of rerun-sdk: rerun {copied}"
            )
            return 1
        from ..record.viewer import viewer_command

        return subprocess.call([*viewer_command(self.bind, _MEMORY), *recordings])


@contextlib.contextmanager
def shown_live(viewer: str) -> Iterator[str]:
    """Open a viewer for a recording that is being written, and yield its address.

    `viewer` is an address, or `here`: a window or, without a display, a page until Ctrl-C.
    """
    if not has_module("rerun"):
        raise missing_module("rerun")
    if viewer != "here" or has_display():
        yield viewer
        return
    with _served(()) as (server, address):
        yield address
        if server.poll() is None and not is_ending():
            note("The page stays until Ctrl-C.")
            with contextlib.suppress(KeyboardInterrupt):
                server.wait()
            keep_running()


@contextlib.contextmanager
def _served(
    recordings: Sequence[str], bind: str = _HERE
) -> Iterator[tuple["subprocess.Popen[bytes]", str]]:
    """Serve recordings to a browser, and open the browser if there is a display.

    Yields the process of the server, and the address for further recordings.
    """
    page, data = _free_port(PAGE_PORT), _free_port(DATA_PORT)
    ports = ["--web-viewer-port", str(page), "--port", str(data)]
    served = f"rerun+http://{_HERE}:{data}/proxy"
    address = f"http://{_HERE}:{page}?url={urllib.parse.quote(served, safe='')}"
    from ..record.viewer import refusal, viewer_command

    command = [*viewer_command(bind, _MEMORY), *ports, "--serve-web", *recordings]
    # Hide the log of the server, because it has two addresses that would mislead a user.
    handled = end_by_signals()
    log = {"RUST_LOG": "error", **os.environ}
    with subprocess.Popen(
        guarded(command), env=log, stdin=subprocess.PIPE, start_new_session=True
    ) as server:
        try:
            until = time.monotonic() + _MAX_WAIT
            while server.poll() is None and refusal(_HERE, page) and time.monotonic() < until:
                time.sleep(0.1)
            if server.poll() is None:
                note(address)
                if has_display():
                    webbrowser.open(address)
            yield server, served
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGTERM)
            leave_signals(handled)


def _free_port(wanted: int) -> int:
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((_HERE, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError(f"view: there is no free port on {_HERE}")


def recordings_in(results: Path) -> list[Path]:
    """Return the recordings in a folder and its subfolders, or the path if it is a recording."""
    if not results.exists():
        raise absent(results)
    check_result(results)
    recordings = sorted(visible(results, "*.rrd")) if results.is_dir() else [results]
    if not recordings:
        raise ValueError(f"{results}: it has no recording (.rrd); expected a folder of --out")
    for recording in recordings:
        with recording.open("rb") as file:
            if not file.read(4).startswith(b"RRF"):
                raise ValueError(f"{recording}: expected a Rerun recording (.rrd)")
    for folder in sorted({path.parent for path in recordings}) if results.is_dir() else ():
        manifest = Manifest.read(folder)
        others = [] if manifest is None else manifest.unlisted(folder)
        for recording in recordings:
            if recording.parent == folder and recording.name in others:
                note(f"{recording}: shown, too, but not of the result in this folder")
    return recordings
