"""Runs of commands and programs."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

from jaxcell.cli import main


def run(capsys, *words):
    """Run a command of paths, words, or lines of words, with `--json`.

    **Returns:** the exit status, the JSON object on standard output, if any, and standard error.
    """
    lines = [
        shlex.quote(str(word)) if isinstance(word, Path) or Path(str(word)).exists() else str(word)
        for word in words
    ]
    status = main(shlex.split(" ".join([*lines, "--json"])))
    printed = capsys.readouterr()
    return status, json.loads(printed.out) if printed.out else None, printed.err


def python(*words, **options):
    """Run Python with words, such as `-c` and a program, in a process that ends with status 0.

    **Returns:** the texts on standard output and on standard error.
    """
    command, pipes = [sys.executable, *map(str, words)], {"capture_output": True, "text": True}
    ended = subprocess.run(command, **(pipes | options))
    assert ended.returncode == 0, ended.stderr
    return ended.stdout, ended.stderr
