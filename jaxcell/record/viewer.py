"""Connect to a Rerun viewer that shows a recording while it grows."""

import socket
import sys
import urllib.parse
from pathlib import Path

import rerun as rr

from ..base.process import has_display


PORT = 9876
"""The port on which Rerun listens for recordings."""


def viewer_sink(viewer: str) -> rr.GrpcSink:
    """Connect to a viewer that shows a recording while it grows.

    The argument `"here"` means a viewer on this computer, which is started if none runs. Otherwise
    the argument is an address, such as `rerun+http://laptop:9876/proxy`, which `rerun` prints when
    it starts.
    """
    if viewer == "here":
        url = f"rerun+http://127.0.0.1:{PORT}/proxy"
        if _refusal("127.0.0.1", PORT) is not None:
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
    if (refusal := _refusal(parts.hostname, port)) is not None:
        raise OSError(f"viewer {viewer}: no viewer answers there: {refusal}")
    return rr.GrpcSink(viewer)


def _start() -> None:
    if not has_display():
        raise OSError(
            "viewer here: there is no display; start `rerun` on a computer that has one, and give "
            "the address that it prints"
        )
    # The commands of a virtual environment, also of an inactive one, are beside its Python.
    beside = Path(sys.executable).with_name("rerun")
    try:
        rr.spawn(
            port=PORT,
            connect=False,
            memory_limit="1GB",
            hide_welcome_screen=True,
            executable_path=str(beside) if beside.exists() else None,
        )
    except RuntimeError as error:
        raise OSError(f"viewer here: it does not start: {error}") from error


def _refusal(host: str, port: int) -> str | None:
    """Return the reason why no viewer answers at an address; `None` if a viewer answers."""
    try:
        socket.create_connection((host, port), timeout=3).close()
    except OSError as error:
        return str(error)
    return None
