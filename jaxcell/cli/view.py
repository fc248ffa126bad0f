import contextlib
import dataclasses
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path

import tyro

from ..base.display import has_display
from ..base.optional_modules import has_module, missing_module
from ..base.signals import end_by_signals, leave_signals
from .terminal import note, own_command


# The viewer's own default is three quarters of all memory.
_MEMORY = "2GB"
_HERE = "127.0.0.1"
# Those of Rerun itself: of the page, and of the recordings that it reads.
_PAGE_PORT, _DATA_PORT = 9090, 9876
_MAX_WAIT = 60.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """Open the recordings of results in the Rerun viewer."""

    results: tyro.conf.Positional[Path]
    """A directory that a command wrote with --out, or one recording (.rrd)."""
    web: bool = False
    """Show them in a browser on this machine instead, until Ctrl-C."""

    def run(self) -> int:
        if not has_module("rerun"):
            raise missing_module("rerun")
        recordings = [str(path) for path in recordings_in(self.results)]
        if self.web:
            with _served(recordings) as (server, _):
                return server.wait()
        if not has_display():
            web = f"{own_command('jaxcell')} view --web {self.results}"
            copied = " ".join(recordings)
            note(
                f"There is no display here. For a browser on this machine: {web}\n"
                f"Elsewhere, with rerun-sdk of the same version: rerun {copied}"
            )
            return 1
        return subprocess.call([*_viewer(), *recordings])


@contextlib.contextmanager
def shown_live(viewer: str) -> Iterator[str]:
    """Have a viewer for a recording while it is made.

    Without a display, `here` is a page for a browser, which stays until Ctrl-C.

    **Arguments:**

    - `viewer`: as for `jaxcell.record.RobotRecording`.

    **Yields:** the same, or the address of the page's viewer.
    """
    if not has_module("rerun"):
        raise missing_module("rerun")
    if viewer != "here" or has_display():
        yield viewer
        return
    with _served(()) as (server, address):
        yield address
        if server.poll() is None:
            note("The page stays until Ctrl-C.")
            with contextlib.suppress(KeyboardInterrupt):
                server.wait()


def _viewer() -> list[str]:
    return [sys.executable, "-m", "rerun", "--memory-limit", _MEMORY]


@contextlib.contextmanager
def _served(recordings: Sequence[str]) -> Iterator[tuple["subprocess.Popen[bytes]", str]]:
    """Serve recordings to a browser, which is opened if there is a display.

    **Yields:** the process that serves, and the address to which it takes more.
    """
    page, data = _free_port(_PAGE_PORT), _free_port(_DATA_PORT)
    ports = ["--web-viewer-port", str(page), "--port", str(data)]
    served = f"rerun+http://{_HERE}:{data}/proxy"
    address = f"http://{_HERE}:{page}?url={urllib.parse.quote(served, safe='')}"
    command = [*_viewer(), "--bind", _HERE, *ports, "--serve-web", *recordings]
    # Its log has addresses too, of which one does not work and one is for another viewer.
    handled = end_by_signals()
    log = {"RUST_LOG": "error", **os.environ}
    # Rerun runs in a child of this process, which is ended with it.
    with subprocess.Popen(command, env=log, start_new_session=True) as server:
        try:
            until = time.monotonic() + _MAX_WAIT
            while server.poll() is None and not _answers(page) and time.monotonic() < until:
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
    """A port on which nobody listens, if possible the one that is wanted."""
    for port in (wanted, 0):
        with socket.socket() as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                one.bind((_HERE, port))
            except OSError:
                continue
            return int(one.getsockname()[1])
    raise OSError(f"view: there is no free port on {_HERE}")


def _answers(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex((_HERE, port)) == 0


def recordings_in(results: Path) -> list[Path]:
    """The recordings of a directory and those inside it, or the one that is named.

    **Raises:** `ValueError` if there is none; `FileNotFoundError`.
    """
    if not results.exists():
        raise FileNotFoundError(f"{results}: there is no such file or directory")
    recordings = sorted(results.rglob("*.rrd")) if results.is_dir() else [results]
    if not recordings:
        raise ValueError(f"{results}: there is no recording (.rrd) in it; was --out given?")
    for recording in recordings:
        with recording.open("rb") as file:
            if not file.read(4).startswith(b"RRF"):
                raise ValueError(f"{recording}: expected a Rerun recording (.rrd)")
    return recordings
