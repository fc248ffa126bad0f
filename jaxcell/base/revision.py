"""Find the revision of the source."""

import functools
import subprocess
from pathlib import Path


@functools.cache
def git_revision() -> str | None:
    """Find the commit of the checkout of this file, with `-dirty` if files were changed."""

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
        # An installed copy may lie inside another checkout, which does not track it.
        git("ls-files", "--error-unmatch", "__init__.py")
        return git("describe", "--always", "--abbrev=40", "--dirty", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return None
