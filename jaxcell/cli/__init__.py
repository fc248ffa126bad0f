"""The command `jaxcell`. JAX is imported only when a command runs, so help is fast."""

import sys
from collections.abc import Sequence


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; its exit status is 0 for success, 1 without an answer, and 2 for bad input."""
    try:
        from .app import run

        return run(sys.argv[1:] if args is None else args)
    except KeyboardInterrupt:
        return 130
