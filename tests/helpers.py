"""Runs of commands."""

import json
import shlex

from jaxcell.cli import main


def run(capsys, *words):
    """Run a command of words, or of lines of words, with `--json`.

    **Returns:** the exit status, the JSON object on standard output, if any, and standard error.
    """
    status = main(shlex.split(" ".join([*map(str, words), "--json"])))
    printed = capsys.readouterr()
    return status, json.loads(printed.out) if printed.out else None, printed.err
