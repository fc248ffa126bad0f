"""Runs of commands and programs."""

import json
import shlex
import subprocess
import sys

from jaxcell.cli import main


def run(capsys, *words):
    """Run a command of words, or of lines of words, with `--json`.

    **Returns:** the exit status, the JSON object on standard output, if any, and standard error.
    """
    status = main(shlex.split(" ".join([*map(str, words), "--json"])))
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
