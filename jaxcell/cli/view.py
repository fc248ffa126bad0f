import dataclasses
import subprocess
import sys
from pathlib import Path

import tyro

from ..base.display import has_display
from ..base.extras import has_module, missing_module
from .terminal import note, own_command


# The viewer's own default is three quarters of all memory.
_MEMORY = "2GB"


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """Open the recordings of results in the Rerun viewer."""

    results: tyro.conf.Positional[Path]
    """A directory that a command wrote with --out, or one recording (.rrd)."""
    web: bool = False
    """Serve them to a browser on this machine instead."""

    def run(self) -> int:
        if not has_module("rerun"):
            raise missing_module("rerun")
        recordings = [str(path) for path in recordings_in(self.results)]
        viewer = [sys.executable, "-m", "rerun", "--memory-limit", _MEMORY]
        if self.web:
            return subprocess.call([*viewer, "--bind", "127.0.0.1", "--serve-web", *recordings])
        if not has_display():
            web = f"{own_command('jaxcell')} view --web {self.results}"
            copied = " ".join(recordings)
            note(
                f"There is no display here. For a browser on this machine: {web}\n"
                f"Elsewhere, with rerun-sdk of the same version: rerun {copied}"
            )
            return 1
        return subprocess.call([*viewer, *recordings])


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
