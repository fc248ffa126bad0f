"""Connect to a Rerun viewer that shows a recording while it grows."""

import socket
import subprocess
import sys
import time
import urllib.parse

import rerun as rr

from ..base.process import has_display


HERE = "127.0.0.1"
"""The address that only programs on this computer can reach."""
PORT = 9876
"""The port on which Rerun listens for recordings."""
_MAX_WAIT = 60.0


def viewer_sink(viewer: str) -> rr.GrpcSink:
    """Connect to a viewer that shows a recording while it grows.

    The argument `"here"` means a viewer on this computer, which is started if none runs. Otherwise
    the argument is an address, such as `rerun+http://laptop:9876/proxy`, which `rerun` prints when
    it starts.
    """
    if viewer == "here":
        url = f"rerun+http://{HERE}:{PORT}/proxy"
        if refusal(HERE, PORT) is not None:
            _start()
        return rr.GrpcSink(url)
    parts = urllib.parse.urlsplit(viewer)
    try:
        port = parts.port
    except ValueError:
        port = None
    if not parts.scheme.startswith("rerun") or not parts.hostname or port is None:
        raise ValueError(
            f"viewer {viewer!r}: expected here, or the address of a viewer, such as "
            f"rerun+http://127.0.0.1:{PORT}/proxy"
        )
    if (why := refusal(parts.hostname, port)) is not None:
        raise OSError(f"viewer {viewer}: no viewer answers there: {why}")
    return rr.GrpcSink(viewer)


def _start() -> None:
    if not has_display():
        raise OSError(
            "viewer here: there is no display; start `rerun` on a computer that has one, and give "
            "the address that it prints"
        )
    # `rerun.spawn` would let the viewer listen on all interfaces.
    command = [*viewer_command(), "--port", str(PORT), "--hide-welcome-screen"]
    nothing = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdin=nothing, stdout=nothing, start_new_session=True)
    until = time.monotonic() + _MAX_WAIT
    while (why := refusal(HERE, PORT)) is not None:
        if viewer.poll() is not None or time.monotonic() > until:
            raise OSError(f"viewer here: it does not start: {why}")
        time.sleep(0.1)


def viewer_command(bind: str = HERE, memory: str = "1GB") -> list[str]:
    """Return the command that starts a viewer; it accepts recordings only at the address `bind`."""
    return [sys.executable, "-m", "rerun", "--memory-limit", memory, "--bind", bind]


def refusal(host: str, port: int) -> str | None:
    """Return the reason why no viewer answers at an address; `None` if a viewer answers."""
    try:
        socket.create_connection((host, port), timeout=3).close()
    except OSError as error:
        return str(error)
    return None
