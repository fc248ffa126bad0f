"""Find the Git revision of the source code."""

import functools
import subprocess
from pathlib import Path


@functools.cache
def git_revision() -> str | None:
    """Return this checkout's commit, with `-dirty` for uncommitted changes; `None` if unknown."""

    def git(*arguments: str) -> str:
        command = ["git", "--no-optional-locks", *arguments]
        return subprocess.run(
            command,
            cwd=Path(__file__).parents[1],
            capture_output=True,
            check=True,
            text=True,
            timeout=10,
        ).stdout.strip()

    try:
        # An installed copy may lie inside the checkout of another project.
        git("ls-files", "--error-unmatch", "__init__.py")
        return git("describe", "--always", "--abbrev=40", "--dirty", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return None
