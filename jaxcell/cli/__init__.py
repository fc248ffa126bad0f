"""The command `jaxcell`. JAX is imported only when a command runs, so help is fast."""

import sys
from collections.abc import Sequence


def main(args: Sequence[str] | None = None) -> int:
    """Run a command, and return the exit status: 0 done, 1 no answer, 2 bad input."""
    try:
        from .app import run

        return run(sys.argv[1:] if args is None else args)
    except KeyboardInterrupt:
        return 130
