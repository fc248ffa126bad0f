"""Write down what users rely on: `python tests/golden/record_golden.py [--only NAME]`.

Each case of `cases.toml` has a file of JSON: of each of its commands the exit status, what it says
on standard error, the keys and values of `--json`, and what is in the files that it writes.
`test_golden.py` compares. Look at the difference in git before you commit it.
"""

import argparse
import contextlib
import functools
import io
import json
import os
import re
import sys
import tempfile
import tomllib
from pathlib import Path
from unittest import mock


TESTS = Path(__file__).parents[1]
GOLDEN = Path(__file__).parent
if __name__ == "__main__":
    sys.path[:0] = [str(TESTS), str(TESTS.parent)]

from golden.plain import TOLERANCE, dump, file, load, plain, settled, text  # noqa: E402

from jaxcell.cli import main  # noqa: E402
from jaxcell.cli.app import COMMANDS  # noqa: E402


CASES = tomllib.loads((GOLDEN / "cases.toml").read_text(encoding="utf-8"))
HELP = "help"
NAMES = [HELP, *CASES]
# Wider pages of help have several panels side by side.
_ONE_COLUMN = 120
# Files that differ between runs.
_UNSTABLE = ("lock", "sweep.journal")
# Commands that print no JSON.
_PLAIN = ("demo", "export", "robot sketch", "sweep view", "view")


def record(name):
    """The current content for the golden file of a case."""
    if name == HELP:
        return options_of_all()
    case, found = CASES[name], {}
    with _folder(case.get("files", {})):
        for command in case.get("setup", "").splitlines():
            status, _, said = _call(command.split())
            if status != 0:
                raise RuntimeError(f"{name}: {command}: {said}")
        for command in case["commands"].splitlines():
            # The same command may come again.
            found[command + " (again)" * (command in found)] = _run(command)
    return found


def tolerance(name):
    """Return the tolerance of the numbers of a case."""
    return CASES.get(name, {}).get("tolerance", TOLERANCE)


def options_of_all():
    """The options of each command: what they take, and by default."""
    pages = {name: _call([*name.split(), "--help"], _ONE_COLUMN)[1] for name in COMMANDS}
    return {name: _options(page) for name, page in pages.items()}


def _options(page):
    """The options on a page of help, without what is said of them."""
    found = {}
    for indent, line in re.findall(r"^(  +)(\S.*?) *$", page, re.MULTILINE):
        if indent == "  ":
            option, _, said = line.partition("  ")
            # Two arguments may both be a PATH.
            option += " (another)" * (option in found)
            found[option] = said
        elif found:
            found[option] += " " + line
    ends = {
        option: re.search(r"(\((?:required|optional|default: [^()]*)\))?$", said).group()
        for option, said in found.items()
    }
    return {option: end for option, end in ends.items() if option != "-h, --help"}


@contextlib.contextmanager
def _folder(files):
    """A new working directory with the bundled data and some files."""
    before, path = Path.cwd(), list(sys.path)
    with tempfile.TemporaryDirectory(prefix="golden-") as folder:
        os.chdir(folder)
        try:
            Path("data").symlink_to(TESTS.parent / "data")
            for name, content in files.items():
                Path(name).write_text(content)
            yield
        finally:
            os.chdir(before)
            sys.path[:] = path


def _run(command):
    """The outcome of a command: all that it tells and leaves."""
    before, words = _files(), command.split()
    if not command.startswith(_PLAIN):
        words.append("--json")
    with contextlib.ExitStack() as stack:
        port = "EMULATED"
        if port in words:
            port = stack.enter_context(_emulated())
            words[words.index("EMULATED")] = port
        status, out, err = _call(words)
    found = {"status": status}
    for name, said in ((port, "EMULATED"), (os.getcwd() + "/", ""), (os.getcwd(), ".")):
        out, err = out.replace(name, said), err.replace(name, said)
    # The path of a command depends on the environment.
    if err := re.sub(r"\S*(?=jaxcell view|rerun /)", "", err):
        found["says"] = err.rstrip("\n").split("\n")
    printed = None
    if out and "--json" in words:
        printed = json.loads(out)
        found["json"] = plain(printed)
    elif out and command.startswith("robot sketch"):
        found["prints"] = text(out)
    after = _files()
    written = {path: file(path) for path in after if after[path] != before.get(path)}
    for path, content in written.items():
        if path.name == "summary.json":
            summary = json.loads(path.read_text())
            summary = {key: summary[key] for key in summary if key not in ("run_id", "version")}
            content = "what is printed" if summary == printed else content
        found.setdefault("files", {})[str(path)] = content
    return found


def _call(words, columns=250):
    """Exit status, standard output and standard error of the program."""
    place = {
        "COLUMNS": str(columns),
        "NO_COLOR": "1",
        "TERM": "dumb",
        "DISPLAY": "",
        "WAYLAND_DISPLAY": "",
    }
    with (
        mock.patch.dict(os.environ, place),
        mock.patch("jaxcell.base.runtime.configure_jax"),
        # Lines about the progress of long work depend on the machine.
        mock.patch("jaxcell.cli.terminal.FIRST_LINE", 3600.0),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        try:
            status = main(words)
        except SystemExit as end:
            # Errors of options are texts of tyro.
            return end.code, out.getvalue(), ""
    return status, out.getvalue(), err.getvalue()


def _files():
    """The files of the working directory, and when they were written."""
    found = {}
    for folder, folders, names in os.walk("."):
        # A sweep is looked at in its NetCDF file.
        folders[:] = sorted(name for name in folders if not name.endswith(".zarr"))
        for path in (Path(folder, name) for name in sorted(names) if name not in _UNSTABLE):
            found[path] = path.stat().st_mtime_ns
    return found


@contextlib.contextmanager
def _emulated():
    """The serial line of an emulated robot in a map."""
    from jaxcell.robot import Create
    from jaxcell.robot.emulation.body import Body
    from jaxcell.robot.emulation.emulator import Emulator, Line
    from jaxcell.space import Workspace

    body = Body(Workspace.load("data/maps/lab_a.json"), (0.5, 0.5, 0.0))
    # A busy machine makes the robot late.
    patient = mock.patch.object(Create, "open", functools.partial(Create.open, patience=5.0))
    with Emulator(body, line=Line(speedup=20.0)) as robot, patient:
        yield robot.port


def write(name):
    """Write the golden file of a case; what is the same within the tolerance stays as it is."""
    path, found = GOLDEN / f"{name}.json", record(name)
    if path.exists():
        found = settled(load(path), found, tolerance(name))
    path.write_text(dump(found) + "\n", encoding="utf-8")


if __name__ == "__main__":
    import conftest  # noqa: F401

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=NAMES, nargs="+", default=NAMES, metavar="NAME")
    for chosen in parser.parse_args().only:
        print(chosen, flush=True)
        write(chosen)
