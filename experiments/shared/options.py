"""Options that experiments share."""

import argparse
from collections.abc import Callable
from pathlib import Path


def experiment_parser(doc: str, out: str, seed: int | None = None) -> argparse.ArgumentParser:
    """Make a parser of the option `--out`, and of `--seed` if it has a default.

    **Arguments:**

    - `doc`: the docstring of the experiment, whose first line is shown in the help.
    - `out`: default folder of the results.
    - `seed`: default seed of random numbers.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(out), help="folder of the results")
    if seed is not None:
        parser.add_argument("--seed", type=at_least(0), default=seed, help="of random numbers")
    return parser


def read_options(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse the command line, and make the folder of the results."""
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def at_least(least: int) -> Callable[[str], int]:
    """Make the reader of a whole number that is at least `least`."""

    def read(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"expected a whole number from {least}, got {text!r}")
        return int(text)

    return read
