"""The command `jaxcell`. JAX is imported only when a command runs, so help is fast."""

import sys
from collections.abc import Sequence

from ..base.optional_modules import explained
from ..base.process import end_by_signals, leave_signals, signals_sent_again


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; its exit status is 0 for success, 1 without an answer, and 2 for bad input."""
    # SIGTERM ends a command like Ctrl-C: files that are not complete are removed.
    handled = end_by_signals()
    try:
        with signals_sent_again():
            try:
                from .app import run
            except ModuleNotFoundError as error:
                print(f"jaxcell: {explained(error)}", file=sys.stderr)
                return 2
            return run(sys.argv[1:] if args is None else args)
    except KeyboardInterrupt:
        return 130
    finally:
        leave_signals(handled)
